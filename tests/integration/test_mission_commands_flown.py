"""Mission commands that ArduCopter flies, skips or obeys in AUTO, and landings in the middle of a mission.

Rules and texts are those of ArduPilot's libraries/AP_Mission (`advance_current_nav_cmd`, `is_takeoff_next`,
`continue_after_land_check_for_takeoff`), ArduCopter/mode_auto.cpp and libraries/RC_Channel.
"""

from __future__ import annotations

import math

import pytest

from skyrange.codec.mavlink import dialect as A  # noqa: N812
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Item, Range, jump, land, rtl, start, takeoff, waypoint

pytestmark = pytest.mark.rotating

V = "blue/b1"
ABOVE_HOME = A.MAV_FRAME_GLOBAL_RELATIVE_ALT
NO_PLACE = A.MAV_FRAME_MISSION
TOLD = "Mission: "


def do(command: int, *params: float, x: float = 0.0, z: float = 0.0) -> Item:
    """A command without a place."""
    one, two, three, four = (*params, *([0.0] * (4 - len(params))))
    return NO_PLACE, command, (one, two, three, four), (x, 0.0, z)


def here(command: int, *params: float, alt: float = 0.0) -> Item:
    """A command whose place is left out; the harness gives the start's."""
    one, two, three, four = (*params, *([0.0] * (4 - len(params))))
    return ABOVE_HOME, command, (one, two, three, four), (0.0, 0.0, alt)


@pytest.fixture
def r() -> Range:
    return Range([VehicleSpec(V, 1)])


def fly(r: Range, items: list[Item]) -> None:
    assert r.upload(V, items) == A.MAV_MISSION_ACCEPTED
    start(r, V)


def told(r: Range) -> list[str]:
    return [word.removeprefix(TOLD) for word in r.words() if word.startswith(TOLD)]


def modes(r: Range) -> list[str]:
    return [str(note.data["mode"]) for note in r.events("event.mode")]


def test_a_landing_in_the_middle_ends_the_mission(r: Range) -> None:
    fly(r, [takeoff(3), land(0, 0), takeoff(3), rtl()])
    r.run_until(r.has("event.disarmed"), 60.0)
    r.run(5.0)
    assert told(r) == ["1 Takeoff", "2 Land"]
    assert not r.events("event.takeoff")[1:]
    assert [m.seq for m in r.heard("MISSION_ITEM_REACHED")] == [1]


@pytest.mark.parametrize("between", [[], [do(A.MAV_CMD_NAV_DELAY, 2.0)]])
def test_mis_options_continue_after_a_landing(between: list[Item]) -> None:
    r = Range([VehicleSpec(V, 1, params={"MIS_OPTIONS": 4})])
    fly(r, [takeoff(3), land(0, 0), *between, takeoff(3), land(0, 0)])
    r.run_until(r.has("event.disarmed"), 120.0)
    assert len(r.events("event.takeoff")) == 2
    assert len(r.events("event.disarmed")) == 1


def test_a_mission_may_begin_with_a_delay(r: Range) -> None:
    fly(r, [do(A.MAV_CMD_NAV_DELAY, 4.0), takeoff(3), rtl()])
    r.run(4.5)
    assert told(r)[0] == "1 Delay"
    assert r.positions()[0, 2] < 0.1
    r.run_until(r.has("event.takeoff"), 10.0)


def test_motors_start_two_seconds_after_arming(r: Range) -> None:
    """ARMING_DELAY_SEC; then they spool up and the throttle is raised."""
    assert r.mode(V, 4) == 0
    assert r.arm(V) == 0
    armed_s = r.seconds
    assert r.command(V, A.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0) == 0
    r.run(1.9)
    assert r.engines[0]._actuators.max() == 0.0
    r.run_until(r.has("event.takeoff"), 10.0)
    assert r.seconds - armed_s == pytest.approx(2.0 + 0.5 + 0.8, abs=0.15)  # delay, spool-up, throttle


def test_an_auxiliary_function_changes_the_mode(r: Range) -> None:
    """As in ArduPilot's test AuxFunctionsInMission: 70 is ALT_HOLD."""
    fly(r, [takeoff(5), do(A.MAV_CMD_DO_AUX_FUNCTION, 70.0, 2.0), do(A.MAV_CMD_NAV_DELAY, 2.0), rtl()])
    r.run_until(lambda r: modes(r)[-1] == "ALT_HOLD", 30.0)
    assert r.events("event.mode")[-1].data["reason"] == "aux_function"
    r.run(5.0)
    assert modes(r)[-1] == "ALT_HOLD"
    assert told(r) == ["1 Takeoff", "2 AuxFunction", "3 Delay"]


@pytest.mark.parametrize(("function", "position"), [(70.0, 0.0), (9.0, 2.0), (0.0, 2.0)])
def test_an_auxiliary_function_without_effect_is_passed(r: Range, function: float, position: float) -> None:
    fly(r, [takeoff(5), do(A.MAV_CMD_DO_AUX_FUNCTION, function, position), waypoint(0, 5, 5)])
    r.run_until(r.has("event.item_reached", 2), 30.0)
    assert modes(r)[-1] == "AUTO"
    assert [m.seq for m in r.heard("MISSION_ITEM_REACHED")] == [1, 3]


@pytest.mark.parametrize("items", [[do(A.MAV_CMD_DO_AUX_FUNCTION, 24.0, 2.0)], [do(A.MAV_CMD_DO_PARACHUTE, 1.0)]])
def test_what_would_be_flown_differently_is_refused(r: Range, items: list[Item]) -> None:
    """A mission reset within a mission, and a parachute that the aircraft does not have."""
    assert r.upload(V, [takeoff(5), *items]) == A.MAV_MISSION_UNSUPPORTED


def test_commands_of_other_vehicles_are_skipped(r: Range) -> None:
    fly(
        r,
        [
            here(A.MAV_CMD_NAV_VTOL_TAKEOFF, alt=5.0),
            do(A.MAV_CMD_NAV_ALTITUDE_WAIT, 100.0, 1.0),
            do(A.MAV_CMD_DO_SET_REVERSE, 1.0),
            do(A.MAV_CMD_NAV_SET_YAW_SPEED, 90.0, 2.0),
            waypoint(0, 5, 5),
            here(A.MAV_CMD_NAV_CONTINUE_AND_CHANGE_ALT, 0.0, alt=50.0),
            here(A.MAV_CMD_NAV_VTOL_LAND),
        ],
    )
    r.run_until(r.has("event.disarmed"), 90.0)
    assert told(r) == [
        "1 VTOLTakeoff",
        "2 AltitudeWait",
        "3 SetReverse",
        "4 SetYawSpd",
        "5 WP",
        "6 ContinueAndChangeAlt",
        "7 VTOLLand",
    ]
    assert "Skipping invalid cmd #194" in r.words()
    assert [note.data["seq"] for note in r.events("event.item_reached")] == [1, 5]
    assert [m.seq for m in r.heard("MISSION_ITEM_REACHED")] == [3, 5]  # of one pass only the last


def test_jumps_to_tags(r: Range) -> None:
    tag = do(A.MAV_CMD_JUMP_TAG, 300.0)
    fly(r, [takeoff(5), tag, waypoint(0, 5, 5), do(A.MAV_CMD_DO_JUMP_TAG, 300.0, 2.0), waypoint(0, 0, 5)])
    r.run_until(r.has("event.item_reached", 5), 60.0)
    assert [note.data["seq"] for note in r.events("event.item_reached")] == [1, 3, 3, 3, 5]
    assert [word for word in r.words() if "Jump" in word] == ["Mission: 4 Jump 1/2", "Mission: 4 Jump 2/2"]
    assert "Mission: 2 Tag 300" in r.words()
    assert r.command(V, A.MAV_CMD_DO_JUMP_TAG, 300.0) == A.MAV_RESULT_ACCEPTED
    assert r.command(V, A.MAV_CMD_DO_JUMP_TAG, 301.0) == A.MAV_RESULT_FAILED


@pytest.mark.parametrize(
    "held",
    [
        [do(A.MAV_CMD_NAV_SCRIPT_TIME, 1.0, 3.0)],
        [do(A.MAV_CMD_DO_GUIDED_LIMITS, 3.0), do(A.MAV_CMD_NAV_GUIDED_ENABLE, 1.0)],
    ],
)
def test_a_mission_gives_way_to_guided_targets_for_a_time(r: Range, held: list[Item]) -> None:
    fly(r, [takeoff(5), *held, rtl()])
    last = 1 + len(held)
    r.run_until(r.has("event.item_reached"), 30.0)
    began_s = r.seconds
    r.go_to(V, 0.0, 10.0, 5.0)
    r.run(2.0)
    assert r.positions()[0, 1] > 1.0  # it obeys
    r.run_until(lambda r: [m.seq for m in r.heard("MISSION_ITEM_REACHED")][-1] == last, 10.0)
    assert r.seconds - began_s == pytest.approx(3.0, abs=0.1)
    assert modes(r)[-1] == "AUTO"


def test_guided_that_is_not_enabled_is_complete_at_once(r: Range) -> None:
    fly(r, [takeoff(5), do(A.MAV_CMD_NAV_GUIDED_ENABLE, 0.0), jump(2, -1)])
    r.run_until(r.has("event.item_reached", 5), 30.0)


def test_an_attitude_for_a_time(r: Range) -> None:
    """Pitch of -10° is nose down: towards the yaw of 90°, east, while it climbs."""
    level = do(A.MAV_CMD_NAV_ATTITUDE_TIME, 3.0, 0.0, -10.0, 90.0, x=0.0)
    fly(r, [takeoff(5), level, rtl()])
    r.run_until(r.has("event.item_reached", 2), 30.0)
    velocity = r.velocities()[0]
    assert velocity[0] > 2.0
    assert abs(velocity[1]) < 1.5
    assert math.degrees(r.engines[0]._fleet.estimate["yaw"][0]) == pytest.approx(0.0, abs=10.0)


def test_a_wait_where_it_is_takes_the_time_of_a_leg_of_centimetres(r: Range) -> None:
    """A place that is left out is the present one in whole centimetres and 1e-7 degrees, and is flown to."""
    stay = (ABOVE_HOME, A.MAV_CMD_NAV_LOITER_TIME, (2.0, 0.0, 0.0, 0.0), (3.0, 4.0, 0.0))
    fly(r, [takeoff(5), waypoint(3.0, 4.0, 5), stay, rtl()])
    r.run_until(r.has("event.item_reached", 2), 40.0)
    began_s = r.seconds
    r.run_until(r.has("event.item_reached", 3), 10.0)
    assert 2.0 <= r.seconds - began_s < 4.0


def test_a_climb_speed_that_follows_the_start_of_loiter_to_alt_counts(r: Range) -> None:
    """The first DO command before it runs before it starts and is forgotten; the second runs after."""
    roi, slow = do(A.MAV_CMD_DO_SET_ROI_NONE), do(A.MAV_CMD_DO_CHANGE_SPEED, 2.0, 1.0, -1.0)
    fly(r, [takeoff(3), waypoint(0, 0, 3, 1.0), roi, slow, here(A.MAV_CMD_NAV_LOITER_TO_ALT, alt=12.0), rtl()])
    r.run_until(lambda flown: flown.positions()[0, 2] > 6.0, 60.0)
    below = r.positions()[0, 2]
    r.run(2.0)
    assert r.positions()[0, 2] - below == pytest.approx(2.0, abs=0.2)
