"""References move within their limits and end where they should (closed forms, and integration of the derivative)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.vehicle.builtin import guidance, shaping
from skyrange.vehicle.builtin.layout import ESTIMATE, FLIGHT, zeros
from skyrange.vehicle.builtin.parameters import SETTINGS, fill
from skyrange.world.airframes import IRIS


def test_sqrt_controller_is_linear_then_a_root() -> None:
    p, limit = 2.0, 3.0
    assert shaping.sqrt_controller(0.1, p, limit, 0.01) == pytest.approx(0.2)
    far = 10.0
    assert shaping.sqrt_controller(far, p, limit, 0.01) == pytest.approx(math.sqrt(2 * limit * (far - limit / 8)))
    assert shaping.sqrt_controller(-far, p, limit, 0.01) == -shaping.sqrt_controller(far, p, limit, 0.01)
    # one step may close the error but not overshoot it
    assert shaping.sqrt_controller(1e-3, 500.0, 1e9, 0.01) == pytest.approx(0.1)


@pytest.mark.parametrize(("v0", "v1"), [(0.0, 5.0), (5.0, 0.0), (1.0, 1.5), (4.0, 3.9), (2.0, 2.0)])
def test_ramp_is_consistent_and_limited(v0: float, v1: float) -> None:
    accel, jerk = 2.5, 1.0
    total = shaping.ramp_time(v0, v1, accel, jerk)
    times = np.linspace(0.0, total, 4001)
    rows = np.array([shaping.ramp_at(t, v0, v1, accel, jerk) for t in times])
    assert rows[0] == pytest.approx([0.0, v0, 0.0], abs=1e-9)
    assert rows[-1] == pytest.approx([0.5 * (v0 + v1) * total, v1, 0.0], abs=1e-9)
    assert np.abs(rows[:, 2]).max() <= accel + 1e-9
    if total > 0.0:
        step = times[1]
        assert np.abs(np.diff(rows[:, 2]) / step).max() <= jerk + 1e-6
        # each column is the integral of the next (trapezoid rule on 4000 steps: 1e-6 relative to seconds and metres)
        for column in (0, 1):
            slope = 0.5 * (rows[1:, column + 1] + rows[:-1, column + 1]) * step
            assert np.diff(rows[:, column]) == pytest.approx(slope, abs=1e-6)


@pytest.mark.parametrize("distance", [0.01, 1.0, 20.0, 500.0])
def test_peak_speed_just_fits(distance: float) -> None:
    peak = shaping.peak_speed(distance, 0.0, 10.0, 2.5, 1.0)
    needed = peak * shaping.ramp_time(0.0, peak, 2.5, 1.0)
    assert peak == 10.0 or needed == pytest.approx(distance, rel=1e-9)
    assert needed <= distance * (1 + 1e-9)


def _row(**limits: float) -> tuple[object, object, np.ndarray, np.ndarray]:
    flight, settings = zeros(FLIGHT, 1), np.zeros(1, dtype=SETTINGS)
    fill(settings, 0, "v", IRIS, 1, {})
    for name, value in {
        "speed_xy": 10.0,
        "speed_up": 2.5,
        "speed_down": 1.5,
        "accel_xy": 2.5,
        "accel_z": 1.0,
        **limits,
    }.items():
        flight[name] = value
    return flight[0], settings[0], flight, settings


def _fly(flight: np.ndarray, settings: np.ndarray, seconds: float) -> np.ndarray:
    estimate = zeros(ESTIMATE, 1)
    path = []
    for _ in range(round(seconds / 0.0025)):
        estimate["pos"] = flight["ref_pos"]  # an aircraft that keeps up
        estimate["vel"] = flight["ref_vel"]
        guidance.guide(estimate[0], flight[0], settings[0], 0.0025)
        path.append(np.concatenate([flight["ref_pos"][0], flight["ref_vel"][0], flight["ref_acc"][0]]))
    return np.array(path)


def test_leg_ends_at_rest_at_its_goal_within_limits() -> None:
    f, p, flight, settings = _row(speed_xy=6.0)
    guidance.begin_leg(f, p, 30.0, 40.0, 0.0, False, False)
    path = _fly(flight, settings, 30.0)
    assert path[-1] == pytest.approx([30.0, 40.0, 0, 0, 0, 0, 0, 0, 0], abs=1e-6)
    assert np.hypot(path[:, 3], path[:, 4]).max() == pytest.approx(6.0, abs=1e-6)
    assert np.hypot(path[:, 6], path[:, 7]).max() <= 2.5 + 1e-6
    assert np.abs(path[:, 0] * 40 - path[:, 1] * 30).max() / 50 < 1e-9  # on the straight line


def test_climbing_leg_is_slowed_to_the_climb_rate() -> None:
    f, p, flight, settings = _row()
    guidance.begin_leg(f, p, 10.0, 0.0, 50.0, False, False)
    path = _fly(flight, settings, 40.0)
    assert path[:, 5].max() == pytest.approx(2.5, abs=1e-6)
    assert np.abs(path[:, 8]).max() <= 1.0 + 1e-6


def test_new_leg_in_flight_starts_without_a_jump() -> None:
    f, p, flight, settings = _row()
    guidance.begin_leg(f, p, 100.0, 0.0, 0.0, False, False)
    before = _fly(flight, settings, 6.0)[-1]
    guidance.begin_leg(f, p, 0.0, 50.0, 0.0, False, False)
    after = _fly(flight, settings, 40.0)
    assert after[0, :6] == pytest.approx(before[:6], abs=0.05)  # 2.5 ms at up to 10 m/s, 5 m/s³
    assert after[-1, :3] == pytest.approx([0.0, 50.0, 0.0], abs=1e-6)


def test_corner_passes_within_the_radius_without_stopping() -> None:
    f, p, flight, settings = _row(speed_xy=5.0)
    guidance.begin_leg(f, p, 20.0, 0.0, 0.0, True, False)
    first = _fly(flight, settings, 1.0)
    while not flight["flags"][0] & 4:
        first = np.vstack([first, _fly(flight, settings, 0.0025)])
    guidance.begin_leg(f, p, 20.0, 20.0, 0.0, False, True)
    second = _fly(flight, settings, 20.0)
    path = np.vstack([first, second])
    miss = np.hypot(path[:, 0] - 20.0, path[:, 1]).min()
    assert miss < 1.0
    assert np.hypot(second[:800, 3], second[:800, 4]).min() > 0.5
    assert np.abs(np.diff(path[:, 3:5], axis=0)).max() <= 2.5 * 0.0025 * 2 + 1e-9
    assert second[-1, :2] == pytest.approx([20.0, 20.0], abs=1e-6)


def test_speed_change_in_the_cruise_is_taken_up_and_the_leg_still_ends_there() -> None:
    f, p, flight, settings = _row(speed_xy=4.0)
    guidance.begin_leg(f, p, 200.0, 0.0, 0.0, False, False)
    _fly(flight, settings, 10.0)
    flight["speed_xy"] = 8.0
    flight["replan"] = 1
    path = _fly(flight, settings, 40.0)
    assert path[:, 3].max() == pytest.approx(8.0, abs=1e-6)
    assert path[-1, 0] == pytest.approx(200.0, abs=1e-6)


def test_the_reference_waits_for_an_aircraft_that_cannot_follow() -> None:
    f, p, flight, settings = _row(speed_xy=8.0)
    guidance.begin_leg(f, p, 400.0, 0.0, 0.0, False, False)
    estimate = zeros(ESTIMATE, 1)
    for _ in range(24_000):  # a minute in which the aircraft makes 3 m/s good
        estimate["pos"][0, 0] += 3.0 * 0.0025
        estimate["vel"][0, 0] = 3.0
        guidance.guide(estimate[0], flight[0], settings[0], 0.0025)
    ahead_m = float(flight["ref_pos"][0, 0] - estimate["pos"][0, 0])
    # where 0.05 + (3 - PSC_POSXY_P * ahead) / 8 lets the reference advance at 3 m/s too: 0.4 m
    assert 0.0 < ahead_m < 1.5
    assert not flight["flags"][0] & 4
