"""A throttle that nobody moves: no climb in modes that hold a height, none at all in STABILIZE.

ArduCopter/Attitude.cpp `get_pilot_desired_climb_rate` asks `has_valid_input`, mode.cpp `get_pilot_desired_throttle`
does not.
"""

from __future__ import annotations

import pytest

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.modes import Mode
from tests.integration.flight_harness import Range
from tests.integration.hovering import V, hovering, standing

A = dialect
OK = 0


def throttle(r: Range, per_mille: int) -> None:
    r.send(V, A.MAVLink_manual_control_message(1, 0, 0, per_mille, 0, 0))


@pytest.mark.parametrize("mode", [Mode.LOITER, Mode.ALT_HOLD])
def test_height_is_held_where_no_pilot_is_heard(mode: Mode) -> None:
    r = hovering()
    assert r.mode(V, mode) == OK
    r.run(10.0)
    assert r.positions()[0] == pytest.approx((0.0, 0.0, 10.0), abs=0.3)


def test_a_throttle_that_is_heard_counts_until_it_runs_out() -> None:
    r = hovering()
    assert r.mode(V, Mode.LOITER) == OK
    throttle(r, 250)  # a good metre per second downwards, of PILOT_SPEED_UP 2.5
    r.run(2.0)
    assert r.positions()[0, 2] < 9.0
    r.run(3.0)  # RC_OVERRIDE_TIME is 3 s
    low = r.positions()[0, 2]
    r.run(3.0)
    assert low > 5.0
    assert r.positions()[0, 2] == pytest.approx(low, abs=0.2)


def test_stabilize_falls() -> None:
    r = hovering()
    assert r.mode(V, Mode.LOITER) == OK
    r.run(1.0)
    assert r.mode(V, Mode.STABILIZE) == OK
    r.run(1.0)
    assert r.positions()[0, 2] < 7.0  # half of g times t squared is 4.9 m


@pytest.mark.parametrize("mode", [Mode.LOITER, Mode.ALT_HOLD])
def test_on_the_ground_it_stays_may_go_to_stabilize_and_disarms_by_itself(mode: Mode) -> None:
    r = standing()
    assert r.mode(V, mode) == OK
    assert r.arm(V) == OK
    r.run(3.0)
    assert r.mode(V, Mode.STABILIZE) == OK  # not "throttle too high"
    assert r.mode(V, mode) == OK
    r.run(8.0)
    assert r.positions()[0, 2] < 0.1
    assert r.events("event.takeoff") == []
    r.run_until(r.has("event.disarmed"), 4.0)  # DISARM_DELAY 10 s
