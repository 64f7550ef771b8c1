"""Are the messages of a DataFlash log, and what they are made of, as ArduPilot has them?"""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.DFReader import FORMAT_TO_STRUCT, DFReader_binary
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skyrange.core.geodesy import Origin
from skyrange.export.dataflash_events import EventRows
from skyrange.export.dataflash_messages import DEFINITIONS, encode_definitions
from skyrange.export.dataflash_missions import MissionFrame, StoredMission
from skyrange.export.dataflash_rows import (
    HeldValues,
    attitudes_of_angles,
    attitudes_of_truth,
    encode_in_order,
    make_rows,
    scaled,
)
from skyrange.export.dataflash_states import gps_time
from skyrange.record.read.time_order import align_sorted

SIZES = {"a": 64, "b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "f": 4, "d": 8, "n": 4, "N": 16, "Z": 64, "c": 2,
         "C": 2, "e": 4, "E": 4, "L": 4, "M": 1, "q": 8, "Q": 8}  # fmt: skip
"""Bytes of each character of a format (AP_Logger/README.md)."""


@pytest.mark.parametrize("name", DEFINITIONS)
def test_a_definition_fits_into_its_fmt(name: str) -> None:
    """The lengths are those of the fields of FMT and FMTU (LS_NAME_SIZE and others in LogStructure.h)."""
    found = DEFINITIONS[name]
    assert len(name) <= 4
    assert len(found.format) == len(found.labels) == len(found.units) == len(found.multipliers) <= 16
    assert len(",".join(found.labels)) <= 64
    assert found.layout.itemsize == 3 + sum(SIZES[kind] for kind in found.format) < 256
    assert set(found.format) <= set(FORMAT_TO_STRUCT)
    assert name in ("FMT", "LABL") or found.labels[0] == "TimeUS"


def test_a_log_defines_itself_to_another_reader(tmp_path: Path) -> None:
    names = [name for name in DEFINITIONS if name not in ("FMT", "UNIT", "MULT", "FMTU")]
    path = tmp_path / "a.BIN"
    path.write_bytes(encode_definitions(names))
    reader = DFReader_binary(str(path))
    known = {one.name: one for one in reader.formats.values()}
    for name in names:
        assert known[name].format == DEFINITIONS[name].format
        assert tuple(known[name].columns) == DEFINITIONS[name].labels
    # pymavlink puts the multiplier before the unit
    assert known["POS"].units == ["µs", "deglatitude", "deglongitude", "m", "m", "m"]
    assert known["GPS"].units[:5] == ["µs", "instance", "", "ms", ""]
    assert known["IMU"].units[2:8] == ["rad/s"] * 3 + ["m/s/s"] * 3
    reader.close()


@pytest.mark.parametrize(
    ("moment", "week", "ms"),
    [
        # IS-GPS-200: week 0 begins at 1980-01-06; leap seconds by IERS Bulletin C
        ("1980-01-06T00:00:00", 0, 0),
        ("1999-08-21T23:59:47", 1024, 0),  # the first rollover: 13 s ahead of UTC
        ("2016-12-31T23:59:59", 1930, 16_000),
        ("2017-01-01T00:00:00", 1930, 18_000),
        ("2019-04-06T23:59:42", 2048, 0),  # the second rollover: 18 s ahead
        ("2026-01-01T12:00:00", 2399, 388_818_000),
        ("1979-01-01T00:00:00", 0, 0),
    ],
)
def test_gps_time_counts_leap_seconds(moment: str, week: int, ms: int) -> None:
    utc_ns = int(datetime.fromisoformat(moment).replace(tzinfo=UTC).timestamp()) * 1_000_000_000
    assert [values.tolist() for values in gps_time(np.array([utc_ns]))] == [[week], [ms]]


ANGLE = st.floats(-math.pi, math.pi)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_attitudes_of_truth_are_those_of_the_same_angles(roll: float, pitch: float, yaw: float) -> None:
    """From axes: where the nose, the left side and the top point, east-north-up, of an aircraft with these angles."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    ned = np.array(  # body forward-right-down to north-east-down: yaw, then pitch, then roll
        [
            [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp],
        ]
    )
    exchange = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    enu = exchange @ ned @ np.diag([1.0, -1.0, -1.0])
    w, x, y, z = _quaternion(enu)
    found = attitudes_of_truth(*(np.array([part]) for part in (w, x, y, z)))
    same = attitudes_of_angles(*(np.array([angle]) for angle in (roll, pitch, yaw)))
    assert abs(abs(float((found.quaternion[0] * same.quaternion[0]).sum())) - 1.0) < 1e-9
    off_deg = [found.roll_deg[0] - math.degrees(roll), found.pitch_deg[0] - math.degrees(pitch),
               found.yaw_deg[0] - math.degrees(yaw)]  # fmt: skip
    assert all(abs((off + 180.0) % 360.0 - 180.0) < 1e-5 for off in off_deg)


def _quaternion(matrix: Any) -> tuple[float, float, float, float]:
    """Of a rotation matrix, by its eigenvector (I. Y. Bar-Itzhack, J. Guidance 23, 2000)."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    form = np.array(
        [
            [a - e - i, d + b, g + c, h - f],
            [d + b, e - a - i, h + f, c - g],
            [g + c, h + f, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    _, vectors = np.linalg.eigh(form / 3.0)
    x, y, z, w = vectors[:, -1].tolist()
    return w, x, y, z


def test_a_held_value_is_the_newest_before_and_not_too_old() -> None:
    held = HeldValues(1, 100)
    held.add(np.array([0, 0, 1]), np.array([10, 50, 20]), np.array([[1.0], [2.0], [3.0]]))
    found = held.find(np.array([0, 0, 0, 0, 1, 2]), np.array([9, 10, 60, 151, 20, 20]))[:, 0]
    assert np.array_equal(found, [np.nan, 1.0, 2.0, np.nan, 3.0, np.nan], equal_nan=True)
    held.forget()
    assert held.find(np.array([0]), np.array([60]))[0, 0] == 2.0


def test_messages_are_in_order_of_time_and_then_of_kind() -> None:
    def rows(name: str, *times: tuple[int, int], **fields: Any) -> Any:
        vehicle, time_ns = (np.array(values) for values in zip(*times, strict=True))
        return make_rows(name, vehicle, time_ns, **fields)

    parts = [rows("EV", (1, 3_000), (0, 2_000), Id=[1, 2]), rows("ERR", (0, 2_000), (0, 1_000), Subsys=[3, 4])]
    found = dict(encode_in_order(parts))
    assert [*found] == [0, 1]
    ev, err = DEFINITIONS["EV"], DEFINITIONS["ERR"]
    assert found[0] == err.encode(1, 4, 0) + ev.encode(2, 2) + err.encode(2, 3, 0)
    assert found[1] == ev.encode(3, 1)


def test_numbers_beyond_a_field_are_limited() -> None:
    assert scaled([1e9, -1e9, math.nan, 0.126], 100.0, (-32_768, 32_767)).tolist() == [32_767, -32_768, 0, 13]


@given(st.lists(st.lists(st.lists(st.integers(0, 40), max_size=6), max_size=5), min_size=1, max_size=3))
def test_spans_of_streams_have_every_row_once_and_follow_each_other(streams: list[list[list[int]]]) -> None:
    flat = [sorted(key for part in parts for key in part) for parts in streams]

    def tables(keys: list[int], parts: list[list[int]]) -> Iterator[pa.Table]:
        start = 0
        for part in parts:
            yield pa.table({"k": pa.array(keys[start : start + len(part)], pa.int64())})
            start += len(part)

    named = {str(n): tables(keys, parts) for n, (keys, parts) in enumerate(zip(flat, streams, strict=True))}
    spans = [{name: table.column("k").to_pylist() for name, table in span.items()} for span in align_sorted(named, "k")]
    for n, keys in enumerate(flat):
        assert [key for span in spans for key in span.get(str(n), [])] == keys
    spans = [span for span in spans if span]
    for before, after in pairwise(spans):
        assert max(max(keys) for keys in before.values()) < min(min(keys) for keys in after.values())


# ---------------------------------------------------------------- missions

PEER = (255, 190)


def frame(message_id: int, peer: tuple[int, int] = PEER, **values: Any) -> MissionFrame:
    return MissionFrame(0, 0, message_id, peer, values)


def count(number: int, peer: tuple[int, int] = PEER) -> MissionFrame:
    return frame(mavlink.MAVLINK_MSG_ID_MISSION_COUNT, peer, count=number)


def item(seq: int, command: int, peer: tuple[int, int] = PEER) -> MissionFrame:
    params = {f"param{number}": float(number) for number in range(1, 5)}
    place = {"x": np.int32(471_234_567), "y": np.int32(-7), "z": 30.0, "frame": 3}
    return frame(mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT, peer, seq=seq, command=command, **params, **place)


def ack(peer: tuple[int, int] = PEER) -> MissionFrame:
    return frame(mavlink.MAVLINK_MSG_ID_MISSION_ACK, peer)


def commands(mission: StoredMission, number: int) -> list[int] | None:
    rows = mission.rows(0, 5_000, number)
    return None if rows is None else rows.records["CId"].tolist()


def stored(*frames: MissionFrame) -> StoredMission:
    mission = StoredMission()
    for one in frames:
        mission.take(one)
    return mission


def test_an_item_is_taken_when_it_is_waited_for() -> None:
    """A repeated item, one out of turn, and one of another sender change nothing."""
    other = (1, 2)
    mission = stored(count(2), item(1, 99), item(0, 16), item(0, 98), item(1, 97, other), item(1, 22), ack())
    assert commands(mission, 2) == [16, 22]
    rows = mission.rows(0, 5_000, 2)
    assert rows is not None
    row = rows.records[1]
    assert (row["TimeUS"], row["CTot"], row["CNum"], row["Lat"], row["Lng"], row["Alt"], row["Frame"]) == (
        5, 2, 1, 471_234_567, -7, 30.0, 3,
    )  # fmt: skip
    assert [row[f"Prm{number}"] for number in range(1, 5)] == [1.0, 2.0, 3.0, 4.0]


def test_a_partial_upload_replaces_items_of_the_mission() -> None:
    partial = frame(mavlink.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST, start_index=1, end_index=1)
    mission = stored(count(3), item(0, 16), item(1, 22), item(2, 21), ack())
    assert commands(mission, 3) == [16, 22, 21]
    mission.take(partial)
    mission.take(item(1, 17))
    assert commands(mission, 3) == [16, 17, 21]


def test_a_mission_of_which_no_frame_tells_is_unknown() -> None:
    assert commands(stored(), 4) is None
    assert commands(stored(count(2), item(0, 16)), 2) is None
    assert commands(stored(), 0) == []


def test_an_item_with_degrees_has_the_same_place() -> None:
    old = item(0, 16)
    mission = stored(count(1), old._replace(values={**old.values, "x": np.float32(47.5), "y": np.float32(8.25)}), ack())
    rows = mission.rows(0, 0, 1)
    assert rows is not None
    assert rows.records[["Lat", "Lng"]].tolist() == [(475_000_000, 82_500_000)]


# ---------------------------------------------------------------- events


def logged(*notes: tuple[str, str]) -> list[tuple[str, tuple[Any, ...]]]:
    """Name and fields, but for the time, of what events are logged as."""
    table = pa.table(
        {
            "time_ns": pa.array([1_000] * len(notes), pa.int64()),
            "kind": [kind for kind, _ in notes],
            "about": ["blue/b1"] * len(notes),
            "data": [data for _, data in notes],
        }
    )
    rows = EventRows(["blue/b1"], {0: {"ARMING_CHECK": 72.0}}, Origin(47.0, 8.0, 400.0))
    found = rows.rows(table, lambda _vehicle, _time, _count: None)
    return [(part.name, tuple(part.records[0].item()[2:])) for part in found]


@pytest.mark.parametrize(
    ("kind", "data", "expected"),
    [
        # LogEvent, LogErrorSubsystem and LogErrorCode (AP_Logger.h), Method (AP_Arming.h), ModeReason (ModeReason.h)
        ("event.armed", '{"forced": true}', [("ARM", (1, 72, 1, 100)), ("EV", (10,))]),
        ("event.disarmed", '{"reason": "landed"}', [("ARM", (0, 72, 0, 13)), ("EV", (11,))]),
        ("event.disarmed", '{"reason": "crash"}', [("ERR", (12, 1)), ("ARM", (0, 72, 0, 12)), ("EV", (11,))]),
        ("event.takeoff", "{}", [("EV", (28,))]),
        ("event.landed", "{}", [("EV", (18,))]),
        ("event.mode", '{"number": 6, "reason": "gcs_failsafe"}', [("ERR", (8, 1)), ("MODE", (6, 6, 5))]),
        ("event.mode", '{"number": 3, "reason": "of another version"}', [("MODE", (3, 3, 0))]),
        ("event.battery", '{"level": "low"}', [("ERR", (6, 1))]),
        ("event.ekf_failsafe", '{"on": true}', [("ERR", (16, 2)), ("ERR", (17, 1))]),
        ("event.ekf_failsafe", '{"on": false}', [("ERR", (16, 0)), ("ERR", (17, 0))]),
        ("event.fence_breach", '{"fence": "Max Alt and Polygon fences"}', [("ERR", (9, 5))]),
        ("event.fence_cleared", "{}", [("ERR", (9, 0))]),
        ("event.glitch", '{"on": true}', [("ERR", (11, 2))]),
        ("event.home", '{"east_m": 0, "north_m": 0, "up_m": 2}',
         [("EV", (25,)), ("ORGN", (1, 470_000_000, 80_000_000, 40_200))]),
        ("event.item_reached", '{"seq": 3}', []),
        ("event.battery", "no JSON", [("ERR", (6, 1))]),
        ("event.home", "{}", [("EV", (25,))]),
        ("event.home", '{"east_m": "far", "north_m": 0, "up_m": 2}', [("EV", (25,))]),
        ("event.mode", '{"number": "NaN", "reason": 7}', []),
        ("event.mode", '{"number": null}', []),
        ("event.mission", '{"items": "many"}', []),
        ("event.reboot", '{"system_id": []}', [("MSG", (b"skyrange: reboot. A real log would end here",))]),
    ],
)  # fmt: skip
def test_an_event_is_logged_as_arducopter_does(kind: str, data: str, expected: list[Any]) -> None:
    assert logged((kind, data)) == expected


def test_a_parameter_that_is_set_is_logged_with_its_default() -> None:
    ((name, (label, value, default)),) = logged(("event.parameter", '{"name": "RTL_ALT", "value": 2500}'))
    assert (name, label, value) == ("PARM", b"RTL_ALT", 2500.0)
    assert default == 1500.0  # ArduCopter/config.h, RTL_ALT
    ((_, (_, _, unknown)),) = logged(("event.parameter", '{"name": "MINE", "value": 1}'))
    assert math.isnan(unknown)


def test_events_of_others_are_no_part_of_a_log() -> None:
    table = pa.table({"time_ns": [0], "kind": ["event.armed"], "about": ["blue/b2"], "data": ["{}"]})
    rows = EventRows(["blue/b1"], {0: {}}, Origin(47.0, 8.0))
    assert not list(rows.rows(table, lambda *_: None))
