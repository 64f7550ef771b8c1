"""Commands, modes and arming on the ground, answered as ArduCopter answers (GCS_MAVLink_Copter.cpp, GCS_Common.cpp)."""

from __future__ import annotations

import math

import pytest

from skyrange.codec.mavlink import Packer, dialect
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range, square, waypoint

V = "blue/b1"
A = dialect
OK, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4


@pytest.fixture
def r() -> Range:
    return Range([VehicleSpec(V, 1)])


def shown(r: Range) -> tuple[int, bool]:
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_HEARTBEAT) == OK
    beat = r.heard("HEARTBEAT")[-1]
    return beat.custom_mode, bool(beat.base_mode & A.MAV_MODE_FLAG_SAFETY_ARMED)


def test_boots_disarmed_in_stabilize_with_a_heartbeat_each_second(r: Range) -> None:
    r.run(5.0)
    beats = r.heard("HEARTBEAT")
    assert len(beats) == 5
    assert {(b.custom_mode, b.autopilot, b.type) for b in beats} == {
        (0, A.MAV_AUTOPILOT_ARDUPILOTMEGA, A.MAV_TYPE_QUADROTOR)
    }
    assert {s.message.get_type() for s in r.said} == {"HEARTBEAT"}


@pytest.mark.parametrize("command", [A.MAV_CMD_DO_REPOSITION, A.MAV_CMD_NAV_LOITER_TURNS, 60000])
def test_unknown_commands_are_unsupported(r: Range, command: int) -> None:
    assert r.command(V, command) == UNSUPPORTED


@pytest.mark.parametrize("mode", [Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER])
def test_modes_of_a_pilot_arm_with_the_throttle_down(r: Range, mode: Mode) -> None:
    assert r.mode(V, mode) == OK
    r.send(V, A.MAVLink_manual_control_message(1, 0, 0, 700, 0, 0))
    assert r.arm(V) == FAILED
    assert "Arm: Throttle too high" in r.words()
    r.send(V, A.MAVLink_manual_control_message(1, 0, 0, 0, 0, 0))
    assert r.arm(V) == OK


@pytest.mark.parametrize("mode", [Mode.RTL, Mode.LAND, Mode.BRAKE, Mode.AUTO])
def test_modes_that_do_not_arm(r: Range, mode: Mode) -> None:
    assert r.mode(V, mode) == OK
    assert r.arm(V) == FAILED
    assert r.events("event.armed") == []


def test_auto_arms_where_its_option_says() -> None:
    r = Range([VehicleSpec(V, 1, params={"AUTO_OPTIONS": 1})])
    assert r.mode(V, Mode.AUTO) == OK
    assert r.arm(V) == FAILED
    assert "Arm: Mode requires mission" in r.words()
    r.upload(V, square(5, 5))
    assert r.arm(V) == OK
    r.run(3.0)
    assert r.events("event.takeoff") == []  # not asked to
    assert r.command(V, A.MAV_CMD_MISSION_START) == OK
    r.run(3.0)
    assert len(r.events("event.takeoff")) == 1


def test_arming_in_guided_and_disarming(r: Range) -> None:
    assert r.mode(V, Mode.GUIDED) == OK
    assert r.arm(V) == OK
    assert r.arm(V) == OK  # already
    assert shown(r) == (4, True)
    assert r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == OK
    assert r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == OK
    assert shown(r) == (4, False)
    assert r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 5.0) == UNSUPPORTED
    assert [n.data["reason"] for n in r.events("event.disarmed")] == ["command"]
    assert len(r.events("event.armed")) == 1
    assert r.events("event.armed")[0].causes[0].serial == 1


def test_forced_arming_skips_the_checks(r: Range) -> None:
    assert r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 2989.0) == OK


def test_disarms_by_itself_after_the_delay(r: Range) -> None:
    r.mode(V, Mode.GUIDED)
    r.arm(V)
    armed = r.seconds
    r.run_until(r.has("event.disarmed"), 12.0)
    assert r.seconds - armed == pytest.approx(10.0, abs=0.1)  # DISARM_DELAY
    assert r.events("event.disarmed")[0].data["reason"] == "disarm_delay"


def test_unknown_mode_fails_with_a_text(r: Range) -> None:
    assert r.mode(V, 99) == FAILED
    assert "No such mode 99" in r.words()
    assert r.command(V, A.MAV_CMD_DO_SET_MODE, 0.0, 4.0) == DENIED  # not a custom mode
    assert r.command(V, A.MAV_CMD_DO_SET_MODE, 1.0, math.nan) == DENIED
    for base in (3e38, -3e38, math.inf, math.nan):  # 0 to ArduPilot on x86
        assert r.command(V, A.MAV_CMD_DO_SET_MODE, base, 4.0) == DENIED
    r.send(V, A.MAVLink_set_mode_message(1, A.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 4))
    r.run(0.02)
    assert r.heard("COMMAND_ACK")[-1].command == A.MAV_CMD_DO_SET_MODE  # SET_MODE is obeyed, never acknowledged
    assert shown(r)[0] == 4


def test_auto_needs_a_mission_that_takes_off_when_armed_on_the_ground(r: Range) -> None:
    r.mode(V, Mode.GUIDED)
    r.arm(V)
    assert r.mode(V, Mode.AUTO) == FAILED
    r.upload(V, [waypoint(5, 5, 5)])
    assert r.command(V, A.MAV_CMD_MISSION_START) == FAILED
    assert "Auto: Missing Takeoff Cmd" in r.words()
    assert shown(r)[0] == 4
    r.send(V, A.MAVLink_manual_control_message(1, 0, 0, 900, 0, 0))
    assert r.mode(V, Mode.STABILIZE) == FAILED  # it would leap off the ground
    assert "Mode change to STABILIZE failed: throttle too high" in r.words()


def test_takeoff_needs_guided_armed_and_a_height_above(r: Range) -> None:
    takeoff = A.MAV_CMD_NAV_TAKEOFF
    assert r.command(V, takeoff, 0, 0, 0, 0, 0, 0, 5.0) == FAILED
    r.mode(V, Mode.GUIDED)
    assert r.command(V, takeoff, 0, 0, 0, 0, 0, 0, 5.0) == FAILED
    r.arm(V)
    assert r.command(V, takeoff, 0, 0, 0, 0, 0, 0, -5.0) == FAILED
    assert r.command(V, takeoff, 0, 0, 0, 0, 0, 0, math.nan) == DENIED
    r.send(V, A.MAVLink_command_int_message(1, 1, A.MAV_FRAME_GLOBAL, takeoff, 0, 0, 0, 0, 0, 0, 0, 0, 600.0))
    r.run(0.02)
    assert r.heard("COMMAND_ACK")[-1].result == DENIED
    assert r.command(V, takeoff, 0, 0, 0, 0, 0, 0, 5.0) == OK


def test_message_intervals(r: Range) -> None:
    set_interval, get_interval = A.MAV_CMD_SET_MESSAGE_INTERVAL, A.MAV_CMD_GET_MESSAGE_INTERVAL
    attitude = A.MAVLINK_MSG_ID_ATTITUDE
    assert r.command(V, set_interval, attitude, 100_000) == OK
    r.run(2.0)
    assert len(r.heard("ATTITUDE")) == pytest.approx(20, abs=1)
    assert r.command(V, get_interval, attitude) == OK
    assert r.heard("MESSAGE_INTERVAL")[-1].interval_us == 100_000
    assert r.command(V, set_interval, attitude, -1) == OK
    said = len(r.heard("ATTITUDE"))
    r.run(1.0)
    assert len(r.heard("ATTITUDE")) == said
    assert r.command(V, get_interval, attitude) == OK
    assert r.heard("MESSAGE_INTERVAL")[-1].interval_us == -1
    assert r.command(V, set_interval, A.MAVLINK_MSG_ID_HEARTBEAT, 0) == OK  # its default
    assert r.command(V, get_interval, A.MAVLINK_MSG_ID_HEARTBEAT) == OK
    assert r.heard("MESSAGE_INTERVAL")[-1].interval_us == 1_000_000
    for bad in ((attitude, 100.0), (attitude, -2), (11000, 1e5), (math.nan, 1e5), (attitude, math.inf)):
        assert r.command(V, set_interval, *bad) == DENIED
    assert r.command(V, set_interval, attitude, 1e5, 1.0) == DENIED  # another rate of a stream of messages
    assert r.command(V, set_interval, A.MAVLINK_MSG_ID_WIND, 500_000) == OK  # known, though it has none to tell
    assert r.command(V, get_interval, A.MAVLINK_MSG_ID_WIND) == OK
    assert r.heard("MESSAGE_INTERVAL")[-1].interval_us == 500_000
    assert r.command(V, get_interval, 11000) == FAILED
    assert r.heard("MESSAGE_INTERVAL")[-1].interval_us == 0


def test_requested_messages(r: Range) -> None:
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == OK
    version = r.heard("AUTOPILOT_VERSION")[-1]
    assert version.capabilities & A.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    assert version.flight_sw_version >> 24 == 4
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_HOME_POSITION) == OK
    assert r.heard("HOME_POSITION")[-1].altitude == 584_000
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, 11000) == FAILED


def test_data_streams(r: Range) -> None:
    r.send(V, A.MAVLink_request_data_stream_message(1, 1, A.MAV_DATA_STREAM_ALL, 4, 1))
    r.run(2.0)
    for kind in ("ATTITUDE", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "SYS_STATUS", "VFR_HUD", "MISSION_CURRENT"):
        assert len(r.heard(kind)) == pytest.approx(8, abs=1), kind
    r.send(V, A.MAVLink_request_data_stream_message(1, 1, A.MAV_DATA_STREAM_ALL, 4, 0))
    r.run(0.02)
    said = len(r.heard("ATTITUDE"))
    r.run(1.0)
    assert len(r.heard("ATTITUDE")) == said


def test_boot_rates_come_from_the_stream_parameters() -> None:
    r = Range([VehicleSpec(V, 1, params={"SR0_POSITION": 5})])
    r.run(2.0)
    assert len(r.heard("GLOBAL_POSITION_INT")) == 10


def test_only_mail_for_this_system_is_obeyed(r: Range) -> None:
    station = Packer(255, 190)

    def ask(system: int, component: int) -> bytes:
        return station.pack(
            A.MAVLink_command_long_message(system, component, A.MAV_CMD_DO_SET_MODE, 0, 1, 4, 0, 0, 0, 0, 0)
        )

    r.send_bytes(V, ask(2, 1))
    r.run(0.02)
    assert r.heard("COMMAND_ACK") == []
    for address in ((1, 1), (1, 0), (0, 0), (1, 77)):  # nobody else is on board: 77 is taken as this one
        r.send_bytes(V, ask(*address))
    r.send_bytes(V, Packer(1, 1).pack(A.MAVLink_param_request_list_message(1, 1)))  # an echo of its own
    r.run(0.2)
    assert len(r.heard("COMMAND_ACK")) == 4
    assert r.heard("PARAM_VALUE") == []
