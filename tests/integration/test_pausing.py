"""DO_PAUSE_CONTINUE (ModeAuto::pause, ModeGuided::pause): stops smoothly, tells it, goes on to the same place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.modes import Mode
from tests.integration.flight_harness import Range, takeoff, waypoint
from tests.integration.hovering import V, hovering, put

pytestmark = pytest.mark.rotating

A = dialect
OK, FAILED = 0, 4
VELOCITY_ONLY = 0b110111000111
POSITION_ONLY = 0b110111111000


def ask(r: Range, what: int) -> int:
    return r.command(V, A.MAV_CMD_DO_PAUSE_CONTINUE, float(what))


def target(mask: int, place: tuple[float, float, float], velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
    """North, east, down."""
    return A.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, A.MAV_FRAME_LOCAL_NED, mask, *place, *velocity, 0, 0, 0, 0, 0
    )


def speed(r: Range) -> float:
    return float(np.linalg.norm(r.velocities()[0]))


def mission_state(r: Range) -> int:
    assert r.command(V, A.MAV_CMD_REQUEST_MESSAGE, A.MAVLINK_MSG_ID_MISSION_CURRENT) == OK
    return int(r.heard("MISSION_CURRENT")[-1].mission_state)


def on_a_leg() -> Range:
    r = hovering()
    assert r.upload(V, [takeoff(10), waypoint(0, 150, 10), waypoint(60, 150, 10)]) == 0
    assert r.mode(V, Mode.AUTO) == OK
    r.send(V, A.MAVLink_mission_set_current_message(1, 1, 2))
    r.run(6.0)
    assert speed(r) > 4.0
    return r


def test_a_mission_stops_on_its_way_tells_so_and_goes_on() -> None:
    r = on_a_leg()
    since = len(r.track)
    assert ask(r, 0) == OK
    at = r.positions()[0].copy()
    north = []
    r.run(9.0, lambda r: north.append(float(r.velocities()[0, 1])))
    # WPNAV_ACCEL is 2.5 m/s²; half as much again for what control adds to it
    assert -2.5 * 1.5 < min(np.diff(north)) / 0.05 < -1.5
    here = r.positions()[0].copy()
    assert speed(r) < 0.1
    # WPNAV_SPEED 10 m/s, WPNAV_ACCEL 2.5 m/s²: 20 m at most, and as far again for the jerk's ramps
    assert 1.0 < here[1] - at[1] < 40.0
    assert here[0] == pytest.approx(0.0, abs=0.3)
    assert here[2] == pytest.approx(10.0, abs=0.3)
    assert (np.diff([p[0, 1] for _, p in r.track[since:]]) > -0.02).all()  # no step back
    assert mission_state(r) == A.MISSION_STATE_PAUSED
    r.run(10.0)
    assert np.linalg.norm(r.positions()[0] - here) < 0.5
    assert not any(m.seq >= 2 for m in r.heard("MISSION_ITEM_REACHED"))
    assert ask(r, 1) == OK
    assert mission_state(r) == A.MISSION_STATE_ACTIVE
    r.run_until(lambda r: any(m.seq == 3 for m in r.heard("MISSION_ITEM_REACHED")), 60.0)
    assert r.positions()[0] == pytest.approx((60.0, 150.0, 10.0), abs=1.0)
    reached = [m.seq for m in r.heard("MISSION_ITEM_REACHED")]
    assert reached[-2:] == [2, 3]


def test_a_paused_mission_waits_before_another_item_too() -> None:
    r = on_a_leg()
    assert ask(r, 0) == OK
    r.run(5.0)
    here = r.positions()[0].copy()
    r.send(V, A.MAVLink_mission_set_current_message(1, 1, 3))
    r.run(4.0)
    assert np.linalg.norm(r.positions()[0] - here) < 0.5
    assert ask(r, 1) == OK
    r.run(4.0)
    assert r.positions()[0, 0] > 2.0  # towards item 3


def test_what_cannot_be_paused() -> None:
    r = hovering()
    assert r.mode(V, Mode.LOITER) == OK
    for what, words in ((0, "Failed to pause"), (1, "Failed to resume")):
        assert ask(r, what) == FAILED
        assert r.words()[-1] == words
    r = on_a_leg()
    r.run_until(lambda r: any(m.seq == 3 for m in r.heard("MISSION_ITEM_REACHED")), 60.0)
    r.run(1.0)
    assert ask(r, 0) == FAILED  # it is there already
    assert ask(r, 1) == OK  # which changes nothing


def test_a_new_mode_ends_a_pause() -> None:
    r = on_a_leg()
    assert ask(r, 0) == OK
    assert r.mode(V, Mode.RTL) == OK
    assert r.mode(V, Mode.AUTO) == OK
    assert mission_state(r) == A.MISSION_STATE_ACTIVE
    r.run(4.0)
    assert speed(r) > 1.0


@pytest.mark.parametrize("options", [0, 64])
def test_guided_stops_and_goes_on_to_its_place(options: int) -> None:
    r = hovering()
    put(r, "GUID_OPTIONS", options)
    r.send(V, target(POSITION_ONLY, (60.0, 0.0, -10.0)))
    r.run(5.0)
    assert speed(r) > 3.0
    assert ask(r, 0) == OK
    r.run(9.0)
    here = r.positions()[0].copy()
    assert speed(r) < 0.1
    assert 5.0 < here[1] < 55.0
    r.run(3.0)
    assert np.linalg.norm(r.positions()[0] - here) < 0.3
    assert ask(r, 1) == OK
    r.run(15.0)
    assert r.positions()[0] == pytest.approx((0.0, 60.0, 10.0), abs=0.5)


def test_what_guided_is_told_meanwhile_counts_afterwards() -> None:
    r = hovering()
    assert ask(r, 0) == OK
    r.send(V, target(POSITION_ONLY, (0.0, 12.0, -10.0)))
    r.run(4.0)
    assert np.linalg.norm(r.positions()[0] - (0.0, 0.0, 10.0)) < 0.3
    assert ask(r, 1) == OK
    r.run(12.0)
    assert r.positions()[0] == pytest.approx((12.0, 0.0, 10.0), abs=0.3)


def test_a_velocity_that_ran_out_meanwhile_moves_nothing() -> None:
    r = hovering()
    r.send(V, target(VELOCITY_ONLY, (0.0, 0.0, 0.0), (3.0, 0.0, 0.0)))
    r.run(1.0)
    assert ask(r, 0) == OK
    r.run(5.0)  # GUID_TIMEOUT is 3 s
    here = r.positions()[0].copy()
    assert ask(r, 1) == OK
    r.run(3.0)
    assert np.linalg.norm(r.positions()[0] - here) < 0.3


def test_a_take_off_waits_on_the_ground_and_a_disarmed_aircraft_stays_off() -> None:
    r = hovering()
    assert r.mode(V, Mode.LAND) == OK
    r.run_until(r.has("event.disarmed"), 40.0)
    assert r.mode(V, Mode.GUIDED) == OK
    assert r.arm(V) == OK
    assert ask(r, 0) == OK
    assert r.command(V, A.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0) == OK
    r.run(4.0)
    assert r.positions()[0, 2] < 0.2
    assert r.command(V, A.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == OK
    r.run(0.5)
    assert (r.engines[0]._actuators[0] == 0.0).all()
    assert r.arm(V) == OK
    assert ask(r, 1) == OK
    assert r.command(V, A.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0) == OK
    r.run(10.0)
    assert r.positions()[0, 2] == pytest.approx(5.0, abs=0.3)
