"""References move within their limits and end where they should."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.vehicle.builtin.control import shaping
from skyrange.vehicle.builtin.guidance import reference, wpnav
from skyrange.vehicle.builtin.layout import ESTIMATE, FLIGHT, LEGS, ControlMode, FlightEvent, new_records
from skyrange.vehicle.builtin.parameters.table import SETTINGS, fill_settings
from skyrange.world.airframes import IRIS

DT = 0.01


def test_sqrt_controller_is_linear_then_a_root() -> None:
    p, limit = 2.0, 3.0
    assert shaping.sqrt_controller(0.1, p, limit, 0.01) == pytest.approx(0.2)
    far = 10.0
    assert shaping.sqrt_controller(far, p, limit, 0.01) == pytest.approx(math.sqrt(2 * limit * (far - limit / 8)))
    assert shaping.sqrt_controller(-far, p, limit, 0.01) == -shaping.sqrt_controller(far, p, limit, 0.01)
    # one step may close the error but not overshoot it
    assert shaping.sqrt_controller(1e-3, 500.0, 1e9, 0.01) == pytest.approx(0.1)


@pytest.mark.parametrize("speed", [0.3, 3.0, -12.0])
def test_stopping_distance_is_the_inverse(speed: float) -> None:
    distance = shaping.stopping_distance(speed, 1.0, 2.5)
    assert shaping.sqrt_controller(distance, 1.0, 2.5, 1e-9) == pytest.approx(speed)


def rows(**limits: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    estimate, flight, legs = new_records(ESTIMATE, 1), new_records(FLIGHT, 1), new_records(LEGS, 1)
    settings = np.zeros(1, SETTINGS)
    fill_settings(settings, 0, "v", IRIS, 1, {})
    standard = {"speed_xy": 10.0, "speed_up": 2.5, "speed_down": 1.5, "accel_xy": 2.5, "accel_z": 1.0}
    for name, value in {**standard, "throttle": 0.4, **limits}.items():
        flight[name] = value
    return estimate, flight, legs, settings


def fly(table: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], seconds: float) -> np.ndarray:
    estimate, flight, legs, settings = table
    path = []
    for _ in range(round(seconds / DT)):
        estimate["pos"], estimate["vel"] = flight["ref_pos"], flight["ref_vel"]  # an aircraft that keeps up
        reference.update_reference(estimate[0], flight[0], legs[0], settings[0], DT)
        path.append(np.concatenate([flight["ref_pos"][0], flight["ref_vel"][0], flight["ref_acc"][0]]))
    return np.array(path)


def go(table: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], goal: tuple[float, float, float]) -> None:
    wpnav.start_leg(*table, 0, np.array(goal), True)


def test_leg_ends_at_rest_at_its_goal_within_limits() -> None:
    table = rows(speed_xy=6.0)
    go(table, (30.0, 40.0, 0.0))
    path = fly(table, 30.0)
    assert path[-1] == pytest.approx([30.0, 40.0, 0, 0, 0, 0, 0, 0, 0], abs=1e-6)
    assert np.hypot(path[:, 3], path[:, 4]).max() == pytest.approx(6.0, abs=1e-6)
    assert np.hypot(path[:, 6], path[:, 7]).max() <= 2.5 + 1e-6
    assert np.abs(path[:, 0] * 40 - path[:, 1] * 30).max() / 50 < 1e-9  # on the straight line


def test_a_leg_in_flight_starts_where_the_aircraft_comes_to_rest() -> None:
    table = rows()
    estimate, flight = table[:2]
    estimate["vel"] = (4.0, 0.0, 0.0)
    go(table, (0.0, 50.0, 0.0))
    # PSC_POSXY_P 1 and 2.5 m/s²: 0.5 · 2.5 + 4²/(2 · 2.5) = 4.45 m
    assert flight["ref_pos"][0] == pytest.approx([4.45, 0.0, 0.0])
    assert table[2]["origin"][0] == pytest.approx([4.45, 0.0, 0.0])


@pytest.mark.parametrize("goal", [(40.0, 0.0, 0.0), (20.0, -30.0, 15.0), (0.0, 0.0, -8.0), (0.02, 0.0, 0.0)])
def test_a_position_is_approached_within_limits_and_without_overshoot(goal: tuple[float, float, float]) -> None:
    table = rows()
    table[1]["control"] = ControlMode.POSITION
    table[1]["target_pos"] = goal
    path = fly(table, 40.0)
    assert path[-1, :3] == pytest.approx(goal, abs=0.02)
    assert np.hypot(path[:, 3], path[:, 4]).max() <= 10.0
    assert path[:, 5].max() <= 2.5 + 1e-6
    assert path[:, 5].min() >= -1.5 - 1e-6
    assert np.abs(np.diff(path[:, 6:8], axis=0)).max() <= 5.0 * DT + 1e-9  # PSC_JERK_XY
    far = np.linalg.norm(np.array(goal))
    assert np.linalg.norm(path[:, :3], axis=1).max() <= far * 1.02 + 0.05


def test_velocity_and_acceleration_targets_are_followed() -> None:
    table = rows()
    table[1]["control"] = ControlMode.VELOCITY
    table[1]["target_vel"] = (3.0, -2.0, 1.0)
    assert fly(table, 6.0)[-1, 3:6] == pytest.approx([3.0, -2.0, 1.0], abs=0.02)
    table = rows()
    table[1]["control"] = ControlMode.ACCEL
    table[1]["target_acc"] = (1.0, 0.0, 0.5)
    path = fly(table, 3.0)
    assert path[-1, 6:] == pytest.approx([1.0, 0.0, 0.5])
    assert path[-1, 3:6] == pytest.approx([2.9, 0.0, 1.475], abs=0.02)  # 0.2 s and 0.1 s to build up at 5 m/s³


def test_a_circle_turns_at_its_rate_where_the_acceleration_allows() -> None:
    table = rows()
    flight = table[1]
    flight["control"] = ControlMode.CIRCLE
    flight["circle_radius"], flight["circle_rate"] = 10.0, math.radians(20.0)
    flight["ref_pos"] = (10.0, 0.0, 5.0)
    path = fly(table, 36.0)
    # half of 2.5 m/s² at 10 m: √(0.5 · 2.5 · 10) = 3.54 m/s, 20.3 °/s: 20 °/s fits
    # two turns, less the time to get going
    assert math.degrees(float(flight["circle_angle_total"][0])) == pytest.approx(
        720.0, abs=50.0
    )  # less the time to get going
    assert np.hypot(path[500:, 0], path[500:, 1]) == pytest.approx(10.0, abs=1.5)
    assert path[300, 1] < 0.0  # clockwise from the east: south first
    assert np.ptp(path[:, 2]) < 1e-9


def test_the_reference_waits_for_an_aircraft_that_cannot_follow() -> None:
    table = rows(speed_xy=8.0)
    estimate, flight, legs, settings = table
    go(table, (400.0, 0.0, 0.0))
    for _ in range(6_000):  # a minute in which the aircraft makes 3 m/s good
        estimate["pos"][0, 0] += 3.0 * DT
        estimate["vel"][0, 0] = 3.0
        reference.update_reference(estimate[0], flight[0], legs[0], settings[0], DT)
    ahead_m = float(flight["ref_pos"][0, 0] - estimate["pos"][0, 0])
    # where 0.05 + (3 - PSC_POSXY_P * ahead) / 8 lets the reference advance at 3 m/s too: 0.4 m
    assert 0.0 < ahead_m < 1.5
    assert not flight["flags"][0] & FlightEvent.DESTINATION_REACHED
