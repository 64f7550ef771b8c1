"""The builtin autopilot and its range sensors: it stops at walls in GUIDED, and does not arm with blind sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import pytest

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters.table import PARAMETERS, count_listed
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range

V = "blue/b1"
WALL_M = 20.0
BOOT: dict[str, float] = {"PRX1_TYPE": 2, "RNGFND1_TYPE": 10, "RNGFND1_MAX_CM": 4000}
SENSORS: dict[str, float] = {"AVOID_ENABLE": 2, "AVOID_MARGIN": 3}
FILTER: dict[str, float] = {"PRX_FILT": 0}
"""Distances as they come, for numbers that do not depend on the filter."""


def made(**params: float) -> Range:
    return Range([VehicleSpec(V, 7, params=params, heading_deg=90.0)])


def obstacles(distances: list[int], at_us: int = 0, **fields: Any) -> Any:
    more = {"increment": 0, "min_distance": 10, "max_distance": 10_000, "increment_f": 5.0, **fields}
    return mav.MAVLink_obstacle_distance_message(at_us, 0, distances, frame=mav.MAV_FRAME_BODY_FRD, **more)


def see_wall(r: Range, yaw: float | None = None) -> None:
    """What a perfect sensor sees of a wall to the east, in the body frame of a given yaw (from north, clockwise)."""
    away = WALL_M - float(r.positions()[0, 0])
    yaw = math.radians(90.0) if yaw is None else yaw
    angles = [math.radians(5.0 * sector) + yaw - math.radians(90.0) for sector in range(72)]
    seen = [round(100.0 * away / math.cos(angle)) if math.cos(angle) > 0.02 else 10_001 for angle in angles]
    r.send(V, obstacles([min(max(distance, 0), 10_001) for distance in seen], r.now // 1000))


def see_all(r: Range) -> None:
    """The same, and the height."""
    see_wall(r)
    up = round(100.0 * max(float(r.positions()[0, 2]), 0.3))
    r.send(V, mav.MAVLink_distance_sensor_message(r.now // 1_000_000, 5, 4000, up, 0, 0, 25, 255))


def push(r: Range, east: float, north: float = 0.0) -> None:
    mask = 0b110111000111
    r.send(V, mav.MAVLink_set_position_target_local_ned_message(0, 7, 1, 1, mask, 0, 0, 0, north, east, *[0] * 6))


@cache
def _lift(params: tuple[tuple[str, float], ...]) -> Range:
    r = made(**dict(params))
    r.run(15.0, lambda r: see_all(r) if r.now % 100_000_000 == 0 else None)
    assert r.mode(V, Mode.GUIDED) == mav.MAV_RESULT_ACCEPTED
    assert r.arm(V) == mav.MAV_RESULT_ACCEPTED
    assert r.command(V, mav.MAV_CMD_NAV_TAKEOFF, *[0.0] * 6, 10.0) == mav.MAV_RESULT_ACCEPTED
    r.run(9.0, lambda r: see_all(r) if r.now % 100_000_000 == 0 else None)
    assert r.positions()[0, 2] > 9.0
    return r


def lifted(boot: Mapping[str, float] = BOOT, /, **params: float) -> Range:
    """In GUIDED, 10 m up: a copy of one flight for all, with parameters that need no boot set in the air."""
    r = _lift(tuple(boot.items())).copy()
    for name, value in params.items():
        r.send(V, mav.MAVLink_param_set_message(7, 1, name.encode(), value, 9))
    r.run(0.05)
    return r


def driven(r: Range, seconds: float, east: float, north: float = 0.0, look: Any = see_wall) -> Range:
    def every(r: Range) -> None:
        if r.now % 100_000_000 == 0:
            look(r)
            push(r, east, north)

    r.run(seconds, every)
    return r


@pytest.mark.parametrize("behave", [0, 1])
def test_a_velocity_towards_a_wall_ends_at_the_margin(behave: int) -> None:
    """The lines between sectors are nearer than the wall by cos 22.5°, so it stops at the margin divided by that."""
    r = driven(lifted(**SENSORS, **FILTER, AVOID_BEHAVE=behave), 12.0, 4.0)
    nearest_m = WALL_M - max(position[0, 0] for _, position in r.track)
    assert nearest_m == pytest.approx(3.0 / math.cos(math.radians(22.5)), abs=0.35)
    assert 3.0 < WALL_M - r.positions()[0, 0] < 4.5


def test_the_default_filter_makes_it_stop_late_and_back_away() -> None:
    r = driven(lifted(**SENSORS), 12.0, 4.0)
    assert 0.0 < WALL_M - max(position[0, 0] for _, position in r.track) < 3.0


@pytest.mark.parametrize("boot", [BOOT, {}])
def test_without_the_sensor_or_its_bit_it_flies_on(boot: dict[str, float]) -> None:
    enabled = 3.0 if not boot else 1.0
    assert driven(lifted(boot, AVOID_ENABLE=enabled), 9.0, 4.0).positions()[0, 0] > WALL_M


def test_positions_are_flown_as_they_are() -> None:
    """ArduCopter avoids in GUIDED only what is commanded as a velocity."""
    r = lifted(**SENSORS, **FILTER)
    r.send(V, mav.MAVLink_set_position_target_local_ned_message(0, 7, 1, 1, 0b110111111000, 0, 30, -10, *[0] * 8))
    r.run(15.0, lambda r: see_wall(r) if r.now % 100_000_000 == 0 else None)
    assert r.positions()[0, 0] > WALL_M


def test_obstacles_are_forgotten_a_second_after_the_last_message() -> None:
    r = driven(lifted(**SENSORS, **FILTER), 15.0, 4.0)
    assert driven(r, 8.0, 4.0, look=lambda _: None).positions()[0, 0] > WALL_M


def test_a_hover_within_the_margin_backs_away() -> None:
    r = lifted(**SENSORS, **FILTER)
    driven(r, 5.0, 0.0, look=lambda r: None)
    start = float(r.positions()[0, 0])

    def behind(r: Range) -> None:
        distance = round(100.0 * (float(r.positions()[0, 0]) - start + 1.5))
        r.send(V, obstacles([distance if 33 <= sector <= 39 else 10_001 for sector in range(72)], r.now // 1000))

    moved = driven(r, 15.0, 0.0, look=behind).positions()[0, 0] - start
    assert 1.0 < moved < 3.0


def test_a_level_distance_sensor_is_an_obstacle_too() -> None:
    def look(r: Range) -> None:
        away = round(100.0 * (WALL_M - float(r.positions()[0, 0])))
        r.send(V, mav.MAVLink_distance_sensor_message(r.now // 1_000_000, 5, 4000, max(away, 5), 0, 0, 0, 255))

    assert driven(lifted(**SENSORS, **FILTER), 15.0, 4.0, look=look).positions()[0, 0] < WALL_M - 2.5


def test_below_the_minimum_height_of_a_rangefinder_obstacles_are_ignored() -> None:
    heights = {"AVOID_ALT_MIN": 6.0, **SENSORS, **FILTER}
    assert driven(lifted(**heights), 9.0, 4.0, look=see_all).positions()[0, 0] < WALL_M
    low = lifted(**heights)
    mask = 0b110111000111
    for _ in range(2):
        down = mav.MAVLink_set_position_target_local_ned_message(0, 7, 1, 1, mask, 0, 0, 0, 0, 0, 1.5, *[0] * 5)
        low.send(V, down)
        low.run(2.5, lambda r: see_all(r) if r.now % 100_000_000 == 0 else None)
    assert low.positions()[0, 2] < 6.0
    assert driven(low, 9.0, 4.0, look=see_all).positions()[0, 0] > WALL_M


def test_silent_sensors_and_near_obstacles_prevent_arming() -> None:
    r = made(**SENSORS, PRX1_TYPE=2, RNGFND1_TYPE=10)
    r.run(15.0)
    assert r.mode(V, Mode.GUIDED) == mav.MAV_RESULT_ACCEPTED
    assert r.arm(V) == mav.MAV_RESULT_FAILED
    assert {"Arm: PRX1: No Data", "Arm: Rangefinder 1: No Data"} <= set(r.words())
    r.send(V, obstacles([50] * 72))
    r.send(V, mav.MAVLink_distance_sensor_message(0, 5, 4000, 4001, 0, 0, 25, 255))
    r.run(0.1)
    assert r.arm(V) == mav.MAV_RESULT_FAILED
    assert "Arm: Proximity 0.50m (want > 0.6m)" in r.words()
    r.send(V, obstacles([500] * 72))
    r.run(0.1)
    assert r.arm(V) == mav.MAV_RESULT_ACCEPTED


def test_parameters_of_sensors_are_listed_where_one_is_set() -> None:
    for params, more in (({}, 0), ({"PRX1_TYPE": 2}, 15), ({"RNGFND1_TYPE": 10}, 15)):
        r = made(**params)
        r.send(V, mav.MAVLink_param_request_list_message(7, 1))
        r.run(0.5)
        assert len(r.heard("PARAM_VALUE")) == len(PARAMETERS) - 15 + more
        assert {m.param_count for m in r.heard("PARAM_VALUE")} == {count_listed(r.engines[0]._fleet.stored_params[0])}


def test_senseless_fields_change_nothing() -> None:
    r = made(**SENSORS, PRX1_TYPE=2)
    for fields in (
        {"increment_f": math.nan},
        {"increment_f": math.inf},
        {"increment_f": 1e-30},
        {"increment_f": 0.0},
        {"angle_offset": math.nan},
        {"increment_f": -400.0},
        {"min_distance": 65535, "max_distance": 0},
    ):
        r.send(V, obstacles([500] * 72, **fields))
        r.run(0.02)
    assert r.seconds > 0.1
