"""A run that was recorded is read back as it was: tables, manifest, attachments, and what was derived from them."""

from __future__ import annotations

import csv
import json
import struct
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pymavlink import mavutil

from skyrange.codec.mavlink import decode
from skyrange.contracts.frames import Fate, Frame
from skyrange.contracts.mailboxes import Note
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.ids import FrameId
from skyrange.record import MemoryObserver, Recorder, RunRecord, load
from skyrange.record.schema import OPTIONAL, TABLES, TELEMETRY, arrow_schema
from skyrange.record.write.files import derivation, table_files
from tests.unit.record_sample import HEADER, LABELS, MS, VEHICLES, StillWorld, make_frame, tell, traffic

ROUNDS = 20
NAMED = {column.name for column in TELEMETRY}
"""Columns of telemetry that are no fields of a message."""


@pytest.fixture(params=["complete", "in spool", "spooled"])
def run(request: pytest.FixtureRequest, tmp_path: Path) -> RunRecord:
    """The sample run, closed, closed with its rows in the spool, and as a killed process would leave it."""
    recorder = Recorder.open(tmp_path / "run", HEADER)
    recorder.attach_file("city.json", b'[{"height_m": 5, "rings": [[[0, 0], [1, 0], [1, 1]]]}]')
    recorder.attach_file("missions/a.plan", b"{}")
    tell(recorder, ROUNDS)
    if request.param != "spooled":
        recorder.close(in_spool=request.param == "in spool")
    else:
        recorder.flush()
    return load(tmp_path / "run")


def test_one_that_ends_in_its_spool_says_how_it_ended(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER)
    tell(recorder, ROUNDS)
    recorder.close("interrupted", {"timings": {"wall_s": 1.0}}, in_spool=True)
    found = load(tmp_path / "run")
    assert (found.status, found.ended, found.manifest["spooled"]) == ("interrupted", True, True)
    assert found.manifest["counts"]["frames"] == found.rows("frames") > 0
    assert not list(found.path.glob("*.parquet"))


def test_frames_and_payloads(run: RunRecord) -> None:
    expected = list(traffic(ROUNDS))
    recorded = list(run.frames_with_payloads())
    assert len(recorded) == len(expected) == run.rows("frames")
    for was, read in zip(expected, recorded, strict=True):
        assert read.id == str(was.id)
        assert (read.src, read.dst, read.sent_ns, read.fate) == (was.src, was.dst, was.sent_ns, str(was.fate))
        assert read.arrived_ns == (was.arrived_ns if was.fate is Fate.DELIVERED else None)
        assert read.payload == was.payload
        assert read.parent == (None if was.parent is None else str(was.parent))
        assert read.causes == tuple(map(str, was.causes))


def test_payloads_are_kept_once(run: RunRecord) -> None:
    frames = list(traffic(ROUNDS))
    distinct = {frame.payload for frame in frames}
    table = run.table("payloads")
    assert table.num_rows == len(distinct) < len(frames)
    assert set(table.column("payload").to_pylist()) == distinct
    sizes = {row["payload_id"]: len(row["payload"]) for row in table.to_pylist()}
    for row in run.table("frames", ["payload_id", "size"]).to_pylist():
        assert sizes[row["payload_id"]] == row["size"]


def test_truth_to_the_bit_and_sensors(run: RunRecord) -> None:
    truth = run.table("truth")
    assert truth.num_rows == ROUNDS * len(VEHICLES)
    assert truth.column_names == ["time_ns", "vehicle", "source", "east_m", "north_m", "up_m", "throttle"]
    assert truth.column("vehicle").to_pylist()[:3] == list(VEHICLES)
    world = StillWorld()
    for tick in range(ROUNDS):
        rows = truth.slice(tick * 3, 3)
        assert set(rows.column("time_ns").to_pylist()) == {tick * 100 * MS}
        for name, values in world.truth().items():
            assert rows.column(name).to_numpy().tobytes() == values.tobytes()
    sensors = run.table("sensors")  # 2 Hz of the default against a tick each 100 ms, over 2 s
    assert sorted(set(sensors.column("time_ns").to_pylist())) == [0, 500 * MS, 1000 * MS, 1500 * MS]
    first = sensors.slice(0, 1).to_pylist()[0]
    assert (first["gnss_up_m"], first["baro_up_m"], first["attitude_z"]) == (7.0, 2.5, 0.5)
    assert first["gyro_z_radps"] == np.float32(0.1)


def test_notes_and_labels(run: RunRecord) -> None:
    decisions, events = run.table("decisions").to_pylist(), run.table("events").to_pylist()
    assert [row["kind"] for row in decisions] == ["decision.plan"]
    assert json.loads(decisions[0]["data"]) == {"items": 3, "ratio": "nan"}
    assert [row["kind"] for row in events] == ["event.armed", "event.mode", "event.outcome", "event.outcome"]
    assert events[1]["causes"] == ["l|fwd|s|4"]
    assert json.loads(events[1]["data"]) == {"mode": "AUTO", "reason": None}
    labels = run.table("labels").to_pylist()
    assert [row["action"] for row in labels] == ["delay", "replace"]
    assert labels[0]["until_ns"] == 9 * MS
    assert labels[0]["child"] is None
    assert labels[1]["child"] == str(LABELS[1].child)


def test_outcomes_city_duration(run: RunRecord) -> None:
    assert run.outcomes == {
        "blue/b1": {"state": "complete", "reason": "", "finished_s": 0.4},
        "blue/b2": {"state": "unfinished", "reason": "", "finished_s": None},
        "green/g1": {"state": "failed", "reason": "no answer", "finished_s": 0.5},
    }
    assert run.city[0]["height_m"] == 5
    assert (run.path / "missions" / "a.plan").read_bytes() == b"{}"
    assert run.duration == pytest.approx(1.9, abs=0.02)


def test_telemetry_is_what_the_ground_stations_received(run: RunRecord) -> None:
    arrivals = [f for f in traffic(ROUNDS) if f.link.startswith("gcs:") and f.direction == "rev"]
    arrivals = sorted((f for f in arrivals if f.fate is Fate.DELIVERED), key=lambda f: (f.arrived_ns, f.link))
    received: dict[str, list[Frame]] = {}
    for frame in arrivals:
        received.setdefault(decode(frame.payload).get_type(), []).append(frame)
    assert run.messages == {name: len(frames) for name, frames in sorted(received.items())}
    assert set(received) == {"ATTITUDE", "HEARTBEAT"}
    for name, frames in received.items():
        table = run.telemetry(name)
        for row, frame in zip(table.to_pylist(), frames, strict=True):
            message = decode(frame.payload)
            assert row["time_ns"] == frame.arrived_ns
            assert (row["system_id"], row["component_id"]) == (message.get_srcSystem(), 1)
            assert f"gcs:{row['vehicle']}" == frame.link
            assert row["vehicle"].split("/")[0] == row["operator"]
            assert {field: row[field] for field in message.fieldnames} == {
                field: getattr(message, field) for field in message.fieldnames
            }
    attitude = run.telemetry("ATTITUDE").schema
    assert attitude.field("roll").type == pa.float32()
    assert attitude.field("roll").metadata == {b"unit": b"rad", b"meaning": b"the field roll of ATTITUDE"}
    assert run.telemetry("HEARTBEAT").schema.field("base_mode").type == pa.uint8()
    assert run.telemetry("STATUSTEXT").num_rows == 0, "only ever sent"
    assert run.telemetry("ATTITUDE", ["roll"]).column_names == ["roll"]
    with pytest.raises(InputError, match=r"Did you mean 'ATTITUDE'"):
        run.telemetry("ATITUDE")
    with pytest.raises(InputError, match=r"record\.telemetry\('ATTITUDE'\)"):
        run.table("telemetry")


def test_telemetry_is_written_in_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder.open(tmp_path / "whole", HEADER)
    tell(recorder, ROUNDS)
    recorder.close()
    monkeypatch.setattr(table_files, "HELD_ROWS", 7)
    monkeypatch.setattr(derivation, "BLOCK_ROWS", 3)
    recorder = Recorder.open(tmp_path / "groups", HEADER)
    tell(recorder, ROUNDS)
    recorder.close()
    whole, groups = load(tmp_path / "whole"), load(tmp_path / "groups")
    assert pq.read_metadata(tmp_path / "groups" / "telemetry" / "ATTITUDE.parquet").num_row_groups > 1
    for name in whole.messages:
        assert groups.telemetry(name).equals(whole.telemetry(name))


def test_columns_are_documented_in_the_files(run: RunRecord) -> None:
    for table, columns in TABLES.items():
        schema = run.table(table).schema
        for column in columns:
            if column.name in schema.names:
                assert schema.field(column.name).metadata[b"meaning"].decode() == column.meaning
                assert schema.field(column.name).metadata[b"unit"].decode() == column.unit
    assert run.table("truth").schema.field("throttle").metadata[b"unit"] == b""
    assert run.table("truth").schema.field("east_m").metadata[b"unit"] == b"m"


def test_columns_can_be_chosen(run: RunRecord) -> None:
    table = run.table("frames", ["size", "link"])
    assert table.column_names == ["size", "link"]
    assert table.equals(run.table("frames").select(["size", "link"]))
    assert sum(batch.num_rows for batch in run.batches("frames", ["fate"])) == table.num_rows
    with pytest.raises(InputError, match="Did you mean 'truth'"):
        run.table("thruth")


def test_csv_holds_all_data_received(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER, csv=True)
    tell(recorder, ROUNDS)
    recorder.on_frame(make_frame("gcs:blue/b1", "rev", "tap", 0, 3 * MS, b"\x00garbage", arrived_ns=4 * MS))
    text = decode(list(traffic(1))[3].payload)
    recorder.on_frame(make_frame("gcs:blue/b1", "rev", "tap", 1, 5 * MS, bytes(text.get_msgbuf()), arrived_ns=6 * MS))
    recorder.close()
    with (tmp_path / "run" / "operators" / "blue.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    run = load(tmp_path / "run")
    assert [row["message"] for row in rows[:2]] == ["BAD_DATA", "HEARTBEAT"]
    assert set(run.messages) == {row["message"] for row in rows}
    for message in run.messages:
        told = [row for row in run.telemetry(message).to_pylist() if row["operator"] == "blue"]
        for read, row in zip([row for row in rows if row["message"] == message], told, strict=True):
            assert float(read["time_s"]) == pytest.approx(row["time_ns"] / 1e9, abs=1e-6)
            assert read["vehicle"] == row["vehicle"]
            for name in ("roll", "pitch", "custom_mode", "base_mode"):
                assert (float(read[name]) if read[name] else None) == row.get(name)
    assert rows[0]["system_id"] == ""
    assert {row["text"] for row in rows} == {"", 'say "0", please'}
    first = rows[1]
    assert first["utc"] == "2026-01-01T12:00:00.005Z"  # sent at 4 ms, 1 ms on the way
    green = (tmp_path / "run" / "operators" / "green.csv").read_text()
    assert "blue" not in green
    assert "green/g1" in green
    assert (tmp_path / "run" / "operators" / "idle.csv").read_text().count("\n") == 1
    fields = (tmp_path / "run" / "operators" / "fields.csv").read_text()
    assert "ATTITUDE,roll,rad" in fields
    assert "GLOBAL_POSITION_INT" not in fields


def test_tlog_is_read_back_by_pymavlink(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER, csv=True)
    tell(recorder, ROUNDS)
    recorder.on_frame(make_frame("gcs:blue/b1", "rev", "tap", 0, 3 * MS, b"\x00garbage", arrived_ns=4 * MS))
    # recorded last, sent first: a tlog is in order of time all the same
    one = next(iter(traffic(1)))
    late = make_frame("gcs:blue/b2", "fwd", "blue.gcs", 0, -50 * MS, one.payload, arrived_ns=one.arrived_ns)
    recorder.on_frame(late)
    recorder.close()
    path = tmp_path / "run" / "operators" / "blue.tlog"
    epoch_us = 1_767_268_800_000_000  # 2026-01-01T12:00:00Z
    expected = [(epoch_us - 50_000, late.payload)]
    for frame in sorted(traffic(ROUNDS), key=lambda f: (f.sent_ns if f.direction == "fwd" else f.arrived_ns, f.link)):
        if frame.link.startswith("gcs:blue/") and (frame.direction == "fwd" or frame.fate is Fate.DELIVERED):
            at = frame.sent_ns if frame.direction == "fwd" else frame.arrived_ns
            expected.append((epoch_us + at // 1000, frame.payload))
    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    read = []
    while (message := log.recv_msg()) is not None:
        read.append((round(message._timestamp * 1e6), bytes(message.get_msgbuf())))
    log.close()
    assert sorted(read) == sorted(expected)
    assert [at for at, _ in read] == sorted(at for at, _ in read)
    assert struct.unpack(">Q", path.read_bytes()[:8])[0] == epoch_us - 50_000


def test_manifest_from_start_to_end(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER)
    assert load(tmp_path / "run").status == "killed or still running"
    assert load(tmp_path / "run").table("frames").num_rows == 0
    tell(recorder, 3)
    recorder.close(extra={"simulated_s": 12.5, "timings": {"wall_s": 1.0}})
    recorder.close("failed")  # too late to change anything
    manifest = load(tmp_path / "run").manifest
    assert manifest["status"] == "complete"
    assert manifest["name"] == "sample"
    assert manifest["counts"]["frames"] == 36
    assert manifest["counts"]["truth"] == 9
    assert manifest["simulated_s"] == 12.5
    assert manifest["timings"] == {"wall_s": 1.0}
    assert set(manifest["digests"]) == {"events", "frames", "truth", "fingerprint"}
    assert manifest["versions"]["pyarrow"] == pa.__version__
    assert manifest["platform"]["numeric"]
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == sorted(
        ["manifest.json", "telemetry", *(f"{name}.parquet" for name in TABLES if name not in OPTIONAL)]
    )


def test_an_interrupted_run_is_whole(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER)
    tell(recorder, 3)
    recorder.close("interrupted")
    run = load(tmp_path / "run")
    assert run.status == "interrupted"
    assert run.rows("frames") == 36
    assert not (tmp_path / "run" / ".spool").exists()


def test_an_empty_run_has_every_table(tmp_path: Path) -> None:
    Recorder.open(tmp_path / "run", {}).close()
    run = load(tmp_path / "run")
    for name in TABLES:
        assert run.table(name).num_rows == 0
        assert run.table(name).schema.names == arrow_schema(name).names
    assert run.outcomes == {}
    assert run.city == []


def test_names_are_dictionary_encoded_in_parquet(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER)
    tell(recorder, ROUNDS)
    recorder.close()
    group = pq.read_metadata(tmp_path / "run" / "frames.parquet").row_group(0)
    columns = {group.column(k).path_in_schema: group.column(k) for k in range(group.num_columns)}
    assert columns["link"].has_dictionary_page
    assert not columns["parent"].has_dictionary_page
    assert columns["sent_ns"].encodings[0] in ("DELTA_BINARY_PACKED", "RLE")
    assert all(column.compression == "ZSTD" for column in columns.values())


def test_recorder_and_memory_agree_on_the_digests(tmp_path: Path) -> None:
    recorder, memory = Recorder.open(tmp_path / "run", HEADER, spool_bytes=1), MemoryObserver()
    tell(recorder)
    tell(memory)
    recorder.close()
    assert load(tmp_path / "run").manifest["digests"] == memory.digests.to_dict()
    assert memory.kinds("blue/b1")[:2] == ["decision.plan", "event.armed"]
    assert memory.outcomes["green/g1"]["state"] == "failed"


def test_a_note_that_is_not_scalar_blames_its_source(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER)
    bad: dict[str, object] = {"items": [1, 2], "what": object()}
    with pytest.raises(ComponentError, match=r"agent\.x: noted event\.odd"):
        recorder.on_note(0, "agent.x", Note("event.odd", "blue/b1", bad))  # type: ignore[arg-type]


def test_odd_frames_survive(tmp_path: Path) -> None:
    frames = [
        make_frame("gcs:blue/b1", "fwd", "a", 2**40, -5, b"", fate=Fate.IN_FLIGHT, arrived_ns=2**63 - 1),
        make_frame("l\u00e9", "rev", "b", 0, 0, bytes(70_000), parent=FrameId("x", "fwd", "y", 7)),
        make_frame("gcs:nobody", "rev", "a", 0, 1, b"\xfd\xff"),
    ]
    recorder = Recorder.open(tmp_path / "run", {})
    for frame in frames:
        recorder.on_frame(frame)
    recorder.close()
    read = list(load(tmp_path / "run").frames_with_payloads())
    assert [frame.id for frame in read] == [str(frame.id) for frame in frames]
    assert [frame.payload for frame in read] == [frame.payload for frame in frames]
    assert [frame.arrived_ns for frame in read] == [None, frames[1].arrived_ns, frames[2].arrived_ns]
    assert [frame.parent for frame in read] == [None, "x|fwd|y|7", None]
    assert load(tmp_path / "run").messages == {"BAD_DATA": 1}
