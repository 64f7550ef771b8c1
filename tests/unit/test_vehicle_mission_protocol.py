"""The mission protocol's server side, by https://mavlink.io/en/services/mission.html and MissionItemProtocol.cpp."""

from __future__ import annotations

import math
from typing import Any

import pytest

from skyrange.codec.mavlink import Packer, dialect
from skyrange.vehicle.builtin.mission_protocol.server import MAX_ITEMS
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import ORIGIN, Item, Range, jump, rtl, speed, square, takeoff, waypoint

V = "blue/b1"
A = dialect


@pytest.fixture
def r() -> Range:
    return Range([VehicleSpec(V, 1)])


def count(r: Range, n: int, kind: int = 0) -> None:
    r.send(V, A.MAVLink_mission_count_message(1, 1, n, kind))
    r.run(0.01)


def acks(r: Range) -> list[int]:
    return [m.type for m in r.heard("MISSION_ACK")]


def requests(r: Range) -> list[int]:
    return [m.seq for m in r.heard("MISSION_REQUEST")]


def put(r: Range, seq: int, item: Item) -> None:
    r.send(V, r.item(V, seq, item))
    r.run(0.01)


def download(r: Range) -> list[Any]:
    before = len(r.heard("MISSION_ITEM_INT"))
    r.send(V, A.MAVLink_mission_request_list_message(1, 1, 0))
    r.run(0.01)
    for seq in range(r.heard("MISSION_COUNT")[-1].count):
        r.send(V, A.MAVLink_mission_request_int_message(1, 1, seq, 0))
        r.run(0.01)
    return r.heard("MISSION_ITEM_INT")[before:]


def test_upload_and_read_back(r: Range) -> None:
    items = [takeoff(5), waypoint(3, 4, 5, hold_s=2.0), jump(2, 3), speed(4.0), rtl()]
    assert r.upload(V, items) == A.MAV_MISSION_ACCEPTED
    assert requests(r) == [0, 1, 2, 3, 4, 5]
    got = download(r)
    assert [m.seq for m in got] == [0, 1, 2, 3, 4, 5]
    home = got[0]
    assert (home.x, home.y, home.z) == (round(ORIGIN.lat_deg * 1e7), round(ORIGIN.lon_deg * 1e7), 584.0)
    for message, item in zip(got[1:], items, strict=True):
        sent = r.item(V, message.seq, item)
        assert (message.command, message.param1, message.param2) == (sent.command, sent.param1, sent.param2)
        if message.command in (A.MAV_CMD_NAV_WAYPOINT, A.MAV_CMD_NAV_TAKEOFF):
            assert (message.x, message.y, message.z, message.frame) == (sent.x, sent.y, sent.z, sent.frame)
    assert {(m.target_system, m.target_component) for m in got} == {(255, 190)}


def test_legacy_items_and_requests(r: Range) -> None:
    count(r, 2)
    for seq in (0, 1):
        lat, lon = ORIGIN.geodetic_of(10.0, 20.0)
        r.send(V, A.MAVLink_mission_item_message(1, 1, seq, 3, 16, 0, 1, 0, 0, 0, 0, lat, lon, 12.0, 0))
        r.run(0.01)
    assert acks(r) == [A.MAV_MISSION_ACCEPTED]
    r.send(V, A.MAVLink_mission_request_message(1, 1, 1, 0))
    r.run(0.01)
    item = r.heard("MISSION_ITEM")[-1]
    assert item.x == pytest.approx(lat, abs=1e-5)  # a single float
    assert item.z == 12.0


def test_unanswered_request_is_repeated_then_given_up(r: Range) -> None:
    count(r, 3)
    r.run(3.5)
    assert requests(r) == [0, 0, 0, 0]
    put(r, 0, waypoint(0, 0, 0))
    r.run(9.6)
    assert acks(r) == [A.MAV_MISSION_OPERATION_CANCELLED]
    assert "Mission upload timeout" in r.words()
    r.run(3.0)
    assert len(acks(r)) == 1


def test_wrong_sequence_is_refused_and_the_upload_goes_on(r: Range) -> None:
    count(r, 2)
    put(r, 1, takeoff(5))
    assert acks(r) == [A.MAV_MISSION_INVALID_SEQUENCE]
    put(r, 0, waypoint(0, 0, 0))
    put(r, 1, takeoff(5))
    assert acks(r)[-1] == A.MAV_MISSION_ACCEPTED


def test_another_station_is_denied_while_one_uploads(r: Range) -> None:
    count(r, 2)
    other = Packer(254, 1)
    r.send_bytes(V, other.pack(A.MAVLink_mission_count_message(1, 1, 5, 0)))
    r.run(0.01)
    r.send_bytes(V, other.pack(r.item(V, 0, waypoint(0, 0, 0))))
    r.run(0.01)
    r.send_bytes(V, other.pack(A.MAVLink_mission_request_list_message(1, 1, 0)))
    r.send_bytes(V, other.pack(A.MAVLink_mission_clear_all_message(1, 1, 0)))
    r.run(0.01)
    # handle_mission_clear_all says twice that it failed
    assert acks(r) == [*[A.MAV_MISSION_DENIED] * 4, A.MAV_MISSION_ERROR]
    assert {(m.target_system, m.target_component) for m in r.heard("MISSION_ACK")} == {(254, 1)}
    put(r, 0, waypoint(0, 0, 0))
    put(r, 1, takeoff(5))
    assert acks(r)[-1] == A.MAV_MISSION_ACCEPTED


def test_own_new_count_restarts_the_upload(r: Range) -> None:
    count(r, 3)
    put(r, 0, waypoint(0, 0, 0))
    count(r, 2)
    assert requests(r) == [0, 1, 0]


def test_download_denied_during_upload(r: Range) -> None:
    count(r, 2)
    r.send(V, A.MAVLink_mission_request_list_message(1, 1, 0))
    r.send(V, A.MAVLink_mission_request_int_message(1, 1, 0, 0))
    r.send(V, A.MAVLink_mission_write_partial_list_message(1, 1, 0, 0, 0))
    r.run(0.01)
    assert acks(r) == [A.MAV_MISSION_DENIED] * 3


def bad(
    command: int = 16, frame: int = 3, p1: float = 0, p4: float = 0, lat: int = 0, lon: int = 0, z: float = 5
) -> Any:
    return A.MAVLink_mission_item_int_message(1, 1, 1, frame, command, 0, 1, p1, 0, 0, p4, lat, lon, z, 0)


@pytest.mark.parametrize(
    ("message", "result"),
    [
        (bad(command=A.MAV_CMD_NAV_PAYLOAD_PLACE), A.MAV_MISSION_UNSUPPORTED),
        (bad(command=1), A.MAV_MISSION_INVALID),
        (bad(frame=A.MAV_FRAME_LOCAL_NED), A.MAV_MISSION_UNSUPPORTED_FRAME),
        (bad(p1=math.nan), A.MAV_MISSION_INVALID_PARAM1),
        (bad(p1=math.inf), A.MAV_MISSION_INVALID_PARAM1),
        (bad(p4=math.inf), A.MAV_MISSION_INVALID_PARAM4),
        (bad(command=178, p4=math.nan), A.MAV_MISSION_INVALID_PARAM4),
        (bad(lat=900000001), A.MAV_MISSION_INVALID_PARAM5_X),
        (bad(lon=-1800000001), A.MAV_MISSION_INVALID_PARAM6_Y),
        (bad(z=math.nan), A.MAV_MISSION_INVALID_PARAM7),
        (bad(z=1e9), A.MAV_MISSION_INVALID_PARAM7),
        (bad(command=A.MAV_CMD_DO_JUMP, p1=0), A.MAV_MISSION_ERROR),
        (bad(command=A.MAV_CMD_DO_JUMP, p1=9), A.MAV_MISSION_ERROR),
    ],
)
def test_bad_items_end_the_upload_with_their_reason(r: Range, message: object, result: int) -> None:
    count(r, 3)
    put(r, 0, waypoint(0, 0, 0))
    r.send(V, message)
    r.run(0.01)
    assert acks(r) == [result]
    r.run(2.5)
    assert requests(r) == [0, 1]  # no more are asked for


def test_yaw_of_a_waypoint_may_be_nan(r: Range) -> None:
    count(r, 2)
    put(r, 0, waypoint(0, 0, 0))
    r.send(V, bad(p4=math.nan))
    r.run(0.01)
    assert acks(r) == [A.MAV_MISSION_ACCEPTED]


def test_too_many_items(r: Range) -> None:
    count(r, MAX_ITEMS + 1)
    assert acks(r) == [A.MAV_MISSION_NO_SPACE]
    assert requests(r) == []


def test_clear_all_and_empty_upload(r: Range) -> None:
    r.upload(V, square(5, 5))
    r.send(V, A.MAVLink_mission_clear_all_message(1, 1, 255))  # all kinds at once: ArduPilot has no such kind
    r.run(0.01)
    assert acks(r)[-1] == A.MAV_MISSION_UNSUPPORTED
    assert len(download(r)) == 7
    r.send(V, A.MAVLink_mission_clear_all_message(1, 1, 0))
    r.run(0.01)
    assert acks(r)[-1] == A.MAV_MISSION_ACCEPTED
    assert len(download(r)) == 0
    r.upload(V, square(5, 5))
    count(r, 0)
    assert acks(r)[-1] == A.MAV_MISSION_ACCEPTED
    assert len(download(r)) == 0


def test_partial_write_replaces_a_part(r: Range) -> None:
    r.upload(V, square(5, 5))
    r.send(V, A.MAVLink_mission_write_partial_list_message(1, 1, 2, 3, 0))
    r.run(0.01)
    put(r, 2, waypoint(1, 1, 9))
    put(r, 3, waypoint(2, 2, 9))
    assert acks(r)[-1] == A.MAV_MISSION_ACCEPTED
    assert [m.z for m in download(r)][1:6] == [5.0, 9.0, 9.0, 5.0, 5.0]
    for start, end in ((3, 2), (0, 99), (-4, 2)):
        r.send(V, A.MAVLink_mission_write_partial_list_message(1, 1, start, end, 0))
        r.run(0.01)
        assert acks(r)[-1] == A.MAV_MISSION_ERROR


def test_failed_upload_leaves_the_first_part(r: Range) -> None:
    r.upload(V, square(5, 5))
    count(r, 4)
    put(r, 0, waypoint(0, 0, 0))
    put(r, 1, takeoff(11))
    r.send(V, bad().__class__(1, 1, 2, 3, A.MAV_CMD_NAV_PAYLOAD_PLACE, 0, 1, 0, 0, 0, 0, 0, 0, 5, 0))
    r.run(0.01)
    assert acks(r)[-1] == A.MAV_MISSION_UNSUPPORTED
    assert [m.z for m in download(r)][1:] == [11.0, 5.0, 5.0]


def test_request_beyond_the_end_tells_the_count(r: Range) -> None:
    r.upload(V, square(5, 5))
    r.send(V, A.MAVLink_mission_request_int_message(1, 1, 60, 0))
    r.run(0.01)
    assert acks(r)[-1] == A.MAV_MISSION_INVALID_SEQUENCE
    assert r.heard("MISSION_COUNT")[-1].count == 7


def test_other_kinds_are_unsupported(r: Range) -> None:
    for kind in (3, A.MAV_MISSION_TYPE_ALL):
        count(r, 3, kind)
        assert (r.heard("MISSION_ACK")[-1].type, r.heard("MISSION_ACK")[-1].mission_type) == (
            A.MAV_MISSION_UNSUPPORTED,
            kind,
        )


def test_set_current_answers_with_the_number_asked_for(r: Range) -> None:
    r.upload(V, square(5, 5))
    r.send(V, A.MAVLink_mission_set_current_message(1, 1, 3))
    r.run(0.01)
    assert r.heard("MISSION_CURRENT")[-1].seq == 3
    assert r.heard("MISSION_CURRENT")[-1].total == 6
    r.send(V, A.MAVLink_mission_set_current_message(1, 1, 0))
    r.run(0.01)
    assert r.heard("MISSION_CURRENT")[-1].seq == 0
    said = len(r.said)
    r.send(V, A.MAVLink_mission_set_current_message(1, 1, 7))
    r.run(0.01)
    assert len(r.said) == said
    assert r.command(V, A.MAV_CMD_DO_SET_MISSION_CURRENT, 2.0) == A.MAV_RESULT_ACCEPTED
    assert r.heard("MISSION_CURRENT")[-1].seq == 2
    for wrong in (7.0, -1.0, math.nan, 1e30):
        assert r.command(V, A.MAV_CMD_DO_SET_MISSION_CURRENT, wrong) == A.MAV_RESULT_DENIED


def test_items_keep_the_frame_that_wrote_them(r: Range) -> None:
    r.upload(V, square(5, 5))
    slots = r.engines[0]._fleet.vehicles[0].mission
    assert len({slot.causes for slot in slots}) == 7
    assert all(len(slot.causes) == 1 for slot in slots)
