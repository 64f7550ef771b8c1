"""Every field that an attacker can fill: a flying aircraft answers like ArduCopter and flies on.

Every row is one message to an aircraft that hovers in GUIDED, or flies a mission, and the answer of ArduPilot's source:
MAV_RESULTs of ArduCopter/GCS_MAVLink_Copter.cpp and libraries/GCS_MAVLink/GCS_Common.cpp, MAV_MISSION_RESULTs of
MissionItemProtocol.cpp, MissionItemProtocol_{Waypoints,Fence,Rally}.cpp and AP_Mission.cpp, silence where there is
none (GCS_Param.cpp `handle_param_set`, MAVLink_routing.cpp). What C++ leaves open is refused here.
"""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest

from skyrange.codec.mavlink import Packer, dialect
from skyrange.codec.mavlink.message_columns import payload_dtype
from skyrange.vehicle.builtin.engine import _HANDLERS
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from tests.cases import each_case
from tests.integration.flight_harness import ORIGIN, Item, Range, rtl, start, takeoff, waypoint

pytestmark = [pytest.mark.catalogue, pytest.mark.rotating]

V = "blue/b1"
A = dialect
NAN, INF, HUGE = math.nan, math.inf, 3.4e38
OK, BUSY, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
REL, ABS, TERRAIN, LOCAL = 3, 0, 10, 1
UP_M = 15.0
SQUARE: list[Item] = [takeoff(UP_M), waypoint(0, 40, UP_M), waypoint(40, 40, UP_M), waypoint(40, 0, UP_M), rtl()]


@pytest.fixture(scope="module")
def flights() -> dict[str, Range]:
    """Hovering in GUIDED with a mission on board, and the same mission under way."""
    hover, auto = Range([VehicleSpec(V, 1)]), Range([VehicleSpec(V, 1)])
    hover.upload(V, SQUARE)
    hover.take_off(V, UP_M)
    auto.upload(V, SQUARE)
    start(auto, V)
    auto.run(13.0)
    assert auto.positions()[0, 2] > 10.0
    return {"hover": hover, "auto": auto}


def spot(east: float, north: float) -> tuple[int, int]:
    lat, lon = ORIGIN.geodetic_of(east, north)
    return round(lat * 1e7), round(lon * 1e7)


X, Y = spot(10.0, 5.0)


def flies_on(r: Range, seconds: float = 2.0) -> None:
    """It goes on flying: armed, no lower than a landing would bring it, numbers finite, upright."""
    up = r.positions()[0, 2]
    r.run(seconds)
    fleet = r.engines[0]._fleet
    assert fleet.flight["armed"][0]
    assert not r.events("event.crash")
    assert r.positions()[0, 2] > up - 2.5 * seconds - 0.5
    assert r.positions()[0, 2] > 1.0
    assert abs(r.velocities()[0]).max() < 15.0
    for table in (fleet.estimate, fleet.flight, fleet.settings, fleet.legs):
        for name in table.dtype.names or ():
            if table[name].dtype.names is None:
                assert np.isfinite(table[name]).all(), name
    truth = r.world.truth()
    assert 1.0 - 2.0 * (truth["qx"][0] ** 2 + truth["qy"][0] ** 2) > math.cos(math.radians(45.0))


def answers(r: Range, *messages: Any, sender: tuple[int, int] = (255, 190)) -> list[Any]:
    """What it says to messages that come at once, but for what it tells anyway."""
    before = len(r.said)
    packer = Packer(*sender)
    for message in messages:
        r.send_bytes(V, packer.pack(message))
    r.run(0.02)
    return [s.message for s in r.said[before:] if s.message.get_type() != "HEARTBEAT"]


# --- commands ---------------------------------------------------------------------------------------------------------


def long(name: str, *params: float) -> Any:
    full = (*params, *([0.0] * (7 - len(params))))
    return A.MAVLink_command_long_message(1, 1, getattr(A, f"MAV_CMD_{name}"), 0, *full)


def whole(name: str, x: int = X, y: int = Y, z: float = 20.0, frame: int = REL, params: tuple[float, ...] = ()) -> Any:
    full = (*params, *([0.0] * (4 - len(params))))
    return A.MAVLink_command_int_message(1, 1, frame, getattr(A, f"MAV_CMD_{name}"), 0, 0, *full, x, y, z)


COMMANDS: list[tuple[Any, int]] = [
    # no numbers
    (long("COMPONENT_ARM_DISARM", NAN), UNSUPPORTED),
    (long("COMPONENT_ARM_DISARM", 0.0, NAN), FAILED),
    (long("COMPONENT_ARM_DISARM", INF, 21196.0), UNSUPPORTED),
    (long("COMPONENT_ARM_DISARM", 0.0, 2989.0), FAILED),  # that number arms and no more
    (long("DO_SET_MODE", NAN, 9.0), DENIED),
    (long("DO_SET_MODE", 1.0, NAN), DENIED),
    (long("DO_SET_MODE", 1.0, 1e30), FAILED),
    (long("DO_SET_MODE", 1.0, 27.0), FAILED),  # AUTO_RTL: the mission has no landing sequence
    (long("DO_CHANGE_SPEED", 1.0, NAN), DENIED),
    (long("DO_CHANGE_SPEED", 1.0, -INF), DENIED),
    (long("DO_CHANGE_SPEED", 1.0, HUGE), OK),
    (long("DO_CHANGE_SPEED", HUGE, 3.0), FAILED),
    (long("CONDITION_YAW", NAN), FAILED),
    (long("CONDITION_YAW", -1.0), FAILED),
    (long("CONDITION_YAW", 361.0), FAILED),
    (long("CONDITION_YAW", 90.0, HUGE), OK),
    (long("CONDITION_YAW", 90.0, 0.0, 0.0, NAN), FAILED),
    (long("MISSION_START", NAN), DENIED),
    (long("MISSION_START", 0.0, 1.0), DENIED),
    (long("NAV_TAKEOFF", 0, 0, 0, 0, 0, 0, NAN), DENIED),
    (long("NAV_TAKEOFF", 0, 0, 0, 0, 0, 0, HUGE), DENIED),
    (long("NAV_TAKEOFF", 0, 0, 0, 0, 0, 0, 50.0), FAILED),  # flies already
    (long("DO_FLIGHTTERMINATION", NAN), FAILED),
    (long("PREFLIGHT_REBOOT_SHUTDOWN", NAN), FAILED),  # armed
    (long("PREFLIGHT_REBOOT_SHUTDOWN", 1.0, 0, 0, 0, 0, NAN), FAILED),
    (long("PREFLIGHT_STORAGE", NAN), DENIED),
    (long("DO_FENCE_ENABLE", NAN), DENIED),
    (long("DO_FENCE_ENABLE", 7.0), FAILED),
    (long("DO_MOTOR_TEST", NAN, NAN, NAN, NAN, NAN, NAN, NAN), FAILED),
    (long("DO_PAUSE_CONTINUE", NAN), DENIED),
    (long("DO_PARACHUTE", HUGE), FAILED),
    # sequence numbers, message ids, intervals
    (long("DO_SET_MISSION_CURRENT", len(SQUARE) + 1), DENIED),
    (long("DO_SET_MISSION_CURRENT", 65535.0), DENIED),
    (long("DO_SET_MISSION_CURRENT", -1.0), DENIED),
    (long("DO_SET_MISSION_CURRENT", NAN), DENIED),
    (long("DO_JUMP_TAG", 70_000.0), DENIED),
    (long("DO_JUMP_TAG", 7.0), FAILED),
    (long("SET_MESSAGE_INTERVAL", NAN, 1e6), DENIED),
    (long("SET_MESSAGE_INTERVAL", 16_777_216.0, 1e6), DENIED),
    (long("SET_MESSAGE_INTERVAL", 30.0, NAN), DENIED),
    (long("SET_MESSAGE_INTERVAL", 30.0, -2.0), DENIED),
    (long("SET_MESSAGE_INTERVAL", 30.0, 1.0), DENIED),
    (long("GET_MESSAGE_INTERVAL", NAN), FAILED),
    (long("REQUEST_MESSAGE", NAN), FAILED),
    (long("REQUEST_MESSAGE", -1.0), FAILED),
    (long("REQUEST_MESSAGE", 65536.0), FAILED),
    # places
    (long("DO_REPOSITION", -1, 1, 0, 0, -35.0, 149.0, 20.0), UNSUPPORTED),  # COMMAND_INT only
    (long("DO_SET_HOME", 0, 0, 0, 0, NAN, 149.0, 600.0), OK),  # latitude NaN is 0 degrees north of the Atlantic
    (long("DO_SET_HOME", 0, 0, 0, 0, 91.0, 149.0, 600.0), FAILED),
    (long("DO_SET_HOME", 0, 0, 0, 0, -35.0, 149.0, HUGE), DENIED),
    (long("DO_SET_HOME", NAN, 0, 0, 0, -35.0, 149.0, 600.0), FAILED),
    (long("DO_SET_ROI", 0, 0, 0, 0, -35.0, 149.0, NAN), DENIED),
    (long("DO_SET_ROI", 0, 0, 0, 0, -35.0, 200.0, 10.0), FAILED),
    (whole("DO_REPOSITION", x=900_000_001), DENIED),
    (whole("DO_REPOSITION", y=-1_800_000_001), DENIED),
    (whole("DO_REPOSITION", x=-(2**31), y=2**31 - 1), DENIED),
    (whole("DO_REPOSITION", z=NAN), DENIED),
    (whole("DO_REPOSITION", z=-INF), DENIED),
    (whole("DO_REPOSITION", z=83_001.0), DENIED),  # LOCATION_ALT_MAX_M
    (whole("DO_REPOSITION", z=83_000.0), OK),
    (whole("DO_REPOSITION", frame=LOCAL), DENIED),
    (whole("DO_REPOSITION", frame=255), DENIED),
    (whole("DO_REPOSITION", x=0, y=0), DENIED),
    (whole("DO_REPOSITION", params=(NAN, NAN, NAN, NAN)), OK),
    (whole("NAV_TAKEOFF", frame=ABS), DENIED),
    (whole("DO_SET_ROI_LOCATION", frame=77), DENIED),
    # none of ArduCopter's
    (long("DO_FOLLOW", NAN, NAN, NAN), UNSUPPORTED),
    (long("SET_GPS_GLOBAL_ORIGIN" if hasattr(A, "MAV_CMD_SET_GPS_GLOBAL_ORIGIN") else "DO_FOLLOW"), UNSUPPORTED),
    (A.MAVLink_command_long_message(1, 1, 0, 0, *[NAN] * 7), UNSUPPORTED),
    (A.MAVLink_command_long_message(1, 1, 65535, 255, *[HUGE] * 7), UNSUPPORTED),
]
"""The MAV_RESULT of the one COMMAND_ACK."""


@pytest.mark.parametrize("half", [0, 1])
def test_commands(flights: dict[str, Range], half: int) -> None:
    each_case("message, result", COMMANDS[half::2])(_check_command)(flights=flights)


def _check_command(flights: dict[str, Range], message: Any, result: int) -> None:
    r = flights["hover"].copy()
    acks = [m for m in answers(r, message) if m.get_type() == "COMMAND_ACK"]
    assert [(m.command, m.result, m.target_system, m.target_component) for m in acks] == [
        (message.command, result, 255, 190)
    ]
    flies_on(r)


# --- missions, fences, rally points -----------------------------------------------------------------------------------

ACCEPTED, ERROR, BAD_FRAME, NO_ITEM, NO_SPACE, INVALID = (
    A.MAV_MISSION_ACCEPTED, A.MAV_MISSION_ERROR, A.MAV_MISSION_UNSUPPORTED_FRAME, A.MAV_MISSION_UNSUPPORTED,
    A.MAV_MISSION_NO_SPACE, A.MAV_MISSION_INVALID,
)  # fmt: skip
P1, P2, P3, P4, P5, P6, P7 = (getattr(A, f"MAV_MISSION_INVALID_PARAM{n}") for n in (1, 2, 3, 4, "5_X", "6_Y", 7))
SEQUENCE, REFUSED = A.MAV_MISSION_INVALID_SEQUENCE, A.MAV_MISSION_DENIED
FENCE, RALLY = 1, 2


def item(
    command: int = 16,
    params: tuple[float, float, float, float] = (0, 0, 0, 0),
    x: int = X,
    y: int = Y,
    z: float = 10.0,
    frame: int = REL,
    seq: int = 0,
    kind: int = 0,
    current: int = 0,
) -> Any:
    return A.MAVLink_mission_item_int_message(1, 1, seq, frame, command, current, 1, *params, x, y, z, kind)


def old_item(command: int = 16, lat: float = -35.0, lon: float = 149.0, z: float = 10.0, current: int = 0) -> Any:
    return A.MAVLink_mission_item_message(1, 1, 0, REL, command, current, 1, 0, 0, 0, 0, lat, lon, z, 0)


ITEMS: list[tuple[Any, int]] = [
    (item(params=(NAN, 0, 0, 0)), P1),
    (item(params=(0, INF, 0, 0)), P2),
    (item(params=(0, 0, NAN, 0)), P3),
    (item(params=(0, 0, 0, -INF)), P4),
    (item(params=(0, 0, 0, NAN)), ACCEPTED),  # the yaw of a waypoint may be none
    (item(command=82, params=(0, 0, 0, NAN)), P4),  # that of a spline may not
    (item(x=900_000_001), P5),
    (item(y=-(2**31)), P6),
    (item(z=NAN), P7),
    (item(z=INF), P7),
    (item(z=83_000.0), P7),
    (item(z=-82_999.0), ACCEPTED),
    (item(frame=LOCAL), BAD_FRAME),
    (item(frame=99), BAD_FRAME),
    (item(command=0), INVALID),
    (item(command=1), INVALID),
    (item(command=65535), NO_ITEM),
    (item(command=94), NO_ITEM),
    (item(command=177, params=(0, 1, 0, 0)), ERROR),  # a jump to home
    (item(command=177, params=(60_000, 1, 0, 0)), ERROR),
    (item(command=177, params=(HUGE, 1, 0, 0)), ERROR),
    (item(command=A.MAV_CMD_DO_CHANGE_SPEED, params=(1, NAN, 0, 0)), P2),
    (item(command=18, params=(NAN, 0, 0, 0)), P1),
    (item(kind=FENCE, command=5001, params=(256, 0, 0, 0)), P1),
    (item(kind=FENCE, command=5001, params=(2, 0, 0, 0)), ERROR),
    (item(kind=FENCE, command=5003, params=(-5, 0, 0, 0)), ERROR),
    (item(kind=FENCE, command=5003, params=(NAN, 0, 0, 0)), ERROR),
    (item(kind=FENCE, command=5003, params=(5, 0, 0, 0), x=2**31 - 1), ERROR),
    (item(kind=FENCE, command=5003, params=(5, 0, 0, 0), frame=LOCAL), BAD_FRAME),
    (item(kind=FENCE), NO_ITEM),
    (item(kind=RALLY, command=5100, x=-900_000_001), P5),
    (item(kind=RALLY, command=5100, y=1_800_000_001), P6),
    (item(kind=RALLY, command=5100, z=32_768.0), P7),
    (item(kind=RALLY, command=5100, z=-INF), P7),
    (item(kind=RALLY, command=5100, frame=LOCAL), BAD_FRAME),
    (item(kind=RALLY), NO_ITEM),
]
"""The MAV_MISSION_RESULT of the item that was asked for, the only one of its transfer."""


@pytest.mark.parametrize("where", ["hover", "auto"])
@each_case("message, result", ITEMS)
def test_items(flights: dict[str, Range], message: Any, result: int, where: str) -> None:
    r = flights[where].copy()
    kind = message.mission_type
    assert [m.get_type() for m in answers(r, A.MAVLink_mission_count_message(1, 1, 1, kind))] == ["MISSION_REQUEST"]
    acks = [m for m in answers(r, message) if m.get_type() == "MISSION_ACK"]
    assert [(m.type, m.mission_type, m.target_system, m.target_component) for m in acks] == [(result, kind, 255, 190)]
    flies_on(r)


MISSION: list[tuple[Any, list[tuple[str, int]]]] = [
    # types that there are none of
    (A.MAVLink_mission_count_message(1, 1, 3, 7), [("MISSION_ACK", NO_ITEM)]),
    (A.MAVLink_mission_count_message(1, 1, 3, 255), [("MISSION_ACK", NO_ITEM)]),
    (A.MAVLink_mission_clear_all_message(1, 1, 255), [("MISSION_ACK", NO_ITEM)]),
    (A.MAVLink_mission_request_list_message(1, 1, 3), [("MISSION_ACK", NO_ITEM)]),
    (A.MAVLink_mission_write_partial_list_message(1, 1, 0, 0, 9), [("MISSION_ACK", NO_ITEM)]),
    (A.MAVLink_mission_request_int_message(1, 1, 0, 9), []),
    (A.MAVLink_mission_request_message(1, 1, 0, 9), []),
    (item(kind=9), [("MISSION_ACK", NO_ITEM)]),
    # numbers out of range
    (A.MAVLink_mission_count_message(1, 1, 65535, 0), [("MISSION_ACK", NO_SPACE)]),
    (A.MAVLink_mission_count_message(1, 1, 65535, FENCE), [("MISSION_ACK", NO_SPACE)]),
    (A.MAVLink_mission_count_message(1, 1, 65535, RALLY), [("MISSION_ACK", NO_SPACE)]),
    (A.MAVLink_mission_request_int_message(1, 1, 65535, 0), [("MISSION_COUNT", 6), ("MISSION_ACK", SEQUENCE)]),
    (A.MAVLink_mission_request_message(1, 1, 6, 0), [("MISSION_ACK", SEQUENCE)]),
    (A.MAVLink_mission_request_int_message(1, 1, 0, FENCE), [("MISSION_COUNT", 0), ("MISSION_ACK", SEQUENCE)]),
    (A.MAVLink_mission_set_current_message(1, 1, 6), []),
    (A.MAVLink_mission_set_current_message(1, 1, 65535), []),
    (A.MAVLink_mission_write_partial_list_message(1, 1, -32768, 3, 0), [("MISSION_ACK", ERROR)]),
    (A.MAVLink_mission_write_partial_list_message(1, 1, 3, 2, 0), [("MISSION_ACK", ERROR)]),
    (A.MAVLink_mission_write_partial_list_message(1, 1, 0, 32767, 0), [("MISSION_ACK", ERROR)]),
    # items that nobody asked for, and orders dressed as items
    (item(seq=3), [("MISSION_ACK", ERROR)]),
    (item(kind=FENCE), [("MISSION_ACK", ERROR)]),
    (old_item(lat=NAN), [("MISSION_ACK", P5)]),
    (old_item(lat=-91.0), [("MISSION_ACK", P5)]),
    (old_item(lon=INF), [("MISSION_ACK", P6)]),
    (old_item(z=NAN, current=2), [("MISSION_ACK", P7)]),
    (item(command=21, current=2), [("MISSION_ACK", ERROR)]),
    (item(command=16, current=3, z=HUGE), [("MISSION_ACK", P7)]),
    (item(command=16, current=3), [("MISSION_ACK", ACCEPTED)]),
]
"""Type and result or count of each answer to a message of the mission protocol."""


@pytest.mark.parametrize("where", ["hover", "auto"])
@each_case("message, expected", MISSION)
def test_mission_protocol(flights: dict[str, Range], message: Any, expected: list[tuple[str, int]], where: str) -> None:
    r = flights[where].copy()
    before = copy.deepcopy(r.engines[0]._fleet.vehicles[0].mission)
    found = [m for m in answers(r, message) if m.get_type() in ("MISSION_ACK", "MISSION_COUNT", "MISSION_REQUEST")]
    assert [(m.get_type(), m.count if m.get_type() == "MISSION_COUNT" else m.type) for m in found] == expected
    assert r.engines[0]._fleet.vehicles[0].mission == before
    flies_on(r)


def test_an_order_dressed_as_an_item_is_obeyed_in_guided_only(flights: dict[str, Range]) -> None:
    r = flights["hover"].copy()
    assert answers(r, item(current=2, z=20.0))[0].type == ACCEPTED
    assert answers(r, item(command=A.MAV_CMD_CONDITION_YAW, params=(90.0, 0, 1, 0), current=2))[0].type == ACCEPTED
    r.run(12.0)
    assert r.positions()[0] == pytest.approx([10.0, 5.0, 20.0], abs=0.5)
    r = flights["auto"].copy()
    assert answers(r, item(current=2, z=20.0))[0].type == ERROR


@pytest.mark.parametrize("kind", [0, FENCE, RALLY])
@pytest.mark.parametrize("where", ["hover", "auto"])
def test_a_transfer_that_stops_is_given_up(flights: dict[str, Range], where: str, kind: int) -> None:
    """Asked for again each second, given up after 8 s (MissionItemProtocol.cpp `update`), and others wait meanwhile."""
    r = flights[where].copy()
    first = answers(r, A.MAVLink_mission_count_message(1, 1, 4, kind))
    assert [m.seq for m in first if m.get_type() == "MISSION_REQUEST"] == [0]
    wrong = answers(r, item(seq=2, kind=kind))  # out of order
    assert [m.type for m in wrong if m.get_type() == "MISSION_ACK"] == [SEQUENCE]
    stranger = answers(
        r,
        A.MAVLink_mission_count_message(1, 1, 0, kind),
        item(kind=kind),
        A.MAVLink_mission_request_list_message(1, 1, kind),
        A.MAVLink_mission_clear_all_message(1, 1, kind),
        sender=(66, 6),
    )
    assert [(m.type, m.target_system) for m in stranger if m.get_type() == "MISSION_ACK"] == [
        *[(REFUSED, 66)] * 4,
        (ERROR, 66),
    ]
    before = len(r.said)
    r.run(10.5)
    later = [s.message for s in r.said[before:]]
    assert 6 <= len([m for m in later if m.get_type() == "MISSION_REQUEST"]) <= 8
    assert [m.type for m in later if m.get_type() == "MISSION_ACK"] == [A.MAV_MISSION_OPERATION_CANCELLED]
    assert not any(upload.active for upload in r.engines[0]._fleet.vehicles[0].uploads)
    flies_on(r)


# --- targets, parameters, sticks, streams -----------------------------------------------------------------------------


def local(
    x: float, y: float, z: float, v: tuple[float, ...], a: tuple[float, ...], yaw: float, rate: float, mask: int
) -> Any:
    return A.MAVLink_set_position_target_local_ned_message(0, 1, 1, LOCAL, mask, x, y, z, *v, *a, yaw, rate)


_VALUES = (NAN, INF, -INF, HUGE)
_STILL = (0.0, 0.0, 0.0)


def _with(values: tuple[float, ...], place: int, bad: float) -> tuple[float, ...]:
    return (*values[:place], bad, *values[place + 1 :])


@pytest.mark.parametrize("bad", _VALUES)
@each_case("place", range(11))
def test_no_number_in_any_field_of_a_local_target(flights: dict[str, Range], place: int, bad: float) -> None:
    """Position, velocity, acceleration, yaw and yaw rate all given: it stops where it is, and hovers."""
    r = flights["hover"].copy()
    r.send(V, local(0, 0, -UP_M, (0.0, 3.0, 0.0), _STILL, 0.0, 0.0, 0b1101_1100_0111))
    r.run(1.5)
    values = _with((30.0, 30.0, -UP_M, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), place, bad)
    r.send(V, A.MAVLink_set_position_target_local_ned_message(0, 1, 1, LOCAL, 0, *values))
    flies_on(r, 3.0)
    held = place == 10 and bad == HUGE  # a yaw rate without end is a number: it turns as fast as it may
    if not held and not (place == 9 and bad == HUGE):
        assert np.abs(r.velocities()[0]).max() < 0.3
    assert r.engines[0]._fleet.vehicles[0].mode == Mode.GUIDED


@each_case("bad", _VALUES)
@each_case("place", range(9))
def test_no_number_in_any_field_of_a_global_target(flights: dict[str, Range], place: int, bad: float) -> None:
    r = flights["hover"].copy()
    values = _with((20.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), place, bad)
    r.send(V, A.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, 0, X, Y, *values))
    flies_on(r, 2.5)


@each_case("bad", _VALUES)
@each_case("place", range(8))
def test_no_number_in_any_field_of_an_attitude_target(flights: dict[str, Range], place: int, bad: float) -> None:
    r = flights["hover"].copy()
    w, x, y, z, *rest = _with((1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5), place, bad)
    r.send(V, A.MAVLink_set_attitude_target_message(0, 1, 1, 0, [w, x, y, z], *rest))
    r.run(0.1)
    if 3 < place < 7 and bad == HUGE:
        return  # a spin without end is a number, and does what it says
    flies_on(r)


PARAMETERS: list[tuple[bytes, float, int, float | None]] = [
    (b"WPNAV_SPEED", NAN, 9, None),
    (b"WPNAV_SPEED", -INF, 9, None),
    (b"WPNAV_SPEED", HUGE, 9, HUGE),
    (b"ANGLE_MAX", HUGE, 9, 32767.0),
    (b"ANGLE_MAX", -HUGE, 9, -32768.0),
    (b"FENCE_ENABLE", 300.0, 9, 127.0),
    (b"RTL_ALT", 2000.7, A.MAV_PARAM_TYPE_UINT8, 2000.0),  # the type that is claimed is not read
    (b"RTL_ALT", 2000.0, 255, 2000.0),
    (b"WPNAV_ACCEL", 1e-40, A.MAV_PARAM_TYPE_INT64, None),
    (b"MOT_SPIN_MIN", -1e30, 9, -1e30),
    (b"PSC_VELXY_P", HUGE, 9, HUGE),
    (b"NO_SUCH_NAME", 1.0, 9, None),
    (b"", 1.0, 9, None),
    (b"\xff\xfe", 1.0, 9, None),
    (b"SIXTEEN_LETTERS_", 1.0, 9, None),
]
"""Name, value, claimed type, and the value that is told, or silence."""


@each_case("name, value, kind, told", PARAMETERS)
def test_parameters(flights: dict[str, Range], name: bytes, value: float, kind: int, told: float | None) -> None:
    r = flights["hover"].copy()
    found = [
        m for m in answers(r, A.MAVLink_param_set_message(1, 1, name, value, kind)) if m.get_type() == "PARAM_VALUE"
    ]
    if name == b"WPNAV_ACCEL":
        told = 1e-40
    assert [m.param_value for m in found] == ([] if told is None else [pytest.approx(told, rel=1e-6, abs=1e-44)])
    flies_on(r)


@pytest.mark.parametrize("index", [-32768, -2, 32767, 5000])
def test_a_parameter_that_is_not_there_is_not_told(flights: dict[str, Range], index: int) -> None:
    r = flights["hover"].copy()
    assert answers(r, A.MAVLink_param_request_read_message(1, 1, b"RTL_ALT", index)) == []


@pytest.mark.parametrize(
    "message",
    [
        A.MAVLink_rc_channels_override_message(1, 1, *[0] * 8),
        A.MAVLink_rc_channels_override_message(1, 1, *[65534] * 8),
        A.MAVLink_rc_channels_override_message(1, 1, *[1] * 8),
        A.MAVLink_manual_control_message(1, -32768, -32768, 32767, -32768, 65535),
        A.MAVLink_manual_control_message(1, 32767, 32767, -1, 32767, 0),
        A.MAVLink_request_data_stream_message(1, 1, 0, 65535, 1),
        A.MAVLink_request_data_stream_message(1, 1, 255, 10, 1),
        A.MAVLink_request_data_stream_message(1, 1, 0, 10, 255),
        A.MAVLink_set_mode_message(1, 1, 2**32 - 1),
        A.MAVLink_set_mode_message(1, 0, 9),
        A.MAVLink_timesync_message(-(2**63), 2**63 - 1),
        A.MAVLink_heartbeat_message(255, 255, 255, 2**32 - 1, 255, 255),
    ],
)
@pytest.mark.parametrize("where", ["hover", "auto"])
def test_what_has_no_answer_changes_no_flight(flights: dict[str, Range], message: Any, where: str) -> None:
    r = flights[where].copy()
    mode = r.engines[0]._fleet.vehicles[0].mode
    found = {m.get_type() for m in answers(r, message)}
    assert not found & {"COMMAND_ACK", "MISSION_ACK", "PARAM_VALUE"}
    flies_on(r)
    assert r.engines[0]._fleet.vehicles[0].mode == mode


# --- systems and components ------------------------------------------------------------------------------------------

_ADDRESSED = sorted(
    number
    for number in (*_HANDLERS, 75, 76, 11, 66)
    if {"target_system", "target"} & set(payload_dtype(number).names or ())
)


@each_case("number", _ADDRESSED)
def test_what_is_for_others_is_ignored(flights: dict[str, Range], number: int) -> None:
    """MAVLink_routing.cpp `check_and_forward`: only 0 and its own system id; components that nobody has are its own."""
    r = flights["hover"].copy()
    kind = A.mavlink_map[number]
    state = copy.deepcopy(r.engines[0]._fleet.vehicles[0])
    for system in (2, 42, 250, 255):
        values: dict[str, Any] = dict.fromkeys(kind.fieldnames, 0)
        values[next(name for name in kind.fieldnames if name in ("target_system", "target"))] = system
        for name, sort in zip(kind.fieldnames, kind.fieldtypes, strict=True):
            if sort == "char":
                values[name] = b"RTL_ALT"
            if name == "q":
                values[name] = [1.0, 0.0, 0.0, 0.0]
            if name in ("id_or_mac", "uas_id"):
                values[name] = [0] * 20
            if name == "payload":
                values[name] = [0] * 251
            if name == "secret_key":
                values[name] = [1] * 32
        if "command" in values:
            values["command"] = A.MAV_CMD_NAV_LAND
        assert answers(r, kind(**values)) == []
    vehicle = r.engines[0]._fleet.vehicles[0]
    assert vehicle.ignored_frames == state.ignored_frames + 4
    assert (vehicle.mode, vehicle.mission, vehicle.home) == (state.mode, state.mission, state.home)
    flies_on(r)


@pytest.mark.parametrize("sender", [(0, 0), (1, 77), (2, 1), (255, 255)])
def test_whoever_asks_is_answered_and_named(flights: dict[str, Range], sender: tuple[int, int]) -> None:
    r = flights["hover"].copy()
    acks = [m for m in answers(r, long("CONDITION_YAW", 90.0), sender=sender) if m.get_type() == "COMMAND_ACK"]
    assert [(m.target_system, m.target_component) for m in acks] == [sender]
    r = flights["hover"].copy()
    assert answers(r, long("CONDITION_YAW", 90.0), sender=(1, 1)) == []  # its own echo


# --- beyond the fence -------------------------------------------------------------------------------------------------


def fly_with_fence(flights: dict[str, Range]) -> Range:
    r = flights["hover"].copy()
    for name, value in ((b"FENCE_RADIUS", 50.0), (b"FENCE_ENABLE", 1.0)):
        r.send(V, A.MAVLink_param_set_message(1, 1, name, value, 9))
    r.run(0.2)
    return r


def test_no_place_beyond_the_fence_is_flown_to(flights: dict[str, Range]) -> None:
    """ModeGuided::set_destination, set_destination_posvelaccel: refused, and what it did before goes on."""
    r = fly_with_fence(flights)
    far = spot(80.0, 0.0)
    reposition = whole("DO_REPOSITION", x=far[0], y=far[1], params=(-1.0, 1.0))
    assert [m.result for m in answers(r, reposition)] == [FAILED]
    assert [m.result for m in answers(r, whole("DO_REPOSITION", z=101.0))] == [FAILED]  # FENCE_ALT_MAX
    assert [m.type for m in answers(r, item(x=far[0], y=far[1], current=2))] == [ERROR]
    r.send(V, local(0.0, 80.0, -UP_M, _STILL, _STILL, 0, 0, 0b1101_1111_1000))
    r.send(V, local(0.0, 80.0, -UP_M, (0.0, 1.0, 0.0), _STILL, 0, 0, 0b1101_1100_0000))
    r.run(6.0)
    assert r.positions()[0] == pytest.approx([0.0, 0.0, UP_M], abs=0.5)
    assert r.mode(V, Mode.LOITER) == OK
    assert [m.result for m in answers(r, reposition)] == [FAILED]
    assert r.engines[0]._fleet.vehicles[0].mode == Mode.LOITER


def test_overrides_count_as_heartbeats(flights: dict[str, Range]) -> None:
    """`handle_rc_channels_override`, `handle_manual_control`: what steers is there; of the ground station only."""
    for number, flies in ((255, True), (66, False)):
        r = flights["auto"].copy()
        r.send(V, A.MAVLink_param_set_message(1, 1, b"FS_GCS_ENABLE", 5.0, 9))
        r.send(V, A.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        for step in range(8):
            sticks = A.MAVLink_rc_channels_override_message(1, 1, *[65535] * 8)
            stick = A.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0)
            r.send_bytes(V, Packer(number, 190).pack(sticks if step % 2 else stick))
            r.run(1.0)
        assert ("GCS Failsafe" not in r.words()) == flies
