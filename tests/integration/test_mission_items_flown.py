"""Mission items in flight: curves, loops of jumps, devices that are not fitted, home that moves, new missions.

Rules and texts are those of ArduPilot's libraries/AP_Mission/AP_Mission.cpp and ArduCopter/mode_auto.cpp.
"""

from __future__ import annotations

import math

import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.mission.command_ids import COMMAND_NAMES, SILENT, SKIPPED, STORED_BY_FIELDS, SUPPORTED
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Item, Range, jump, rtl, speed, start, takeoff, waypoint

pytestmark = pytest.mark.rotating

V = "blue/b1"
A = dialect
ABOVE_HOME = A.MAV_FRAME_GLOBAL_RELATIVE_ALT
NO_PLACE = A.MAV_FRAME_MISSION

Numbers = tuple[float, float, float, float]


def item(command: int, params: Numbers = (0, 0, 0, 0), place: tuple[float, float, float] = (0, 0, 0)) -> Item:
    return ABOVE_HOME, command, params, place


def curve(east: float, north: float, alt: float) -> Item:
    return item(A.MAV_CMD_NAV_SPLINE_WAYPOINT, place=(east, north, alt))


@pytest.fixture
def r() -> Range:
    return Range([VehicleSpec(V, 1)])


def fly(r: Range, items: list[Item]) -> None:
    assert r.upload(V, items) == A.MAV_MISSION_ACCEPTED
    start(r, V)


def test_a_curve_is_flown_without_stopping_and_ends_in_a_leg(r: Range) -> None:
    fly(r, [takeoff(5), waypoint(0, 20, 5), curve(20, 40, 5), curve(40, 20, 5), waypoint(40, 0, 5)])
    slowest = math.inf

    def watch(r: Range) -> None:
        nonlocal slowest
        done = len(r.events("event.item_reached"))
        if done in (2, 3):
            slowest = min(slowest, math.hypot(*r.velocities()[0, :2]))

    while len(r.events("event.item_reached")) < 5:
        assert r.seconds < 90.0
        r.run(0.5, watch)
    assert slowest > 1.0  # joined: it stops at none of them
    passed = [min(math.dist(at[0], (e, n, 5.0)) for _, at in r.track) for e, n in ((20, 40), (40, 20))]
    assert max(passed) < 2.0  # WPNAV_RADIUS


def test_a_jump_over_do_items_ends(r: Range) -> None:
    """The jump's counter is cleared when it is spent, so that the DO items before it could be done for ever."""
    fly(r, [takeoff(5), waypoint(0, 3, 5), speed(3.0), jump(3, 2), waypoint(0, 12, 5)])
    r.run_until(r.has("event.item_reached", 3), 40.0)
    assert [w for w in r.words() if "Jump" in w] == ["Mission: 4 Jump 1/2", "Mission: 4 Jump 2/2"]
    assert r.words().count("Mission: 3 ChangeSpeed") <= 2


def test_a_waypoint_that_is_there_already_is_reached_in_every_pass(r: Range) -> None:
    """Every 10 ms at most, as guidance runs; in ArduCopter in every pass of its loop."""
    fly(r, [takeoff(5), waypoint(0, 0, 5), jump(2, -1)])
    r.run_until(r.has("event.item_reached", 3), 30.0)
    before = len(r.events("event.item_reached"))
    r.run(0.5)
    assert 20 <= len(r.events("event.item_reached")) - before <= 51
    assert "Mission: 3 Jump 2/unlimited" in r.words()


def test_every_item_has_a_name() -> None:
    assert set(COMMAND_NAMES) == SUPPORTED - {A.MAV_CMD_DO_JUMP, A.MAV_CMD_DO_JUMP_TAG}
    assert SILENT <= SUPPORTED
    assert SKIPPED <= SUPPORTED


def test_a_survey_with_a_camera_that_is_not_there(r: Range) -> None:
    trigger = (NO_PLACE, A.MAV_CMD_DO_SET_CAM_TRIGG_DIST, (25.5, 7.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    servo = (NO_PLACE, A.MAV_CMD_DO_SET_SERVO, (9.4, 70_000.0, 5.0, 5.0), (0.0, 0.0, 0.0))
    fence = (NO_PLACE, A.MAV_CMD_DO_FENCE_ENABLE, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    fly(r, [takeoff(5), trigger, servo, fence, waypoint(0, 6, 5)])
    for seq, numbers in ((2, (25.5, 0.0, 1.0, 0.0)), (3, (9.0, 65_535.0, 0.0, 0.0))):
        r.send(V, A.MAVLink_mission_request_int_message(1, 1, seq, 0))
        r.run(0.02)
        back = r.heard("MISSION_ITEM_INT")[-1]
        assert (back.param1, back.param2, back.param3, back.param4) == numbers
        assert (back.frame, back.autocontinue) == (A.MAV_FRAME_GLOBAL, 1)
    r.run_until(r.has("event.item_reached", 2), 40.0)
    assert [w for w in r.words() if w.startswith("Mission: ")] == [
        "Mission: 1 Takeoff", "Mission: 2 SetCamTrigDst", "Mission: 5 WP", "Mission: 3 SetServo",
        "Mission: 4 FenceEnable",
    ]  # fmt: skip
    assert [m.seq for m in r.heard("MISSION_ITEM_REACHED")] == [1, 4, 5]
    assert r.engines[0]._fleet.fence["enabled"][0] != 0


def test_frames_are_read_back_by_their_datum(r: Range) -> None:
    """Only what the altitude counts from is stored (`mission_cmd_to_mavlink_int`)."""
    frames = {0: 0, 5: 0, 2: 0, 3: 3, 6: 3, 10: 10, 11: 10}
    items: list[Item] = [(frame, A.MAV_CMD_NAV_WAYPOINT, (0, 0, 0, 0), (1.0, 2.0, 600.0)) for frame in frames]
    assert r.upload(V, items) == A.MAV_MISSION_ACCEPTED
    for seq, frame in enumerate(frames.values(), 1):
        r.send(V, A.MAVLink_mission_request_int_message(1, 1, seq, 0))
        r.run(0.02)
        assert r.heard("MISSION_ITEM_INT")[-1].frame == frame


@pytest.mark.parametrize("by_mission", [True, False])
def test_home_moves_and_the_fence_and_the_return_with_it(by_mission: bool) -> None:
    """DO_SET_HOME acts at once; the command locks home until the next boot, the mission item does not."""
    r = Range([VehicleSpec(V, 1, params={"FENCE_ENABLE": 1, "FENCE_TYPE": 2, "FENCE_RADIUS": 40, "RTL_LOIT_TIME": 0})])
    lat, lon = (round(part * 1e7) for part in r.origin.geodetic_of(0.0, 35.0))
    if by_mission:
        home = item(A.MAV_CMD_DO_SET_HOME, place=(0.0, 35.0, 1.0))
        fly(r, [takeoff(5), home, waypoint(0.0, 60.0, 5), rtl()])
    else:
        r.take_off(V, 5.0)
        r.send(V, A.MAVLink_command_int_message(1, 1, ABOVE_HOME, A.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, 0, 0, lat, lon, 1))
        r.run(0.02)
        assert r.heard("COMMAND_ACK")[-1].result == A.MAV_RESULT_ACCEPTED
        r.send(V, A.MAVLink_param_set_message(1, 1, b"FENCE_RADIUS", 30.0, A.MAV_PARAM_TYPE_REAL32))
        r.run(0.3)  # 35 m from the new home: looked at every 100 ms, and turned back from
        assert len(r.events("event.fence_breach")) == 1
    r.run_until(r.has("event.disarmed"), 120.0)
    if by_mission:
        assert not r.events("event.fence_breach")  # 60 m from where it took off, 25 m from the new home
    assert math.hypot(r.positions()[0, 0], r.positions()[0, 1] - 35.0) < 0.5
    moved = r.heard("HOME_POSITION")[-1]
    assert (moved.latitude, moved.longitude) == pytest.approx((lat, lon), abs=1)
    r.run(1.0)
    assert r.mode(V, 4) == 0
    assert r.arm(V) == 0
    anew = r.heard("HOME_POSITION")[-1]
    assert anew.altitude == pytest.approx(584_000.0 if by_mission else 585_000.0, abs=200)  # mm: where it stands


def test_only_a_mission_that_differs_ahead_is_flown_anew(r: Range) -> None:
    far = [takeoff(5), waypoint(0, 80, 5), waypoint(20, 80, 5), waypoint(20, 0, 5)]
    fly(r, far)
    r.run_until(lambda r: r.velocities()[0, 1] > 5.0, 30.0)
    told = "Auto mission changed, restarted command"
    assert r.upload(V, far) == A.MAV_MISSION_ACCEPTED
    r.run(1.0)
    assert told not in r.words()
    assert r.velocities()[0, 1] > 5.0  # it has not braked
    assert r.upload(V, [*far[:3], waypoint(30, 0, 5)]) == A.MAV_MISSION_ACCEPTED
    r.run(0.1)
    assert r.words().count(told) == 1


def test_circles_are_counted(r: Range) -> None:
    fly(r, [takeoff(5), item(A.MAV_CMD_NAV_LOITER_TURNS, (2.0, 0.0, 3.0, 0.0), (0.0, 0.0, 5.0))])
    r.run_until(r.has("event.item_reached", 2), 80.0)
    told = [w.removeprefix("Mission: starting circle ") for w in r.words() if "circle" in w]
    assert told == ["1/2", "2/2", "3/2"]  # the last before verify_circle looks whether there is one more


def test_channels_are_told_at_rest_and_overridden(r: Range) -> None:
    def heard() -> list[int]:
        assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_RC_CHANNELS) == 0
        message = r.heard("RC_CHANNELS")[-1]
        return [message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan8_raw, message.chancount]

    assert heard() == [1500, 1500, 1000, 1000, 8]
    ignored = [65535] * 8
    ignored[2], ignored[7] = 1300, 1800
    r.send(V, A.MAVLink_rc_channels_override_message(1, 1, *ignored))
    r.run(0.02)
    assert heard() == [1500, 1500, 1300, 1800, 8]
    r.run(3.1)  # RC_OVERRIDE_TIME
    assert heard() == [1500, 1500, 1000, 1000, 8]
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_SYS_STATUS) == 0
    assert r.heard("SYS_STATUS")[-1].onboard_control_sensors_health & A.MAV_SYS_STATUS_SENSOR_RC_RECEIVER


def test_whole_numbers_of_fittings_stay_in_their_bytes() -> None:
    for command, kinds in STORED_BY_FIELDS.items():
        assert len(kinds) == 7, command
        assert set(kinds) <= set("BbHhfe?1crpy-"), command
