"""Fence and rally points by the mission protocol: MissionItemProtocol_Fence.cpp, …_Rally.cpp, `validate_fence`."""

from __future__ import annotations

import math
from typing import Any

import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.layout import MAX_FENCE_ITEMS as FENCE_ITEMS
from skyrange.vehicle.builtin.locations import MAX_ITEMS as RALLY_ITEMS
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range, square
from tests.integration.hovering import V, hovering

pytestmark = pytest.mark.rotating

A = dialect
FENCE, RALLY = 1, 2
IN, OUT, RING_IN, RING_OUT, RETURN, POINT = 5001, 5002, 5003, 5004, 5000, 5100
OK, ERROR = A.MAV_MISSION_ACCEPTED, A.MAV_MISSION_ERROR

Item = tuple[int, int, float, float, float, float]
"""command, frame, param1, east, north, z"""


@pytest.fixture
def r() -> Range:
    return Range([VehicleSpec(V, 1)])


def fence(command: int, param1: float, east: float = 0.0, north: float = 0.0) -> Item:
    return command, 0, param1, east, north, 0.0


def point(east: float, north: float, up: float = 20.0, frame: int = 3) -> Item:
    return POINT, frame, 0.0, east, north, up


def box(half: float, command: int = IN, count: float = 4.0) -> list[Item]:
    return [fence(command, count, e, n) for e, n in ((-half, -half), (half, -half), (half, half), (-half, half))]


def count(r: Range, n: int, kind: int) -> None:
    r.send(V, A.MAVLink_mission_count_message(1, 1, n, kind))
    r.run(0.01)


def put_item(r: Range, kind: int, seq: int, item: Item) -> None:
    command, frame, param1, east, north, z = item
    lat, lon = r.origin.geodetic_of(east, north)
    x, y = round(lat * 1e7), round(lon * 1e7)
    r.send(V, A.MAVLink_mission_item_int_message(1, 1, seq, frame, command, 0, 0, param1, 0, 0, 0, x, y, z, kind))
    r.run(0.01)


def upload(r: Range, kind: int, items: list[Item]) -> int:
    count(r, len(items), kind)
    for seq, item in enumerate(items):
        put_item(r, kind, seq, item)
    ack = r.heard("MISSION_ACK")[-1]
    assert ack.mission_type == kind
    return int(ack.type)


def download(r: Range, kind: int) -> list[Any]:
    before = len(r.heard("MISSION_ITEM_INT"))
    r.send(V, A.MAVLink_mission_request_list_message(1, 1, kind))
    r.run(0.01)
    total = r.heard("MISSION_COUNT")[-1]
    assert total.mission_type == kind
    for seq in range(total.count):
        r.send(V, A.MAVLink_mission_request_int_message(1, 1, seq, kind))
        r.run(0.01)
    return r.heard("MISSION_ITEM_INT")[before:]


def test_a_fence_comes_back_as_it_went_in(r: Range) -> None:
    items = [*box(30.0), fence(RING_OUT, 5.5, 10.0, 10.0), *box(5.0, OUT), fence(RETURN, 0.0), fence(RING_IN, 80.25)]
    assert upload(r, FENCE, items) == OK
    assert {(m.mission_type) for m in r.heard("MISSION_REQUEST")} == {FENCE}
    got = download(r, FENCE)
    assert [(m.command, m.param1, m.seq) for m in got] == [(i[0], i[2], seq) for seq, i in enumerate(items)]
    for message, item in zip(got, items, strict=True):
        east, north = r.origin.enu_of(message.x * 1e-7, message.y * 1e-7)
        assert (east, north) == pytest.approx(item[3:5], abs=0.02)
    assert r.events("event.fence")[0].data["items"] == len(items)
    zone = r.engines[0]._fleet.fence_zones[0]
    assert zone["count"] == 4
    assert zone["kind"][:4].tolist() == [1, 4, 2, 3]
    assert zone["min_circle_radius"] == 80.25


@pytest.mark.parametrize(
    ("items", "words"),
    [
        (box(5.0)[:3], "Incorrect item count"),
        (box(5.0, count=2.0), "Invalid vertex count (2)"),
        ([*box(5.0)[:2], *box(5.0, OUT)[2:]], "Received incorrect vertex type (want=98 got=97)"),
        ([*box(5.0)[:2], *box(5.0, count=5.0)[2:]], "Unexpected vertex count want=4 got=5"),
        ([*box(5.0)[:2], fence(RING_IN, 5.0)], "Received incorrect type (want=98 got=92)"),
        ([fence(RING_IN, 0.0)], "Non-positive circle radius"),
        ([fence(RING_OUT, math.nan)], "Non-positive circle radius"),
        ([fence(RETURN, 0.0)] * 2, "Multiple return points"),
    ],
)
def test_a_fence_that_is_none_leaves_the_old_one(r: Range, items: list[Item], words: str) -> None:
    assert upload(r, FENCE, box(30.0)) == OK
    assert upload(r, FENCE, items) == ERROR
    assert words in r.words()
    assert "Fence validation failed" in r.words()
    assert len(download(r, FENCE)) == 4


@pytest.mark.parametrize(
    ("item", "result"),
    [
        ((16, 0, 0.0, 0.0, 0.0, 0.0), A.MAV_MISSION_UNSUPPORTED),
        ((IN, 1, 4.0, 0.0, 0.0, 0.0), A.MAV_MISSION_UNSUPPORTED_FRAME),
        ((IN, 0, 256.0, 0.0, 0.0, 0.0), A.MAV_MISSION_INVALID_PARAM1),
        ((OUT, 0, math.inf, 0.0, 0.0, 0.0), A.MAV_MISSION_INVALID_PARAM1),
    ],
)
def test_bad_fence_items(r: Range, item: Item, result: int) -> None:
    count(r, 4, FENCE)
    put_item(r, FENCE, 0, item)
    assert r.heard("MISSION_ACK")[-1].type == result
    assert download(r, FENCE) == []


def test_places_off_the_earth_make_no_fence(r: Range) -> None:
    count(r, 1, FENCE)
    r.send(V, A.MAVLink_mission_item_int_message(1, 1, 0, 0, RING_IN, 0, 0, 5.0, 0, 0, 0, 900000001, 0, 0.0, FENCE))
    r.run(0.01)
    assert "Bad lat or lon" in r.words()
    count(r, 1, FENCE)  # the old message, with degrees that are no numbers
    r.send(V, A.MAVLink_mission_item_message(1, 1, 0, 0, RING_IN, 0, 0, 5.0, 0, 0, 0, math.nan, math.inf, 0.0, FENCE))
    r.run(0.01)
    assert [m.type for m in r.heard("MISSION_ACK")] == [ERROR, A.MAV_MISSION_INVALID_PARAM5_X]


def test_a_fence_is_taken_whole_or_not_at_all(r: Range) -> None:
    upload(r, FENCE, box(30.0))
    count(r, 4, FENCE)
    put_item(r, FENCE, 0, box(9.0)[0])
    r.run(9.5)
    assert "Fence upload timeout" in r.words()
    ack = r.heard("MISSION_ACK")[-1]
    assert (ack.type, ack.mission_type) == (A.MAV_MISSION_OPERATION_CANCELLED, FENCE)
    east, _ = r.origin.enu_of(download(r, FENCE)[0].x * 1e-7, download(r, FENCE)[0].y * 1e-7)
    assert east == pytest.approx(-30.0, abs=0.02)


def test_part_of_a_fence_may_be_replaced(r: Range) -> None:
    upload(r, FENCE, [*box(30.0), fence(RING_OUT, 5.0)])
    r.send(V, A.MAVLink_mission_write_partial_list_message(1, 1, 4, 4, FENCE))
    r.run(0.01)
    put_item(r, FENCE, 4, fence(RING_OUT, 7.0))
    assert r.heard("MISSION_ACK")[-1].type == OK
    assert [m.param1 for m in download(r, FENCE)] == [4.0, 4.0, 4.0, 4.0, 7.0]


def test_too_much(r: Range) -> None:
    for kind, most in ((FENCE, FENCE_ITEMS), (RALLY, RALLY_ITEMS)):
        count(r, most + 1, kind)
        assert r.heard("MISSION_ACK")[-1].type == A.MAV_MISSION_NO_SPACE
        assert f"Only {most} items are supported" in r.words()
    assert upload(r, FENCE, [fence(RING_IN, 5.0)] * 43) == ERROR  # 13 bytes each, of 560
    assert "Fence exceeds storage size" in r.words()
    assert upload(r, FENCE, [fence(RING_IN, 5.0)] * 42) == OK
    assert upload(r, FENCE, [fence(IN, 69.0, e, e * e) for e in range(69)]) == OK


def test_kinds_are_transferred_apart(r: Range) -> None:
    count(r, 2, 0)
    count(r, 1, FENCE)
    count(r, 1, RALLY)
    put_item(r, RALLY, 0, point(10.0, 0.0))
    put_item(r, FENCE, 0, fence(RING_IN, 50.0))
    assert [(m.type, m.mission_type) for m in r.heard("MISSION_ACK")] == [(OK, RALLY), (OK, FENCE)]
    asked = len(r.heard("MISSION_REQUEST"))
    r.run(1.1)
    again = r.heard("MISSION_REQUEST")[asked:]
    assert {(m.seq, m.mission_type) for m in again} == {(0, 0)}  # only the mission's is still awaited


def test_clearing_one_kind_leaves_the_others(r: Range) -> None:
    r.upload(V, square(5, 5))
    upload(r, FENCE, box(30.0))
    upload(r, RALLY, [point(10.0, 0.0)])
    r.send(V, A.MAVLink_mission_clear_all_message(1, 1, FENCE))
    r.run(0.01)
    assert r.heard("MISSION_ACK")[-1].type == OK
    assert download(r, FENCE) == []
    assert len(download(r, RALLY)) == 1
    assert len(download(r, 0)) == 7
    count(r, 0, RALLY)
    assert download(r, RALLY) == []


def test_rally_points_come_back_in_whole_metres(r: Range) -> None:
    items = [point(10.0, 0.0, 25.7), point(-20.0, 5.0, 600.0, frame=5), point(0.0, 9.0, 12.0, frame=11)]
    assert upload(r, RALLY, items) == OK
    got = download(r, RALLY)
    assert [(m.command, m.frame, m.z) for m in got] == [(POINT, 3, 25.0), (POINT, 0, 600.0), (POINT, 10, 12.0)]


@pytest.mark.parametrize(
    ("item", "result"),
    [
        ((16, 3, 0.0, 0.0, 0.0, 5.0), A.MAV_MISSION_UNSUPPORTED),
        ((POINT, 1, 0.0, 0.0, 0.0, 5.0), A.MAV_MISSION_UNSUPPORTED_FRAME),
        ((POINT, 3, 0.0, 0.0, 0.0, 40000.0), A.MAV_MISSION_INVALID_PARAM7),
        ((POINT, 3, 0.0, 0.0, 0.0, math.nan), A.MAV_MISSION_INVALID_PARAM7),
    ],
)
def test_bad_rally_items(r: Range, item: Item, result: int) -> None:
    count(r, 1, RALLY)
    put_item(r, RALLY, 0, item)
    assert r.heard("MISSION_ACK")[-1].type == result
    assert download(r, RALLY) == []


def test_beyond_the_end_the_count_is_told(r: Range) -> None:
    upload(r, RALLY, [point(10.0, 0.0)])
    r.send(V, A.MAVLink_mission_request_int_message(1, 1, 1, RALLY))
    r.run(0.01)
    assert r.heard("MISSION_COUNT")[-1].count == 1
    ack = r.heard("MISSION_ACK")[-1]
    assert (ack.type, ack.mission_type) == (A.MAV_MISSION_INVALID_SEQUENCE, RALLY)


def land_at(r: Range) -> tuple[float, float]:
    r.mode(V, Mode.RTL)
    r.run_until(r.has("event.disarmed"), 120.0)
    east, north, _ = r.positions()[0]
    return float(east), float(north)


def away(**params: float) -> Range:
    """Hovering 25 m north of home."""
    r = hovering(**params)
    r.send(V, A.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0b110111111000, 25.0, 0, -10.0, *([0.0] * 8)))
    r.run(9.0)
    return r


def test_rtl_goes_to_the_nearest_rally_point_at_least_as_high_as_it() -> None:
    r = away()
    upload(r, RALLY, [point(15.0, 25.0, 22.0), point(-200.0, 0.0)])
    east, north = land_at(r)
    assert (east, north) == pytest.approx((15.0, 25.0), abs=0.7)
    highest = max(float(at[0, 2]) for _, at in r.track)
    assert highest == pytest.approx(22.0, abs=0.5)


@pytest.mark.parametrize(
    ("params", "points", "goal"),
    [
        pytest.param({}, [point(0.0, 60.0)], (0.0, 0.0), marks=pytest.mark.slow),  # home is nearer
        ({"RALLY_INCL_HOME": 0}, [point(0.0, 60.0)], (0.0, 60.0)),
        pytest.param(  # too far
            {"RALLY_INCL_HOME": 0, "RALLY_LIMIT_KM": 0.03}, [point(0.0, 60.0)], (0.0, 0.0), marks=pytest.mark.slow
        ),
        ({"RALLY_INCL_HOME": 0, "FENCE_ENABLE": 1, "FENCE_RADIUS": 50}, [point(0.0, 60.0)], (0.0, 0.0)),  # outside
    ],
)
def test_when_it_goes_home_all_the_same(
    params: dict[str, float], points: list[Item], goal: tuple[float, float]
) -> None:
    r = away(**params)
    upload(r, RALLY, points)
    r.run(0.2)
    assert land_at(r) == pytest.approx(goal, abs=0.7)
