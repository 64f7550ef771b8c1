"""Do other tools find in the files of a run what it recorded? Flown, exported, and opened by readers of each format."""

from __future__ import annotations

import io
import json
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import duckdb
import jsonschema
import numpy as np
import polars
import pytest
from mcap.reader import NonSeekingReader, SeekingReader, make_reader
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.export import foxglove_messages, kml_file
from skyrange.export.csv_tables import write_tables
from skyrange.export.kml_file import write_kml
from skyrange.export.mcap_file import write_mcap
from skyrange.record import Recorder, RunRecord, load
from skyrange.record.schema import TABLES
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from tests.unit.record_sample import HEADER, tell

START_NS = 1_767_268_800 * NS_PER_S  # 2026-01-01T12:00:00Z
KML = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
SCENARIO = """
name = "exported"
seed = 3
duration_s = 9
origin = { lat = 40.7780, lon = -73.9550, alt_msl_m = 20, geoid_m = -32.7 }
start_utc = 2026-01-01T12:00:00Z
[city]
grid = {}
[radio]
[[operators]]
id = "blue"
color = "blue"
remote_id = { transports = ["wifi_beacon"], text = "=1+2, \\"survey\\"", operator_id = "OP-1" }
  [[operators.vehicles]]
  id = "b1"
  plan = { square = { side_m = 20, alt_m = 10 } }
  [[operators.vehicles]]
  id = "b2"
  start = [0, 12]
  plan = { square = { side_m = 20, alt_m = 10 } }
[[operators]]
id = "red"
  [[operators.vehicles]]
  id = "r1"
  start = [40, 0]
  plan = { square = { side_m = 20, alt_m = 10 } }
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 4
params = { form = "ghost", at = [30, 30, 15], transmitter_m = [35, 10, 2] }
"""


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return fly(load_text(SCENARIO), tmp_path_factory.mktemp("exported") / "run")


@pytest.fixture(scope="module")
def mcap(record: RunRecord) -> Path:
    return write_mcap(record).path


def messages(path: Path, *topics: str) -> Iterator[tuple[str, int, dict[str, Any]]]:
    """Topic, time in ns and contents, in order of time, of an MCAP file with its index."""
    with path.open("rb") as file:
        for _, channel, message in SeekingReader(file).iter_messages(list(topics) or None):
            yield channel.topic, message.log_time, json.loads(message.data)


def altered(record: RunRecord, folder: Path, **changes: Any) -> RunRecord:
    """A copy of a run with another manifest."""
    shutil.copytree(record.path, folder)
    manifest = {**record.manifest, **changes}
    manifest = {key: value for key, value in manifest.items() if value is not None}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return load(folder)


# ---------------------------------------------------------------- MCAP


def test_every_message_of_the_mcap_file_is_valid_by_its_schema(mcap: Path, record: RunRecord) -> None:
    checkers: dict[str, jsonschema.Draft202012Validator] = {}
    seen: dict[str, int] = {}
    with mcap.open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            if schema.name not in checkers:
                told = json.loads(schema.data)
                jsonschema.Draft202012Validator.check_schema(told)
                assert told["title"] == schema.name
                checkers[schema.name] = jsonschema.Draft202012Validator(_closed(told))
            checkers[schema.name].validate(json.loads(message.data))
            assert message.log_time == message.publish_time
            seen[channel.topic] = seen.get(channel.topic, 0) + 1
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(seen.values())
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    assert set(checkers) == {
        "foxglove.FrameTransforms", "foxglove.LocationFix", "foxglove.Log", "foxglove.SceneUpdate",
        "skyrange.Act", "skyrange.Claim", "skyrange.Reception",
    }  # fmt: skip
    assert seen == dict(write_mcap(record, mcap.with_name("again.mcap")).by)
    assert mcap.read_bytes() == mcap.with_name("again.mcap").read_bytes()


def _closed(schema: Any) -> Any:
    """A schema whose objects may have only the properties that it lists, and must have all of them, but for shapes."""
    if isinstance(schema, list):
        return [_closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    made = {key: _closed(value) for key, value in schema.items()}
    if schema.get("type") == "object":
        optional = {"arrows", "spheres", "triangles", "texts"}
        made |= {"additionalProperties": False, "required": sorted(set(schema["properties"]) - optional)}
    return made


def test_a_reader_without_the_index_finds_the_same_in_order_of_time(mcap: Path) -> None:
    stream = io.BytesIO(mcap.read_bytes())
    stream.seekable = lambda: False  # type: ignore[method-assign]
    reader = make_reader(stream)
    assert isinstance(reader, NonSeekingReader)
    found = [
        (channel.topic, message.log_time, json.loads(message.data))
        for _, channel, message in reader.iter_messages(log_time_order=False)
    ]
    times = [at_ns for _, at_ns, _ in found]
    assert times == sorted(times)
    key = lambda one: (one[1], one[0])  # noqa: E731
    assert sorted(found, key=key) == sorted(messages(mcap), key=key)


def test_poses_are_the_truth(mcap: Path, record: RunRecord) -> None:
    truth = record.table("truth").to_pylist()
    told = [
        (at_ns - START_NS, one)
        for _, at_ns, message in messages(mcap, "/tf")
        for one in message["transforms"]
    ]  # fmt: skip
    assert len(told) == len(truth) > 200
    for (at_ns, one), row in zip(told, truth, strict=True):
        assert (at_ns, one["child_frame_id"], one["parent_frame_id"]) == (row["time_ns"], row["vehicle"], "enu")
        stamp = one["timestamp"]
        assert stamp["sec"] * NS_PER_S + stamp["nsec"] == START_NS + at_ns
        place = [one["translation"][axis] for axis in "xyz"]
        assert place == pytest.approx([row["east_m"], row["north_m"], row["up_m"]], abs=1e-4)
        turn = [one["rotation"][axis] for axis in "wxyz"]
        assert turn == pytest.approx([row[name] for name in ("qw", "qx", "qy", "qz")], abs=1e-6)


def test_positions_are_degrees_and_metres_above_the_ellipsoid(mcap: Path, record: RunRecord) -> None:
    rows = [row for row in record.table("truth").to_pylist() if row["vehicle"] == "red/r1"]
    found = list(messages(mcap, "/aircraft/red/r1/location"))
    assert len(found) == len(rows)
    for (_, at_ns, fix), row in zip(found, rows, strict=True):
        assert at_ns == START_NS + row["time_ns"]
        assert fix["frame_id"] == "red/r1"
        assert fix["altitude"] == pytest.approx(20.0 - 32.7 + row["up_m"], abs=1e-3)
        # one degree of latitude at 40.778 N is 111,048 m, one of longitude 84,406 m (WGS 84)
        assert (fix["latitude"] - 40.7780) * 111_048 == pytest.approx(row["north_m"], abs=0.02)
        assert (fix["longitude"] + 73.9550) * 84_406 == pytest.approx(row["east_m"], abs=0.02)


def test_scene_has_all_buildings_and_a_shape_for_each_aircraft(mcap: Path, record: RunRecord) -> None:
    (drawn,) = (message for _, _, message in messages(mcap, foxglove_messages.BUILDINGS_TOPIC))
    (entity,) = drawn["entities"]
    (triangles,) = entity["triangles"]
    points = np.array([[point[axis] for axis in "xyz"] for point in triangles["points"]])
    corners = points[np.array(triangles["indices"])].reshape(-1, 3, 3)
    wanted = 0.0
    for row in record.city:
        ring = np.array(row["rings"][0])
        assert len(row["rings"]) == 1
        east, north = ring[:, 0], ring[:, 1]
        roof = abs(np.dot(east[:-1], north[1:]) - np.dot(east[1:], north[:-1])) / 2
        wanted += roof + row["height_m"] * np.linalg.norm(np.diff(ring, axis=0), axis=1).sum()
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert len(record.city) > 3
    assert np.linalg.norm(sides, axis=1).sum() / 2 == pytest.approx(wanted, rel=1e-3)
    last = [message for _, _, message in messages(mcap, foxglove_messages.AIRCRAFT_TOPIC)][-1]
    assert [one["id"] for one in last["entities"]] == ["blue/b1", "blue/b2", "red/r1"]
    assert all(one["frame_id"] == one["id"] and one["frame_locked"] for one in last["entities"])
    assert [one["texts"][0]["text"] for one in last["entities"]] == ["blue/b1", "blue/b2", "red/r1"]
    colours = {one["id"]: one["spheres"][0]["color"] for one in last["entities"]}
    assert colours["blue/b1"]["b"] > colours["blue/b1"]["r"]
    assert colours["blue/b1"] != colours["blue/b2"] != colours["red/r1"]


def test_a_large_city_is_in_several_topics(record: RunRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foxglove_messages, "TOPIC_BUILDINGS", 2)
    made = write_mcap(record, tmp_path / "run.mcap")
    topics = [topic for topic in made.by if topic.startswith("/scene/buildings")]
    assert len(topics) == -(-len(record.city) // 2) > 1
    assert {made.by[topic] for topic in topics} == {1}


def test_logs_say_what_was_noted(mcap: Path, record: RunRecord) -> None:
    for table, key in (("events", "time_ns"), ("decisions", "time_ns"), ("labels", "at_ns")):
        rows = sorted(record.table(table).to_pylist(), key=lambda row: row[key])
        found = list(messages(mcap, f"/log/{table}"))
        assert [at_ns - START_NS for _, at_ns, _ in found] == [row[key] for row in rows]
        assert rows
        for (_, _, log), row in zip(found, rows, strict=True):
            said = (row["frame"], row["attack"]) if table == "labels" else (row["kind"], row["about"])
            assert all(word in log["message"] for word in said)
            assert log["name"] == row["actor" if table == "labels" else "source"]
            if row.get("kind") == "event.attack_start":
                assert log["level"] == 3


def test_acts_and_receptions_are_the_rows_of_the_record(mcap: Path, record: RunRecord) -> None:
    for topic, table, key, names in (
        ("/acts", "labels", "at_ns", ("attack", "actor", "action", "frame", "child")),
        ("/remote_id/receptions", "observations", "time_ns", ("receiver", "radio", "uas_id", "frame", "transport")),
    ):
        rows = record.table(table).to_pylist()
        found = list(messages(mcap, topic))
        told = sorted((at_ns - START_NS, *(str(one[name]) for name in names)) for _, at_ns, one in found)
        assert told == sorted((row[key], *(str(row[name]) for name in names)) for row in rows)
        assert len(rows) >= 4
        assert all(stamp_ns(one["timestamp"]) == at_ns for _, at_ns, one in found)
    assert {one["author"] for _, _, one in messages(mcap, "/acts")} == {"attack"}
    signal = {(one["receiver"], one["frame"]): one["rssi_dbm"] for _, _, one in messages(mcap, "/remote_id/receptions")}
    for row in record.table("observations").to_pylist():
        assert signal[row["receiver"], row["frame"]] == pytest.approx(row["rssi_dbm"], abs=0.051)


def test_each_broadcast_that_claims_a_place_is_one_claim(mcap: Path, record: RunRecord) -> None:
    first: dict[str, dict[str, Any]] = {}
    for row in sorted(record.table("observations").to_pylist(), key=lambda row: row["time_ns"]):
        if row["east_m"] is not None:
            first.setdefault(row["frame"], row)
    found = {one["frame"]: (at_ns - START_NS, one) for _, at_ns, one in messages(mcap, "/remote_id/claims")}
    assert found.keys() == first.keys()
    assert len(list(messages(mcap, "/remote_id/claims"))) == len(first) == len(list(messages(mcap, "/scene/claims")))
    for frame, (time_ns, one) in found.items():
        row = first[frame]
        assert (time_ns, one["radio"], one["uas_id"]) == (row["time_ns"], row["radio"], row["uas_id"])
        place = [one["position"][axis] for axis in "xyz"]
        assert place == pytest.approx([row["east_m"], row["north_m"], row["up_m"]], abs=1e-3)
        assert (one["latitude"], one["longitude"]) == pytest.approx((row["lat_deg"], row["lon_deg"]), abs=1e-7)
        assert one["altitude"] == pytest.approx(row["alt_geo_m"], abs=0.01)
    ghosts = [one["position"] for _, one in found.values() if one["radio"] == "ghost"]
    assert [one["x"] for one in ghosts] == pytest.approx([30.0] * len(ghosts), abs=0.1)
    shapes = [entity for _, _, one in messages(mcap, "/scene/claims") for entity in one["entities"]]
    red = [one for one in shapes if one["id"].startswith("ghost ")]
    assert len(red) == len(ghosts) > 0
    assert all(one["spheres"][0]["color"]["r"] > 0.9 for one in red)


def test_beliefs_are_those_of_autopilots_and_of_stations(mcap: Path, record: RunRecord) -> None:
    sent = [frame for frame in record.frames_with_payloads() if frame.sender == "red/r1.autopilot"]
    decoder: Any = mavlink.MAVLink(None)
    decoder.robust_parsing = True
    reports = []
    for frame in sent:
        message = decoder.decode(bytearray(frame.payload))
        if message.get_type() == "GLOBAL_POSITION_INT":
            reports.append((frame.sent_ns, message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3 - 32.7))
    heard = [
        (row["time_ns"], row["lat"] * 1e-7, row["lon"] * 1e-7, row["alt"] * 1e-3 - 32.7)
        for row in record.telemetry("GLOBAL_POSITION_INT").to_pylist()
        if row["vehicle"] == "red/r1"
    ]
    for topic, wanted in (("autopilot", reports), ("station", heard)):
        found = [
            (at_ns - START_NS, fix["latitude"], fix["longitude"], fix["altitude"])
            for _, at_ns, fix in messages(mcap, f"/aircraft/red/r1/{topic}")
        ]
        assert [row[0] for row in found] == [row[0] for row in wanted]
        assert len(wanted) > 20
        assert np.array(found)[:, 1:] == pytest.approx(np.array(wanted)[:, 1:], abs=1e-3)
        assert np.array(found)[:, 1:3] == pytest.approx(np.array(wanted)[:, 1:3], abs=2e-8)


def test_a_run_without_frames_has_the_same_claims_and_acts_and_no_beliefs(mcap: Path, tmp_path: Path) -> None:
    study = fly(load_text(SCENARIO + '[record]\nlevel = "study"\n'), tmp_path / "study", report=False)
    made = write_mcap(study)
    assert not any(topic.endswith(("/autopilot", "/station")) for topic in made.by)
    for topic in ("/remote_id/claims", "/remote_id/receptions", "/scene/claims", "/acts"):
        assert list(messages(made.path, topic)) == list(messages(mcap, topic))


def stamp_ns(stamp: dict[str, int]) -> int:
    return stamp["sec"] * NS_PER_S + stamp["nsec"]


def test_attachments_and_metadata_name_the_run(mcap: Path, record: RunRecord) -> None:
    with mcap.open("rb") as file:
        reader = make_reader(file)
        attached = {one.name: one.data for one in reader.iter_attachments()}
        (metadata,) = reader.iter_metadata()
    assert attached["manifest.json"] == (record.path / "manifest.json").read_bytes()
    assert attached["scenario.toml"] == (record.path / "scenario.toml").read_bytes()
    assert metadata.metadata["fingerprint"] == record.manifest["digests"]["fingerprint"]
    assert metadata.metadata["name"] == "exported"


# ---------------------------------------------------------------- KML


def test_kml_has_a_folder_for_each_operator_and_all_positions(record: RunRecord, tmp_path: Path) -> None:
    made = write_kml(record, tmp_path / "tracks.kml")
    root = ElementTree.parse(made.path).getroot()
    assert root.findtext("k:Document/k:name", namespaces=KML) == "exported"
    folders = root.findall("k:Document/k:Folder", KML)
    assert [folder.findtext("k:name", namespaces=KML) for folder in folders] == ["blue", "red"]
    names = [name.text for folder in folders for name in folder.findall("k:Placemark/k:name", KML)]
    assert names == ["blue/b1", "blue/b2", "red/r1"] == list(made.by)
    truth = record.table("truth").to_pylist()
    styles = {style.get("id"): style for style in root.findall("k:Document/k:Style", KML)}
    colours = set()
    for place in root.iterfind(".//k:Placemark", KML):
        vehicle = place.findtext("k:name", namespaces=KML)
        rows = [row for row in truth if row["vehicle"] == vehicle]
        track = place.find("gx:Track", KML)
        assert track is not None
        assert track.findtext("k:altitudeMode", namespaces=KML) == "absolute"
        whens = [when.text for when in track.findall("k:when", KML)]
        coords = [coord.text.split(" ") for coord in track.findall("gx:coord", KML) if coord.text]
        assert len(whens) == len(coords) == len(rows) == made.by[vehicle or ""]
        moments = np.array([(when or "").removesuffix("Z") for when in whens], dtype="datetime64[ns]").astype(np.int64)
        assert moments.tolist() == [START_NS + row["time_ns"] for row in rows]
        for (longitude, latitude, altitude), row in zip(coords, rows, strict=True):
            assert float(altitude) == pytest.approx(20.0 + row["up_m"], abs=2e-3)  # above mean sea level
            assert (float(latitude) - 40.7780) * 111_048 == pytest.approx(row["north_m"], abs=0.02)
            assert (float(longitude) + 73.9550) * 84_406 == pytest.approx(row["east_m"], abs=0.02)
        style = styles[(place.findtext("k:styleUrl", namespaces=KML) or "").removeprefix("#")]
        colours.add(style.findtext("k:LineStyle/k:color", namespaces=KML))
    assert len(colours) == 3
    assert all(re.fullmatch("ff[0-9a-f]{6}", colour or "") for colour in colours)


def test_gdal_reads_the_tracks(record: RunRecord, tmp_path: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    if "LIBKML" not in pyogrio.list_drivers():
        pytest.skip("GDAL has no driver LIBKML, which knows gx:Track")
    path = write_kml(record, tmp_path / "tracks.kml").path
    assert [name for name, _ in pyogrio.list_layers(path).tolist()] == ["blue", "red"]
    import shapely

    info, _, shapes, fields = pyogrio.raw.read(path, layer="blue")
    named = dict(zip(info["fields"].tolist(), fields, strict=True))
    assert named["Name"].tolist() == ["blue/b1", "blue/b2"]
    for vehicle, shape in zip(named["Name"], shapely.from_wkb(shapes), strict=True):
        rows = [row for row in record.table("truth").to_pylist() if row["vehicle"] == vehicle]
        corners = shapely.get_coordinates(shape, include_z=True)
        assert len(corners) == len(rows)
        assert corners[:, 2] == pytest.approx([20.0 + row["up_m"] for row in rows], abs=2e-3)


def test_groups_of_tracks_give_the_same_file(
    record: RunRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = write_kml(record, tmp_path / "whole.kml").path.read_bytes()
    monkeypatch.setattr(kml_file, "HELD_ROWS", 1)
    assert write_kml(record, tmp_path / "single.kml").path.read_bytes() == whole


def test_hostile_text_is_neither_markup_nor_an_error(record: RunRecord, tmp_path: Path) -> None:
    hostile = "</name><b>&\x00\x1b"
    outcome = {"state": "failed", "reason": "<script>alert(1)</script>", "finished_s": None}
    run = altered(record, tmp_path / "run", name=hostile, outcomes={"blue/b1": outcome})
    text = write_kml(run, tmp_path / "tracks.kml").path.read_text(encoding="utf-8")
    document = ElementTree.fromstring(text).find("k:Document", KML)
    assert document is not None
    assert document.findtext("k:name", namespaces=KML) == "</name><b>&\ufffd\ufffd"
    description = document.findtext("k:Folder/k:Placemark/k:description", namespaces=KML)
    assert description == "failed: &lt;script&gt;alert(1)&lt;/script&gt;"  # a globe shows it as HTML
    with write_mcap(run, tmp_path / "run.mcap").path.open("rb") as file:
        (metadata,) = make_reader(file).iter_metadata()
    assert metadata.metadata["name"] == "</name><b>&\x00\x1b"


# ---------------------------------------------------------------- tables


def test_tables_have_every_recorded_row(record: RunRecord, tmp_path: Path) -> None:
    made = write_tables(record, tmp_path / "tables")
    wanted = {f"{name}.csv": record.rows(name) for name in TABLES}
    wanted |= {f"telemetry/{name}.csv": count for name, count in record.messages.items()}
    assert made.by == wanted
    for name, count in wanted.items():
        counted = duckdb.sql(f"select count(*) from read_csv('{made.path / name}', header = true)")
        assert counted is not None
        assert counted.fetchall() == [(count,)]
    truth, recorded = polars.read_csv(made.path / "truth.csv"), record.table("truth")
    assert truth.columns == recorded.column_names
    for name in truth.columns:
        assert truth[name].to_list() == recorded[name].to_pylist()  # numbers to the last digit


def test_ids_bytes_and_texts_are_read_back(record: RunRecord, tmp_path: Path) -> None:
    folder = write_tables(record, tmp_path / "tables").path
    payloads = polars.read_csv(folder / "payloads.csv", schema_overrides={"payload": polars.String})
    assert [bytes.fromhex(text) for text in payloads["payload"]] == record.table("payloads")["payload"].to_pylist()
    decisions = polars.read_csv(folder / "decisions.csv")
    recorded = record.table("decisions")
    assert [json.loads(text) for text in decisions["causes"]] == recorded["causes"].to_pylist()
    assert any(recorded["causes"].to_pylist())
    assert decisions["data"].to_list() == recorded["data"].to_pylist()
    observed = polars.read_csv(folder / "observations.csv", infer_schema_length=None)
    assert '=1+2, "survey"' in observed["self_id"].to_list()
    frames = polars.read_csv(folder / "frames.csv", infer_schema_length=None)
    assert frames["arrived_ns"].to_list() == record.table("frames")["arrived_ns"].to_pylist()


def test_columns_are_listed_with_their_units(record: RunRecord, tmp_path: Path) -> None:
    folder = write_tables(record, tmp_path / "tables").path
    told = polars.read_csv(folder / "columns.csv")
    for path in folder.rglob("*.csv"):
        name = str(path.relative_to(folder).with_suffix(""))
        if name != "columns":
            listed = told.filter(polars.col("table") == name)["column"].to_list()
            assert listed == polars.read_csv(path, infer_schema_length=None, n_rows=0).columns
    unit = {(row["table"], row["column"]): row["unit"] for row in told.to_dicts()}
    assert unit["truth", "up_m"] == "m"
    assert unit["telemetry/ATTITUDE", "roll"] == "rad"
    assert all(row["meaning"] for row in told.to_dicts())


# ---------------------------------------------------------------- the command, levels and bad input


def test_command_writes_what_is_asked_for(
    record: RunRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["export", str(record.path), "--mcap", "--kml", "--tables", "--tlog", "--out", str(tmp_path)]
    app([*asked, "--json"], standalone_mode=False)
    made = json.loads(capsys.readouterr().out)
    assert {"run.mcap", "tracks.kml", "tables/truth.csv", "tables/columns.csv", "blue.tlog"} <= set(made)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == {Path(one["path"]) for one in made.values()}
    assert all(Path(one["path"]).stat().st_size == one["bytes"] > 0 for one in made.values())
    app(asked, standalone_mode=False)
    assert f"bytes  {tmp_path}/run.mcap" in capsys.readouterr().out


@pytest.mark.parametrize("wrong", [["--only", "mavlink"], ["--receiver", "blue/b1"]])
def test_captures_and_other_files_are_two_commands(record: RunRecord, wrong: list[str]) -> None:
    with pytest.raises(InputError, match="--mcap, --kml: with --only or --receiver") as caught:
        app(["export", str(record.path), "--kml", "--mcap", *wrong], standalone_mode=False)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("level", ["study", "summary"])
def test_a_level_exports_what_it_keeps(level: str, tmp_path: Path) -> None:
    changes = SCENARIO.replace("duration_s = 9", f'duration_s = 2\nrecord = {{ level = "{level}" }}')
    run = fly(load_text(changes), tmp_path / "run")
    kept = {path.stem for path in (write_tables(run).path).glob("*.csv")} - {"columns"}
    assert kept == {name for name in TABLES if run.keeps(name)}
    if level == "summary":
        for write in (write_mcap, write_kml):
            with pytest.raises(InputError, match=r"record\.level"):
                write(run)
    else:
        assert write_mcap(run).by["/tf"] > 10
        assert set(write_kml(run).by) == {"blue/b1", "blue/b2", "red/r1"}


def test_a_run_that_did_not_end_is_exported_too(tmp_path: Path) -> None:
    """Its tables are read from the spool, and telemetry is derived now. Its world has no attitude."""
    origin = {"lat_deg": 40.778, "lon_deg": -73.955, "alt_msl_m": 20.0}
    recorder = Recorder.open(tmp_path / "run", {**HEADER, "origin": origin, "start_unix_ns": START_NS})
    tell(recorder, 20)
    recorder.flush()
    run = load(tmp_path / "run")
    assert not run.ended
    made = write_mcap(run, tmp_path / "run.mcap")
    assert (made.by["/tf"], made.by["/log/events"], made.by["/log/labels"]) == (20, 4, 2)
    turns = {tuple(one["rotation"].values()) for _, _, told in messages(made.path, "/tf") for one in told["transforms"]}
    assert turns == {(0, 0, 0, 1)}
    assert write_kml(run, tmp_path / "tracks.kml").by == {"blue/b1": 20, "blue/b2": 20, "green/g1": 20}
    rows = write_tables(run, tmp_path / "tables").by
    assert rows["telemetry/HEARTBEAT.csv"] == run.messages["HEARTBEAT"] > 10
    assert rows["frames.csv"] == run.rows("frames") > 100


@pytest.mark.parametrize("key", ["origin", "start_unix_ns"])
def test_a_manifest_without_place_or_time_is_refused(record: RunRecord, tmp_path: Path, key: str) -> None:
    run = altered(record, tmp_path / "run", **{key: None})
    for write, name in ((write_mcap, "run.mcap"), (write_kml, "tracks.kml")):
        with pytest.raises(InputError, match=key):
            write(run, tmp_path / name)
        assert not list(tmp_path.glob(f"{name}*"))


def test_a_message_name_never_becomes_a_path(record: RunRecord, tmp_path: Path) -> None:
    run = altered(record, tmp_path / "run")
    (run.path / "telemetry" / "X.parquet").write_bytes((run.path / "telemetry" / "HEARTBEAT.parquet").read_bytes())
    run.manifest["messages"] = {"../X": 1}
    with pytest.raises(InputError, match=re.escape("../X")):
        write_tables(run, tmp_path / "tables")
    assert not (tmp_path / "tables" / "X.csv").exists()


def test_a_damaged_building_is_named_and_leaves_no_file(record: RunRecord, tmp_path: Path) -> None:
    run = altered(record, tmp_path / "run")
    (run.path / "city.json").write_text('[{"height_m": 3, "rings": [[[0, 0], [1, 1]]]}]')
    with pytest.raises(InputError, match=r"city\.json: 0"):
        write_mcap(run, tmp_path / "run.mcap")
    assert not list(tmp_path.glob("run.mcap*"))


def test_a_missing_package_is_named_with_its_extra(
    record: RunRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcap", None)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(InputError, match=re.escape("pip install 'skyrange[export]'")):
        write_mcap(record, tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())
