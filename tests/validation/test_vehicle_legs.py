"""Legs, corners and curves against ArduPilot's own code.

The numbers are what libraries/AP_Math/SCurve.cpp and SplineCurve.cpp (commit 2598e9d of the 4.7 development tree)
print when compiled alone and called as below; snap is π·jerk/(4·tc), as AC_WPNav's `calc_scurve_jerk_and_snap` has it.
Tolerances are those of its single floats.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.vehicle.builtin.guidance import scurve, spline, wpnav
from skyrange.vehicle.builtin.layout import ESTIMATE, FLIGHT, LEGS, new_records
from skyrange.vehicle.builtin.parameters.table import SETTINGS, fill_settings
from skyrange.world.airframes import IRIS

DT = 0.01


def leg(length: float, speed: float, accel: float, jerk: float, tc: float) -> np.ndarray:
    c = np.zeros(1, LEGS["this_leg"])
    snap = 0.25 * math.pi * jerk / tc
    scurve.calculate_track(c[0], 0.0, 0.0, 0.0, length, 0.0, 0.0, speed, 2.5, 1.5, accel, 1.0, snap, jerk)
    return c


@pytest.mark.parametrize(
    ("length", "speed", "accel", "jerk", "tc", "duration", "place", "fast", "push"),
    [
        (1.0, 10.0, 2.5, 1.0, 0.15, 3.62936, 0.13305, 0.38355, 0.56178),
        (5.0, 10.0, 2.5, 1.0, 0.15, 5.85975, 0.68006, 1.18224, 1.02195),
        (20.0, 10.0, 2.5, 1.0, 0.15, 9.03688, 2.76231, 3.05073, 1.65738),
        (100.0, 10.0, 2.5, 1.0, 0.15, 16.8, 17.09898, 8.70182, 1.61),
        (300.0, 10.0, 2.5, 1.0, 0.15, 36.8, 76.4, 10.0, 0.0),
        (100.0, 5.0, 1.0, 1.0, 0.15, 26.3, 23.7, 5.0, 0.0),
        (0.05, 10.0, 2.5, 1.0, 0.15, 1.66472, 0.00653, 0.0419, 0.13732),
        (60.0, 5.0, 2.5, 5.0, 0.15, 14.8, 15.2, 5.0, 0.0),
        (40.0, 3.0, 2.5, 20.0, 0.15, 14.92063, 11.04762, 3.0, 0.0),
        (500.0, 15.0, 5.0, 2.0, 0.3, 39.44331, 131.67001, 15.0, 0.0),
    ],
)
def test_a_leg_takes_as_long_and_is_as_far_after_three_tenths(
    length: float, speed: float, accel: float, jerk: float, tc: float,
    duration: float, place: float, fast: float, push: float,
) -> None:  # fmt: skip
    c = leg(length, speed, accel, jerk, tc)
    total = scurve.duration(c[0])
    assert total == pytest.approx(duration, abs=2e-5)
    assert scurve.motion_at(c[0], 0.3 * total) == pytest.approx((place, fast, push), abs=3e-5)


def test_a_climbing_leg_is_slowed_to_the_climb_rate() -> None:
    c = np.zeros(1, LEGS["this_leg"])
    snap = 0.25 * math.pi / 0.15
    scurve.calculate_track(c[0], 0.0, 0.0, 0.0, 30.0, 40.0, 25.0, 10.0, 2.5, 1.5, 2.5, 1.0, snap, 1.0)
    assert scurve.duration(c[0]) == pytest.approx(15.03822, abs=2e-5)


@pytest.mark.parametrize(
    ("speed", "when", "left"), [(8.0, 2.0, 30.3112), (8.0, 12.0, 24.1555), (2.0, 2.0, 98.0), (2.0, 12.0, 80.3109)]
)
def test_a_new_speed_in_flight(speed: float, when: float, left: float) -> None:
    c = leg(200.0, 4.0, 2.5, 1.0, 0.15)
    c["t"] = when
    before = scurve.motion_at(c[0], when)
    scurve.set_speed_max(c[0], speed, 2.5, 1.5)
    assert scurve.duration(c[0]) - when == pytest.approx(left, abs=1e-3)
    assert scurve.motion_at(c[0], when) == pytest.approx(before, abs=1e-6)
    assert scurve.motion_at(c[0], when + left + 1.0)[0] == pytest.approx(200.0, abs=1e-6)


def test_speeds_at_both_ends() -> None:
    c = leg(50.0, 10.0, 2.5, 1.0, 0.15)
    assert scurve.set_origin_speed_max(c[0], 3.0) == 3.0
    scurve.set_destination_speed_max(c[0], 2.0)
    assert scurve.duration(c[0]) == pytest.approx(9.78321, abs=2e-5)


@pytest.mark.parametrize("length", [0.3, 7.0, 90.0, 400.0])
@pytest.mark.parametrize("jerk", [1.0, 6.0])
def test_place_speed_and_acceleration_are_derivatives_of_one_another(length: float, jerk: float) -> None:
    c = leg(length, 9.0, 2.0, jerk, 0.15)
    t = np.linspace(0.0, scurve.duration(c[0]), 20_001)
    rows = np.array([scurve.motion_at(c[0], float(x)) for x in t])
    assert np.abs(rows[:, 2]).max() <= 2.0 + 1e-9
    assert rows[:, 1].max() <= 9.0 + 1e-9
    assert rows[-1] == pytest.approx([length, 0.0, 0.0], abs=1e-6)
    for column in (0, 1):  # trapezoid rule; its error over a step is jerk·dt²/6 and far below
        slope = 0.5 * (rows[1:, column + 1] + rows[:-1, column + 1]) * t[1]
        assert np.diff(rows[:, column]) == pytest.approx(slope, abs=1e-7)
    assert np.abs(np.diff(rows[:, 2])).max() <= jerk * t[1] * (1 + 1e-6)


def rows(**limits: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    estimate, flight, legs = new_records(ESTIMATE, 1), new_records(FLIGHT, 1), new_records(LEGS, 1)
    settings = np.zeros(1, SETTINGS)
    fill_settings(settings, 0, "v", IRIS, 1, {})
    standard = {"speed_xy": 10.0, "speed_up": 2.5, "speed_down": 1.5, "accel_xy": 2.5, "accel_z": 1.0}
    for name, value in {**standard, **limits}.items():
        flight[name] = value
    return estimate, flight, legs, settings


@pytest.mark.parametrize(
    ("speed", "turn", "reached", "miss", "slowest"),
    [
        (5.0, 90.0, 12.600, 2.0101, 2.9483),
        (5.0, 45.0, 12.390, 1.4483, 4.6384),
        (10.0, 90.0, 9.990, 2.0104, 2.9488),
        (10.0, 45.0, 9.520, 2.0119, 5.8041),
    ],
)
def test_a_corner_between_two_legs_of_50_m(
    speed: float, turn: float, reached: float, miss: float, slowest: float
) -> None:
    """When the first waypoint counts as reached, how near the reference comes to it, and how slow it gets.

    Steps of 10 ms, and whichever of two the rounding of a float chooses to begin the turn in: 0.03 s, 2 cm, 3 cm/s.
    """
    estimate, flight, legs, settings = rows(speed_xy=speed)
    away = math.radians(turn)
    second = np.array([50.0 + 50.0 * math.cos(away), 50.0 * math.sin(away), 0.0])
    wpnav.start_leg(estimate, flight, legs, settings, 0, np.array([50.0, 0.0, 0.0]), True)
    wpnav.queue_leg(flight, legs, settings, 0, second)
    at, near, slow, passed = 0.0, math.inf, math.inf, 0.0
    for _ in range(4000):
        estimate["pos"], estimate["vel"] = flight["ref_pos"], flight["ref_vel"]  # an aircraft that keeps up
        wpnav.advance_along_track(estimate[0], flight[0], legs[0], settings[0], DT)
        at += DT
        off = float(np.linalg.norm(flight["ref_pos"][0] - [50.0, 0.0, 0.0]))
        near = min(near, off)
        if at > 5.0 and off < 20.0:
            slow = min(slow, float(np.linalg.norm(flight["ref_vel"][0])))
        if flight["flags"][0] & 4:
            if passed:
                break
            passed = at
            wpnav.start_leg(estimate, flight, legs, settings, 0, second, False)
    assert passed == pytest.approx(reached, abs=0.03)
    assert near == pytest.approx(miss, abs=0.02)
    assert slow == pytest.approx(slowest, abs=0.03)
    assert flight["ref_pos"][0] == pytest.approx(second, abs=1e-3)


def test_a_curve() -> None:
    """5 m/s from rest over a Hermite cubic to (30, 30), leaving north: position after 5 s, duration, end speeds."""
    _, flight, legs, _ = rows(speed_xy=5.0)
    curve = legs["this_spline"]
    spline.set_origin_and_destination(
        curve[0], flight[0], 0.0, 0.0, 0.0, 30.0, 30.0, 0.0, 0.0, 0.0, 0.0, 0.0, 50.0, 0.0
    )
    assert float(curve["from_speed"][0]) == pytest.approx(5.0, abs=1e-3)
    assert float(curve["to_speed"][0]) == pytest.approx(4.167, abs=1e-3)
    steps = 0
    while not curve["reached"][0]:
        spline.advance_target_along_track(curve[0], flight[0], DT)
        steps += 1
        if steps == 500:
            assert flight["ref_pos"][0] == pytest.approx([12.999, 7.351, 0.0], abs=2e-3)
    assert steps * DT == pytest.approx(11.03, abs=0.011)
    assert float(np.linalg.norm(flight["ref_vel"][0])) == pytest.approx(4.167, abs=1e-3)
