"""A bad estimate: ArduCopter/ekf_check.cpp, and events.cpp `gpsglitch_check`, `failsafe_deadreckon_check`."""

from __future__ import annotations

import pytest

from skyrange.vehicle.builtin.modes import Mode, mode_of
from tests.integration.flight_harness import Range
from tests.integration.hovering import V, believe, hovering, modes, standing, texts, when

pytestmark = pytest.mark.catalogue

CRITICAL = 2
GOOD = 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512
NO_POSITION = 1 | 4 | 32 | 128  # CONST_POS_MODE
GLITCHING = 1 << 15


def late(**params: float) -> Range:
    """Hovering, more than 30 s after boot: earlier, "EKF variance" is not said."""
    r = hovering(**params)
    r.run(31.0 - r.seconds)
    return r


def test_bad_ratios_for_a_second_land_it_without_a_position() -> None:
    r = late()
    start = r.seconds
    believe(r, vel_ratio=0.9, pos_ratio=0.9)
    r.run(1.3)
    assert texts(r, start) == [
        (CRITICAL, "EKF variance"),
        (CRITICAL, "EKF Failsafe: changed to LAND Mode"),
    ]
    assert modes(r, start) == [("LAND", "ekf_failsafe")]
    assert when(r, "EKF variance") - start == pytest.approx(1.1, abs=0.15)  # 10 checks; the filter takes one more
    assert r.engines[0]._fleet.flight["land_nogps"][0] == 1
    r.run(8.0)
    assert r.positions()[0, 2] < 9.8  # coming down
    back = r.seconds
    believe(r, vel_ratio=0.0, pos_ratio=0.0)
    r.run(1.5)
    assert texts(r, back) == [(CRITICAL, "EKF Failsafe Cleared")]
    assert modes(r, back) == []
    assert r.mode(V, Mode.GUIDED) == 0


@pytest.mark.parametrize(
    ("ratios", "trips"),
    [
        ({"vel_ratio": 0.9}, False),
        ({"pos_ratio": 5.0}, False),
        ({"mag_ratio": 5.0}, False),
        ({"vel_ratio": 1.7}, True),  # twice the threshold
        ({"vel_ratio": 0.9, "mag_ratio": 0.9}, True),
        ({"pos_ratio": 0.9, "mag_ratio": 0.9}, True),
        ({"vel_ratio": 0.75, "pos_ratio": 0.75, "mag_ratio": 0.75}, False),
    ],
)
def test_which_ratios_count(ratios: dict[str, float], trips: bool) -> None:
    r = late()
    start = r.seconds
    believe(r, **ratios)
    r.run(2.0)
    assert bool(modes(r, start)) == trips


def test_losing_the_position_does_the_same() -> None:
    r = late()
    start = r.seconds
    believe(r, status=NO_POSITION)
    r.run(1.3)
    assert modes(r, start) == [("LAND", "ekf_failsafe")]
    assert when(r, "EKF variance") - start == pytest.approx(1.0, abs=0.15)
    assert r.mode(V, Mode.RTL) == 4
    assert "Mode change to RTL failed: requires position" in r.words()


def test_a_short_fault_is_counted_down_again() -> None:
    r = late()
    start = r.seconds
    for _ in range(5):
        believe(r, status=NO_POSITION)
        r.run(0.8)
        believe(r, status=GOOD)
        r.run(0.8)
    assert texts(r, start) == []


def test_the_text_comes_at_most_every_30_s_and_not_right_after_boot() -> None:
    r = hovering()
    assert r.seconds < 25
    start = r.seconds
    believe(r, status=NO_POSITION)
    r.run(1.3)
    assert texts(r, start) == [(CRITICAL, "EKF Failsafe: changed to LAND Mode")]


@pytest.mark.parametrize(("params", "expected"), [({"FS_EKF_ACTION": 0}, True), ({"FS_EKF_THRESH": 0}, False)])
def test_report_only_and_off(params: dict[str, float], expected: bool) -> None:
    r = late(**params)
    start = r.seconds
    believe(r, vel_ratio=3.0, mag_ratio=3.0)
    r.run(2.0)
    assert modes(r, start) == []
    assert ((CRITICAL, "EKF Failsafe") in texts(r, start)) == expected


def test_altitude_hold_where_there_is_such_a_mode() -> None:
    r = late(FS_EKF_ACTION=2)
    start = r.seconds
    believe(r, status=NO_POSITION)
    r.run(1.3)
    expected = "ALT_HOLD" if mode_of(2) else "LAND"
    assert modes(r, start) == [(expected, "ekf_failsafe")]
    assert texts(r, start)[-1] == (CRITICAL, f"EKF Failsafe: changed to {expected} Mode")


def test_in_land_it_goes_on_blind() -> None:
    r = late(LAND_SPEED=30)
    assert r.mode(V, Mode.LAND) == 0
    start = r.seconds
    believe(r, status=NO_POSITION)
    r.run(1.3)
    assert texts(r, start)[-1] == (CRITICAL, "EKF Failsafe")
    assert modes(r, start) == []
    assert r.engines[0]._fleet.flight["land_nogps"][0] == 1


def test_a_blind_landing_keeps_level_drifts_and_arrives() -> None:
    r = Range(late().specs, wind_enu_mps=(2.0, 0.0, 0.0))
    r.take_off(V, 10.0)
    start = r.positions()[0].copy()
    believe(r, status=NO_POSITION)
    r.run_until(r.has("event.disarmed"), 60.0)
    assert r.events("event.disarmed")[0].data["reason"] == "landed"
    assert r.positions()[0, 0] - start[0] > 5.0  # with the wind


def test_an_estimator_that_never_worked_raises_nothing() -> None:
    r = standing()
    believe(r, status=1)
    r.run(5.0)
    assert texts(r) == []


def test_disarmed_it_warns_and_forbids_arming() -> None:
    r = standing()
    r.run(31.0)
    start = r.seconds
    believe(r, status=1 | 4 | 32)
    r.run(4.0)
    assert (CRITICAL, "EKF variance") in texts(r, start)
    r.mode(V, Mode.GUIDED)
    assert r.arm(V) == 4
    assert (CRITICAL, "Arm: Need Position Estimate") in texts(r, start)


def test_glitch_texts() -> None:
    r = hovering()
    start = r.seconds
    believe(r, status=GOOD | GLITCHING)
    r.run(0.5)
    believe(r, status=GOOD)
    r.run(0.5)
    assert texts(r, start) == [(CRITICAL, "GPS Glitch or Compass error"), (CRITICAL, "Glitch cleared")]
    assert modes(r, start) == []


def test_dead_reckoning_returns_at_once_and_stops_being_a_position_after_its_time_out() -> None:
    r = late(FS_DR_TIMEOUT=5)
    start = r.seconds
    believe(r, dead_reckoning=1, status=GOOD & ~16)
    r.run(0.3)
    assert texts(r, start) == [(CRITICAL, "Dead Reckoning started")]
    assert modes(r, start) == [("RTL", "deadreckon_failsafe")]
    r.run(4.5)
    assert modes(r, start) == [("RTL", "deadreckon_failsafe")]
    r.run(2.0)
    assert when(r, "Dead Reckoning timeout") - start == pytest.approx(5.1, abs=0.15)
    assert modes(r, start)[1:] == [("LAND", "ekf_failsafe")]
    back = r.seconds
    believe(r, dead_reckoning=0, status=GOOD)
    r.run(1.5)
    assert texts(r, back) == [(CRITICAL, "Dead Reckoning stopped"), (CRITICAL, "EKF Failsafe Cleared")]


def test_dead_reckoning_may_be_only_told() -> None:
    r = hovering(FS_DR_ENABLE=0)
    start = r.seconds
    believe(r, dead_reckoning=1)
    r.run(1.0)
    assert texts(r, start) == [(CRITICAL, "Dead Reckoning started")]
    assert modes(r, start) == []


def test_dead_reckoning_leaves_a_landing_alone() -> None:
    r = hovering()
    r.mode(V, Mode.LAND)
    start = r.seconds
    believe(r, dead_reckoning=1)
    r.run(1.0)
    assert modes(r, start) == []
