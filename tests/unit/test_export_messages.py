"""What goes into the files for other tools, of rows that no flight here has: broken ones, unknown ones, long runs."""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import duckdb
import jsonschema
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.export import kml_file, knowledge_messages
from skyrange.export.csv_tables import print_cells
from skyrange.export.foxglove_messages import building_messages, log_messages, pose_messages, whole_ticks
from skyrange.export.foxglove_schemas import ACT, SCHEMAS
from skyrange.export.kml_file import write_kml, xml_text
from skyrange.export.knowledge_messages import CLAIMS_TOPIC, act_messages, claim_messages, reception_messages
from skyrange.figures.palette import ThemeColour
from skyrange.metrics.time_series import start_utc_ns
from skyrange.record import RunRecord
from skyrange.record.read.tables import Tables
from skyrange.record.schema import arrow_schema

START_NS = 1_767_268_800_000_000_000
ORIGIN = {"lat_deg": 40.778, "lon_deg": -73.955, "alt_msl_m": 20.0, "geoid_m": -32.7}
MANIFEST = {
    "format": "skyrange.run/1", "status": "complete", "record": {"level": "full"}, "start_unix_ns": START_NS,
    "origin": ORIGIN, "outcomes": {},
    "operators": [{"id": "blue"}], "vehicles": [{"id": "blue/b1", "operator": "blue"}],
}  # fmt: skip


class FakeTables(Tables):
    """Batches of some tables, counted as they are read."""

    def __init__(self, **batches: Sequence[Sequence[dict[str, Any]]]) -> None:
        super().__init__(Path("run"), False)
        object.__setattr__(self, "_batches", batches)
        object.__setattr__(self, "counted", [])

    def schema(self, name: str) -> pa.Schema:
        return arrow_schema(name)

    def batches(
        self, name: str, columns: Sequence[str] | None = None, *, encoded: bool = False
    ) -> Iterator[pa.RecordBatch]:
        for rows in self._batches.get(name, ()):  # type: ignore[attr-defined]
            self.counted.append(name)  # type: ignore[attr-defined]
            batch = pa.RecordBatch.from_pylist(list(rows), schema=arrow_schema(name))
            yield batch if columns is None else batch.select(list(columns))


def record(**batches: Sequence[Sequence[dict[str, Any]]]) -> RunRecord:
    return RunRecord(Path("run"), dict(MANIFEST), FakeTables(**batches))


def row(time_ns: int, vehicle: str = "blue/b1", **values: Any) -> dict[str, Any]:
    zeros = {field.name: 0.0 for field in arrow_schema("truth")}
    return {**zeros, "time_ns": time_ns, "vehicle": vehicle, "source": "dynamic", "qw": 1.0, **values}


def poses(run: RunRecord) -> Iterator[Any]:
    colours = {"blue/b1": ThemeColour("#0000ff", "#8080ff")}
    return pose_messages(run, Origin(40.778, -73.955, 20.0, -32.7), START_NS, colours)


# ---------------------------------------------------------------- poses


@given(st.lists(st.lists(st.integers(0, 3), max_size=4), max_size=6))
def test_ticks_are_never_divided(steps: list[list[int]]) -> None:
    times: list[list[int]] = []
    now = 0
    for batch in steps:
        times.append([])
        for step in batch:
            now += step
            times[-1].append(now)
    batches = [pa.RecordBatch.from_pydict({"time_ns": pa.array(part, pa.int64())}) for part in times]
    tables = [table.column("time_ns").to_pylist() for table in whole_ticks(batches)]
    assert list(chain(*tables)) == list(chain(*times))
    assert all(tables)
    assert all(a[-1] < b[0] for a, b in pairwise(tables))


def test_a_long_run_is_read_as_it_is_written() -> None:
    run = record(truth=[[row(100 * n + k) for k in range(100)] for n in range(50)])
    ticks = 0
    for message in poses(run):
        if message.topic == "/tf":
            ticks += 1
            assert len(run.tables.counted) <= message.time_ns // 100 + 2  # type: ignore[attr-defined]
    assert ticks == 5_000
    assert len(run.tables.counted) == 50  # type: ignore[attr-defined]


def test_rows_without_a_position_or_rotation() -> None:
    nan = math.nan
    run = record(
        truth=[
            [
                row(0, east_m=nan),
                row(1, qw=nan, qx=1.0),
                row(1, "blue/b2", qw=0.0),
                row(2, up_m=math.inf),
                row(3, qw=0.0, qx=1.0),
            ]
        ]
    )
    told = [(one.time_ns, json.loads(one.json)["transforms"]) for one in poses(run) if one.topic == "/tf"]
    found = [
        (at, [(one["child_frame_id"], one["rotation"]["x"], one["rotation"]["w"]) for one in all_]) for at, all_ in told
    ]
    assert found == [(1, [("blue/b1", 0.0, 1.0), ("blue/b2", 0.0, 1.0)]), (3, [("blue/b1", 1.0, 0.0)])]


def test_an_aircraft_that_appears_later_is_drawn_with_all_others() -> None:
    run = record(truth=[[row(0)], [row(5), row(5, "honest/x")], [row(9)]])
    drawn = [
        (one.time_ns, [entity["id"] for entity in json.loads(one.json)["entities"]])
        for one in poses(run)
        if one.topic == "/scene/aircraft"
    ]
    assert drawn == [(0, ["blue/b1"]), (5, ["blue/b1", "honest/x"])]


def test_a_courtyard_and_a_raised_floor_are_drawn() -> None:
    court = {"height_m": 9, "rings": [[[0, 0], [9, 0], [9, 9], [0, 9]], [[3, 3], [3, 6], [6, 6], [6, 3]]]}
    bridge = {"height_m": 9, "base_m": 5, "rings": [[[20, 0], [24, 0], [24, 4], [20, 4]]]}
    for city, roofs, floors in (([court], 81 - 9, 0.0), ([bridge], 16, 16.0)):
        (message,) = building_messages(city, START_NS, "run")
        (shape,) = json.loads(message.json)["entities"][0]["triangles"]
        points = [(one["x"], one["y"], one["z"]) for one in shape["points"]]
        flat = dict.fromkeys((0.0, 5.0, 9.0), 0.0)
        for a, b, c in zip(*[iter(shape["indices"])] * 3, strict=True):
            (ax, ay, az), (bx, by, bz), (cx, cy, cz) = points[a], points[b], points[c]
            if az == bz == cz:
                flat[az] += ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)) / 2  # negative if seen from below
        assert flat[9.0] == pytest.approx(roofs)
        assert flat[5.0] == pytest.approx(-floors)
        assert flat[0.0] == 0.0


# ---------------------------------------------------------------- logs


def test_labels_and_alerts_say_all_that_they_have() -> None:
    usual = {"attack": "late", "actor": "late.tap", "frame": "gcs:blue/b1|fwd|s|1", "benign": False, "fault": False}
    labels = [
        {**usual, "at_ns": 7, "action": "delay", "child": None, "until_ns": 1_500_000_000},
        {**usual, "at_ns": 3, "action": "replace", "child": "gcs:blue/b1|fwd|t|0", "until_ns": None, "benign": True},
        {
            **usual,
            "at_ns": 4,
            "action": "inject",
            "child": None,
            "until_ns": None,
            "benign": True,
            "harmless_intrusion": True,
        },
    ]
    alert = {
        "time_ns": 5, "detector": "rules", "kind": "mavlink.source", "subject": "blue/b1", "score": 2.5, "at_ns": 4,
        "data": '{"system": 9}',
    }  # fmt: skip
    run = record(labels=[labels], alerts=[[alert]])
    found = [
        (one.time_ns, json.loads(one.json))
        for name in ("labels", "alerts")
        for one in log_messages(run, name, START_NS)
    ]
    assert [(at, told["level"], told["name"], told["message"]) for at, told in found] == [
        (3, 2, "late.tap", "late: replace gcs:blue/b1|fwd|s|1 by gcs:blue/b1|fwd|t|0 (benign)"),
        (4, 2, "late.tap", "late: inject gcs:blue/b1|fwd|s|1 (harmless intrusion)"),
        (7, 3, "late.tap", "late: delay gcs:blue/b1|fwd|s|1 until 1.500000 s"),
        (5, 3, "rules", 'blue/b1: mavlink.source 2.5 {"system": 9}'),
    ]
    assert found[0][1]["timestamp"] == {"sec": START_NS // 1_000_000_000, "nsec": 3}


# ---------------------------------------------------------------- acts, receptions and claims

names = st.text(max_size=8)
places = st.none() | st.floats()


@given(
    st.lists(
        st.fixed_dictionaries(
            {
                "at_ns": st.integers(0, 10**10), "attack": names, "actor": names, "action": names, "frame": names,
                "child": st.none() | names, "until_ns": st.none() | st.integers(0, 10**10), "benign": st.booleans(),
                "fault": st.booleans(), "harmless_intrusion": st.booleans(),
            }
        ),
        max_size=6,
    )
)  # fmt: skip
def test_each_label_is_one_act_at_its_time(labels: list[dict[str, Any]]) -> None:
    told = [(one.time_ns, json.loads(one.json)) for one in act_messages(record(labels=[labels]), START_NS)]
    rows = sorted(labels, key=lambda row: row["at_ns"])
    assert [at_ns for at_ns, _ in told] == [row["at_ns"] for row in rows]
    keep = ("attack", "actor", "action", "frame", "child")
    assert Counter(tuple(one[name] for name in keep) for _, one in told) == Counter(
        tuple(row[name] for name in keep) for row in rows
    )
    authors = Counter("fault" if row["fault"] else "harmless" if row["benign"] else "attack" for row in rows)
    assert Counter(one["author"] for _, one in told) == authors
    for at_ns, one in told:
        jsonschema.validate(one, SCHEMAS[ACT])
        assert one["timestamp"] == {
            "sec": (START_NS + at_ns) // 10**9,
            "nsec": (START_NS + at_ns) % 10**9,
        }


@given(
    st.lists(
        st.fixed_dictionaries(
            {
                "time_ns": st.integers(0, 10**10), "receiver": names, "radio": names, "frame": st.sampled_from("abc"),
                "uas_id": st.none() | names, "rssi_dbm": st.floats(width=32), "east_m": places, "north_m": places,
                "up_m": places, "height_m": places, "lat_deg": places, "lon_deg": places, "alt_geo_m": places,
            }
        ),
        max_size=8,
    )
)  # fmt: skip
@pytest.mark.rotating
def test_each_reception_is_told_and_each_broadcast_with_a_place_is_one_claim(rows: list[dict[str, Any]]) -> None:
    full = [dict.fromkeys(arrow_schema("observations").names) | {"transport": "bt4"} | row for row in rows]
    run = record(observations=[full[:3], full[3:]])
    receptions = list(reception_messages(run, START_NS))
    assert sorted(one.time_ns for one in receptions) == sorted(row["time_ns"] for row in rows)
    claims = list(claim_messages(run, START_NS, {}))
    placed = [row for row in rows if all(math.isfinite(row[key] or 0.0) and row[key] is not None for key in PLACE)]
    told = [json.loads(one.json) for one in claims if one.topic == CLAIMS_TOPIC]
    assert {one["frame"] for one in told} == {row["frame"] for row in placed}
    assert len(told) == len({row["frame"] for row in placed}) == len(claims) - len(told)
    for message in (*receptions, *claims):
        jsonschema.validate(json.loads(message.json), SCHEMAS[message.schema])
    for one, message in zip(told, claims[::2], strict=True):
        assert message.time_ns == min(row["time_ns"] for row in placed if row["frame"] == one["frame"])


PLACE = ("east_m", "north_m")


def test_claims_are_told_once_also_beyond_what_is_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(knowledge_messages, "_SEEN", 4)
    empty = dict.fromkeys(arrow_schema("observations").names) | {"receiver": "r", "radio": "x", "transport": "bt4"}
    rows = [
        empty | {"time_ns": 10**8 * n + late, "frame": f"f{n}", "rssi_dbm": 0.0, "east_m": 1.0, "north_m": 2.0}
        for n in range(200)
        for late in (0, 5, 10**7)
    ]
    told = [json.loads(one.json) for one in claim_messages(record(observations=[rows]), START_NS, {})]
    assert [one["frame"] for one in told if "frame" in one] == [f"f{n}" for n in range(200)]


# ---------------------------------------------------------------- KML


def test_aircraft_that_the_manifest_does_not_name_have_a_folder(tmp_path: Path) -> None:
    run = record(truth=[[row(0, "honest/x"), row(0), row(0, "blue/new"), row(1_500, "honest/x")]])
    made = write_kml(run, tmp_path / "tracks.kml")
    assert made.by == {"blue/b1": 1, "blue/new": 1, "honest/x": 2}
    text = made.path.read_text(encoding="utf-8")
    assert text.count("<Folder>") == text.count("</Folder>") == 2
    assert "<when>2026-01-01T12:00:00.000001Z</when>" in text  # finer than a millisecond


def test_memory_holds_a_group_of_tracks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kml_file, "HELD_ROWS", 10)
    groups = list(kml_file._groups({"a": 4, "b": 6, "c": 1, "d": 12, "e": 2}))
    assert groups == [["a", "b"], ["c"], ["d"], ["e"]]


def test_a_run_without_truth_has_no_tracks(tmp_path: Path) -> None:
    made = write_kml(record(), tmp_path / "tracks.kml")
    assert made.items == 0
    assert "Folder" not in made.path.read_text(encoding="utf-8")


@given(st.text())
def test_any_text_is_an_xml_text(text: str) -> None:
    from xml.etree import ElementTree

    read = ElementTree.fromstring(f"<a>{xml_text(text)}</a>".encode()).text or ""
    assert len(read) <= len(text)
    if text.isprintable():
        assert read == text


@pytest.mark.parametrize("wrong", [None, -1, True, "12", 2**63])
def test_a_start_that_no_file_can_state(wrong: object) -> None:
    with pytest.raises(InputError, match="start_unix_ns"):
        start_utc_ns(RunRecord(Path("run"), {"start_unix_ns": wrong}, FakeTables()))


# ---------------------------------------------------------------- CSV


@given(st.lists(st.text(st.characters(exclude_characters="\0", codec="utf-8")), min_size=1, max_size=5))
def test_any_text_is_read_back_from_its_cell(texts: list[str]) -> None:
    line = ",".join(print_cells(pa.array(texts)).to_pylist())
    assert next(csv.reader(io.StringIO(line, newline=""))) == texts


@given(st.lists(st.floats(), min_size=1))
def test_numbers_keep_their_digits_and_type(numbers: list[float]) -> None:
    cells = print_cells(pa.array(numbers)).to_pylist()
    assert [repr(float(cell)) for cell in cells] == [repr(number) for number in numbers]
    assert not any(cell.lstrip("-").isdigit() for cell in cells)


def test_nulls_differ_from_empty_texts(tmp_path: Path) -> None:
    columns = [pa.array(["", None, "a,b"]), pa.array([1.0, None, math.nan]), pa.array([[], None, ["x", "y"]])]
    cells = [print_cells(column).to_pylist() for column in columns]
    lines = [",".join(cell or "" for cell in line) for line in zip(*cells, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["t,f,l", *lines, ""]))
    relation = duckdb.sql(f"select * from read_csv('{tmp_path / 'a.csv'}', allow_quoted_nulls = false)")
    assert relation is not None
    found = relation.fetchall()
    assert found[:2] == [("", 1.0, "[]"), (None, None, None)]
    assert found[2][0] == "a,b"
    assert math.isnan(found[2][1])
    assert json.loads(found[2][2]) == ["x", "y"]
