"""What each command is answered with: ArduCopter/GCS_MAVLink_Copter.cpp and libraries/GCS_MAVLink/GCS_Common.cpp."""

from __future__ import annotations

import math
from typing import Any

import pytest

from skyrange.codec.mavlink import Packer, dialect
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import ORIGIN, Range, square

pytestmark = pytest.mark.rotating

V = "blue/b1"
A = dialect
OK, BUSY, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
RELATIVE, ABSOLUTE, TERRAIN, LOCAL = 3, 0, 10, 1
NAN, INF = math.nan, math.inf


@pytest.fixture(scope="module")
def standing() -> Range:
    return Range([VehicleSpec(V, 1)])


@pytest.fixture(scope="module")
def hovering() -> Range:
    r = Range([VehicleSpec(V, 1)])
    r.take_off(V, 6.0)
    return r


def as_int(
    r: Range, number: int, params: tuple[float, ...] = (), x: int = 0, y: int = 0, z: float = 0.0, frame: int = RELATIVE
) -> int:
    """Send a COMMAND_INT; the MAV_RESULT."""
    full = (*params, *([0.0] * (4 - len(params))))
    before = len(r.heard("COMMAND_ACK"))
    r.send(V, A.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *full, x, y, z))
    r.run(0.02)
    (ack,) = r.heard("COMMAND_ACK")[before:]
    assert ack.command == number
    return int(ack.result)


def at(east: float, north: float) -> tuple[int, int]:
    lat, lon = ORIGIN.geodetic_of(east, north)
    return round(lat * 1e7), round(lon * 1e7)


GROUND = [
    ("MAV_CMD_NAV_LAND", (), OK),
    ("MAV_CMD_NAV_VTOL_LAND", (), OK),
    ("MAV_CMD_NAV_RETURN_TO_LAUNCH", (), OK),
    ("MAV_CMD_DO_SET_MODE", (1, 4), OK),
    ("MAV_CMD_DO_SET_MODE", (128, 0), OK),  # a safety switch that is not there goes off, not on
    ("MAV_CMD_DO_SET_MODE", (128, 1), FAILED),
    ("MAV_CMD_DO_SET_MODE", (128, 2), DENIED),
    ("MAV_CMD_DO_SET_MODE", (16, 4), DENIED),
    ("MAV_CMD_DO_SET_MODE", (1, -1), FAILED),
    ("MAV_CMD_DO_CHANGE_SPEED", (1, 0), DENIED),
    ("MAV_CMD_DO_CHANGE_SPEED", (4, 5), DENIED),
    ("MAV_CMD_DO_CHANGE_SPEED", (1, NAN), DENIED),
    ("MAV_CMD_DO_CHANGE_SPEED", (1, 5), FAILED),  # STABILIZE has no speed
    ("MAV_CMD_CONDITION_YAW", (90,), OK),
    ("MAV_CMD_CONDITION_YAW", (-1,), FAILED),
    ("MAV_CMD_CONDITION_YAW", (361,), FAILED),
    ("MAV_CMD_CONDITION_YAW", (NAN,), FAILED),
    ("MAV_CMD_CONDITION_YAW", (90, 0, 0, 0.5), FAILED),
    ("MAV_CMD_DO_REPOSITION", (0, 1, 0, 0, -35.0, 149.0, 50), UNSUPPORTED),  # COMMAND_INT only
    ("MAV_CMD_GET_HOME_POSITION", (), OK),
    ("MAV_CMD_DO_SET_HOME", (1,), OK),
    ("MAV_CMD_DO_SET_HOME", (0,), OK),  # latitude and longitude 0: here
    ("MAV_CMD_DO_SET_HOME", (2, 0, 0, 0, -35.0, 149.0, 600), FAILED),
    ("MAV_CMD_DO_SET_HOME", (0, 0, 0, 0, -35.0, 149.0, NAN), DENIED),
    ("MAV_CMD_DO_SET_HOME", (0, 0, 0, 0, -35.0, 149.0, 1e6), DENIED),
    ("MAV_CMD_DO_SET_HOME", (0, 0, 0, 0, 95.0, 149.0, 600), FAILED),
    ("MAV_CMD_DO_SET_HOME", (0, 0, 0, 0, INF, 149.0, 600), FAILED),
    ("MAV_CMD_DO_SET_ROI", (0, 0, 0, 0, -35.0, 149.0, 10), OK),
    ("MAV_CMD_DO_SET_ROI_LOCATION", (0, 0, 0, 0, -35.0, 149.0, NAN), DENIED),
    ("MAV_CMD_DO_SET_ROI_LOCATION", (0, 0, 0, 0, -350.0, 149.0, 10), FAILED),
    ("MAV_CMD_DO_SET_ROI_NONE", (), OK),
    ("MAV_CMD_DO_SET_ROI_SYSID", (3,), UNSUPPORTED),
    ("MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES", (1,), OK),
    ("MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES", (0,), FAILED),
    ("MAV_CMD_REQUEST_MESSAGE", (A.MAVLINK_MSG_ID_WIND,), OK),
    ("MAV_CMD_REQUEST_MESSAGE", (NAN,), FAILED),
    ("MAV_CMD_GET_MESSAGE_INTERVAL", (-1,), FAILED),
    ("MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN", (2,), UNSUPPORTED),
    ("MAV_CMD_PREFLIGHT_STORAGE", (1,), DENIED),
    ("MAV_CMD_PREFLIGHT_CALIBRATION", (1,), OK),
    ("MAV_CMD_PREFLIGHT_CALIBRATION", (), UNSUPPORTED),
    ("MAV_CMD_RUN_PREARM_CHECKS", (), OK),
    ("MAV_CMD_DO_FLIGHTTERMINATION", (0,), FAILED),
    ("MAV_CMD_DO_FLIGHTTERMINATION", (1,), OK),
    ("MAV_CMD_DO_MOTOR_TEST", (1, 0, 50, 2), UNSUPPORTED),
    ("MAV_CMD_DO_JUMP_TAG", (1,), FAILED),
    ("MAV_CMD_DO_JUMP_TAG", (70_000,), DENIED),
    ("MAV_CMD_DO_PAUSE_CONTINUE", (0,), FAILED),
    ("MAV_CMD_DO_PAUSE_CONTINUE", (2,), DENIED),
    ("MAV_CMD_DO_LAND_START", (), FAILED),
    ("MAV_CMD_DO_PARACHUTE", (2,), OK),
    ("MAV_CMD_DO_PARACHUTE", (3,), FAILED),
    ("MAV_CMD_DO_GRIPPER", (1, 1), FAILED),
    ("MAV_CMD_DO_AUX_FUNCTION", (153, 3), DENIED),
    ("MAV_CMD_DEBUG_TRAP", (0,), DENIED),
    ("MAV_CMD_NAV_WAYPOINT", (), UNSUPPORTED),
    ("MAV_CMD_IMAGE_START_CAPTURE", (), UNSUPPORTED),
    ("MAV_CMD_DO_FOLLOW", (), UNSUPPORTED),
]


@pytest.mark.parametrize(("name", "params", "result"), GROUND)
def test_on_the_ground(standing: Range, name: str, params: tuple[float, ...], result: int) -> None:
    assert standing.copy().command(V, getattr(A, name), *params) == result


INTS: list[tuple[str, dict[str, Any], int]] = [
    ("MAV_CMD_DO_REPOSITION", {"x": 1, "y": 1, "z": 20.0}, OK),
    ("MAV_CMD_DO_REPOSITION", {"z": 20.0}, DENIED),  # no place
    ("MAV_CMD_DO_REPOSITION", {"x": 1, "y": 1}, DENIED),  # relative altitude 0 means none
    ("MAV_CMD_DO_REPOSITION", {"x": 1, "y": 1, "z": NAN}, DENIED),
    ("MAV_CMD_DO_REPOSITION", {"x": 1, "y": 1, "z": INF}, DENIED),
    ("MAV_CMD_DO_REPOSITION", {"x": 1, "y": 1, "z": 20.0, "frame": LOCAL}, DENIED),
    ("MAV_CMD_DO_REPOSITION", {"x": 900_000_001, "y": 1, "z": 20.0}, DENIED),
    ("MAV_CMD_DO_REPOSITION", {"x": 1, "y": -(2**31), "z": 20.0}, DENIED),
    ("MAV_CMD_NAV_TAKEOFF", {"z": 20.0}, FAILED),  # flies already
    ("MAV_CMD_NAV_TAKEOFF", {"z": 20.0, "frame": 6}, DENIED),  # the frame without _INT only
    ("MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN", {"params": (1.0,)}, FAILED),
    ("MAV_CMD_PREFLIGHT_CALIBRATION", {"params": (1.0,)}, FAILED),
    ("MAV_CMD_RUN_PREARM_CHECKS", {}, BUSY),
    ("MAV_CMD_COMPONENT_ARM_DISARM", {"params": (0.0,)}, FAILED),
    ("MAV_CMD_COMPONENT_ARM_DISARM", {"params": (NAN,)}, UNSUPPORTED),
    ("MAV_CMD_DO_CHANGE_SPEED", {"params": (1.0, INF)}, OK),
    ("MAV_CMD_DO_CHANGE_SPEED", {"params": (NAN, 3.0)}, FAILED),
    ("MAV_CMD_DO_MOTOR_TEST", {"params": (1.0, 1.0, 1500.0, 1.0)}, FAILED),
    ("MAV_CMD_DO_SET_HOME", {"x": -353_000_000, "y": 1_490_000_000, "z": 20.0, "frame": TERRAIN}, OK),
]


@pytest.mark.parametrize(("name", "given", "result"), INTS)
def test_in_the_air_as_command_int(hovering: Range, name: str, given: dict[str, Any], result: int) -> None:
    r = hovering.copy()
    if given.get("x") == 1:
        x, y = at(15.0, 10.0)
        given = {**given, "x": x, "y": y if given["y"] == 1 else given["y"]}
    assert as_int(r, getattr(A, name), **given) == result
    r.run(0.5)
    assert r.engines[0]._fleet.armed(r.engines[0]._fleet.vehicles[0])


@pytest.mark.parametrize(("frame", "z"), [(RELATIVE, 9.0), (ABSOLUTE, 593.0), (TERRAIN, 9.0)])
def test_reposition_flies_there(hovering: Range, frame: int, z: float) -> None:
    r = hovering.copy()
    assert as_int(r, A.MAV_CMD_DO_REPOSITION, (), *at(12.0, -6.0), z, frame) == OK
    r.run(15.0)
    assert r.positions()[0] == pytest.approx((12.0, -6.0, 9.0), abs=0.3)


def test_reposition_changes_the_mode_only_where_it_may(hovering: Range) -> None:
    r = hovering.copy()
    assert r.mode(V, Mode.BRAKE) == OK
    assert as_int(r, A.MAV_CMD_DO_REPOSITION, (-1.0, 0.0), *at(12.0, 0.0), 9.0) == DENIED
    assert as_int(r, A.MAV_CMD_DO_REPOSITION, (-1.0, NAN), *at(12.0, 0.0), 9.0) == DENIED
    assert as_int(r, A.MAV_CMD_DO_REPOSITION, (-1.0, 1.0), *at(12.0, 0.0), 9.0) == OK
    assert r.engines[0]._fleet.vehicles[0].mode == Mode.GUIDED


@pytest.mark.parametrize(("params", "heading"), [((200.0,), 200.0), ((90.0, 0.0, -1.0, 1.0), 270.0)])
def test_yaw_turns_the_nose(hovering: Range, params: tuple[float, ...], heading: float) -> None:
    r = hovering.copy()
    assert as_int(r, A.MAV_CMD_CONDITION_YAW, params) == OK
    r.run(8.0)
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_VFR_HUD) == OK
    assert r.heard("VFR_HUD")[-1].heading == pytest.approx(heading, abs=2)


def test_home_that_was_set_stays_when_arming() -> None:
    r = Range([VehicleSpec(V, 1)])
    assert as_int(r, A.MAV_CMD_DO_SET_HOME, (0.0,), *at(30.0, 40.0), 590.0, ABSOLUTE) == OK
    home, origin = r.heard("HOME_POSITION")[-1], r.heard("GPS_GLOBAL_ORIGIN")[-1]
    assert (home.x, home.y, home.z) == pytest.approx((40.0, 30.0, -6.0), abs=0.01)
    assert origin.altitude == 584_000
    assert r.events("event.home")[-1].causes
    assert r.mode(V, Mode.GUIDED) == OK
    assert r.arm(V) == OK
    assert r.engines[0]._fleet.vehicles[0].home == pytest.approx((30.0, 40.0, 6.0), abs=0.01)


def test_answers_come_before_what_was_asked_for() -> None:
    r = Range([VehicleSpec(V, 1)])
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == OK
    assert [said.message.get_type() for said in r.said[-2:]] == ["COMMAND_ACK", "AUTOPILOT_VERSION"]
    assert r.command(V, A.MAV_CMD_GET_HOME_POSITION) == OK
    kinds = [said.message.get_type() for said in r.said if said.message.get_type() != "HEARTBEAT"]
    assert kinds[-3:] == ["HOME_POSITION", "GPS_GLOBAL_ORIGIN", "COMMAND_ACK"]


def test_a_reboot_forgets_all_but_mission_and_parameters() -> None:
    r = Range([VehicleSpec(V, 1)])
    r.upload(V, square(5, 5))
    r.send(V, A.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2000.0, 9))
    r.send(V, A.MAVLink_request_data_stream_message(1, 1, A.MAV_DATA_STREAM_EXTRA1, 10, 1))
    r.mode(V, Mode.GUIDED)
    r.run(3.0)
    assert r.command(V, A.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == OK
    assert r.heard("COMMAND_ACK")[-1].result == OK
    assert r.events("event.reboot")[-1].causes
    said = len(r.heard("ATTITUDE"))
    r.run(2.0)
    assert len(r.heard("ATTITUDE")) == said
    beat = r.heard("HEARTBEAT")[-1]
    assert beat.custom_mode == Mode.STABILIZE
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_SYSTEM_TIME) == OK
    assert r.heard("SYSTEM_TIME")[-1].time_boot_ms < 2_500
    for name in (b"RTL_ALT", b"SR0_EXTRA1"):
        r.send(V, A.MAVLink_param_request_read_message(1, 1, name, -1))
    r.send(V, A.MAVLink_mission_request_list_message(1, 1, 0))
    r.run(0.05)
    assert [m.param_value for m in r.heard("PARAM_VALUE")[-2:]] == [2000.0, 0.0]
    assert r.heard("MISSION_COUNT")[-1].count == 7


def test_erased_parameters_are_gone_after_the_next_boot() -> None:
    r = Range([VehicleSpec(V, 7, params={"RTL_ALT": 2000})])
    fleet = r.engines[0]._fleet
    assert r.command(V, A.MAV_CMD_PREFLIGHT_STORAGE, 2.0) == OK
    assert fleet.param(fleet.vehicles[0], "RTL_ALT") == 2000.0
    assert r.command(V, A.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == OK
    assert fleet.param(fleet.vehicles[0], "RTL_ALT") == 1500.0
    assert fleet.vehicles[0].system_id == 1  # the system id is a parameter too


def test_a_reboot_in_the_air_needs_its_number_and_lets_it_fall(hovering: Range) -> None:
    r = hovering.copy()
    assert as_int(r, A.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (1.0,), y=20_190_226) == OK
    r.run(2.0)
    assert r.positions()[0, 2] < 1.0


def test_termination_stops_the_motors(hovering: Range) -> None:
    r = hovering.copy()
    assert r.command(V, A.MAV_CMD_DO_FLIGHTTERMINATION, 1.0) == OK
    assert r.events("event.disarmed")[-1].data["reason"] == "termination"


def test_only_the_ground_station_is_heard_where_that_is_enforced() -> None:
    r = Range([VehicleSpec(V, 1, params={"SYSID_ENFORCE": 1, "SYSID_MYGCS": 200})])
    arm = A.MAVLink_command_long_message(1, 1, A.MAV_CMD_DO_SET_MODE, 0, 1, 4, 0, 0, 0, 0, 0)
    for sender in ((255, 190), (7, 1)):
        r.send_bytes(V, Packer(*sender).pack(arm))
    r.run(0.02)
    assert r.heard("COMMAND_ACK") == []
    for sender in ((200, 190), (1, 191)):  # its ground station, and a component of its own
        r.send_bytes(V, Packer(*sender).pack(arm))
    r.run(0.02)
    assert [(a.target_system, a.target_component) for a in r.heard("COMMAND_ACK")] == [(200, 190), (1, 191)]


def test_the_clock_is_told_and_an_answer_is_not_answered() -> None:
    r = Range([VehicleSpec(V, 1)])
    r.run(1.0)
    r.send(V, A.MAVLink_timesync_message(0, 987_654_321))
    r.send(V, A.MAVLink_timesync_message(5, 987_654_321))
    r.run(0.02)
    (answer,) = r.heard("TIMESYNC")
    assert answer.ts1 == 987_654_321
    assert answer.tc1 % 1000 == 1  # ArduPilot adds its system id to the nanoseconds
    assert answer.tc1 == pytest.approx(1e9, abs=2e7)
