"""What returns of the map say of the air: the true extinction is hardly ever contradicted, and thicker air is."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from skyrange.city.buildings import Building
from skyrange.city.wall_index import build_wall_index
from skyrange.codec.range_scans import LIDAR, RangeScan
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.optics.extinction import Weather, find_extinction
from skyrange.optics.mounted_sensors import MountedSensor
from skyrange.optics.ray_casting import cast_rays
from skyrange.optics.ray_index import RayIndex, build_ray_index
from skyrange.optics.reflectivity import Surfaces
from skyrange.optics.returns import Address, find_returns
from skyrange.optics.scan_patterns import ScatteredPattern
from skyrange.optics.sensor_models import D435, HAP
from skyrange.optics.sensor_poses import SensorPose, make_pulse_rays, sample_footprint
from skyrange.vehicle.sight.air import BRIGHTEST, CLEAR, EXTINCTIONS, AirEstimate
from skyrange.vehicle.sight.beams import Beams, SensorView

HERE = np.array([0.0, 0.0, 30.0])
LEVEL = (1.0, 0.0, 0.0, 0.0)
PATTERN = ScatteredPattern(rays=1_500, azimuth_deg=(-10.0, 10.0), elevation_deg=(-12.5, 12.5), rate_hz=10.0)
MODEL = replace(HAP, pattern=PATTERN)
SENSOR = MountedSensor("blue/b1", "hap", 0, MODEL, (0.0, 0.0, 0.2))
VIEW = SensorView(SENSOR, 0)
PERIOD_NS = 100 * NS_PER_MS
MISSED = 0.01


@cache
def wall(away_m: float) -> RayIndex:
    """A wall across the view, 40 m high."""
    return build_ray_index(build_wall_index([Building("w", 40.0, shapely.box(away_m, -60.0, away_m + 10.0, 60.0))]))


def see(number: int, seed: int, city: RayIndex, weather: Weather, reflectivity: float) -> Beams:
    """The beams of a scan over surfaces of one reflectivity."""
    firing = SENSOR.list_rays(number)
    pose = SensorPose(HERE, np.zeros(3), np.array(LEVEL), np.zeros(3), np.array(SENSOR.place_m))
    rays = make_pulse_rays(firing, pose, sample_footprint(MODEL, 1, 1))
    surfaces = Surfaces(reflectivity, np.array([reflectivity]), np.array([0.1]))
    address = Address(Chance(seed), 9, number * PERIOD_NS)
    returns = find_returns(MODEL, firing, cast_rays(city, rays, MODEL.reach_m), surfaces, weather, address)
    scan = RangeScan(LIDAR, 0, number, MODEL.resolution_m, number * PERIOD_NS, LEVEL, returns.steps)
    return VIEW.place_beams(scan, HERE, np.zeros(3), number * PERIOD_NS)


def estimate(seed: int, city: RayIndex, weather: Weather, reflectivity: float, scans: int = 12) -> AirEstimate:
    air = AirEstimate(EXTINCTIONS, MISSED)
    for number in range(scans):
        air.update(number * PERIOD_NS, VIEW, see(number, seed, city, weather, reflectivity), city)
    return air


def thickest(air: AirEstimate) -> float:
    return EXTINCTIONS[air.count_allowed() - 1]


@given(
    seed=st.integers(0, 2**32),
    away_m=st.sampled_from([15.0, 40.0, 80.0, 130.0]),
    visibility_m=st.floats(20.0, 5_000.0),
    reflectivity=st.floats(0.02, BRIGHTEST),
)
def test_the_true_extinction_is_not_contradicted(
    seed: int, away_m: float, visibility_m: float, reflectivity: float
) -> None:
    """Below the least extinction of the list that is at least the true one, nothing is excluded."""
    weather = Weather(visibility_m=visibility_m)
    true = find_extinction(weather, MODEL.wavelength_um)
    assert thickest(estimate(seed, wall(away_m), weather, reflectivity)) >= max(e for e in EXTINCTIONS if e <= true)


def test_of_the_brightest_surfaces_at_most_the_allowed_share_is_contradicted() -> None:
    """The extinction is one of the list, and the surface as bright as assumed: the hardest case."""
    true = EXTINCTIONS[7]
    low, high = 10.0, 10_000.0
    for _ in range(60):  # the visibility with this extinction
        middle = 0.5 * (low + high)
        is_thicker = find_extinction(Weather(visibility_m=middle), MODEL.wavelength_um) > true
        low, high = (middle, high) if is_thicker else (low, middle)
    weather = Weather(visibility_m=low)
    wrong = sum(thickest(estimate(seed, wall(130.0), weather, BRIGHTEST, scans=2)) < true for seed in range(100))
    assert wrong <= 4


def test_far_walls_contradict_more_fog_than_near_ones() -> None:
    allowed = [thickest(estimate(1, wall(away_m), Weather(), 0.24)) for away_m in (130.0, 80.0, 40.0, 15.0)]
    assert allowed == sorted(allowed)
    assert len(set(allowed)) == 4
    assert 0.0 < allowed[0] < 0.02


def test_nothing_in_view_contradicts_nothing() -> None:
    """Of an aircraft 300 m high."""
    air = AirEstimate(EXTINCTIONS, MISSED)
    for number in range(20):
        beams = see(number, 1, build_ray_index(), Weather(), 0.24)
        high = beams._replace(origin=beams.origin + np.array([0.0, 0.0, 300.0]), distance_m=0.0 * beams.distance_m)
        air.update(number * PERIOD_NS, VIEW, high, build_ray_index())
    assert thickest(air) == math.inf


def test_a_sensor_that_goes_blind_is_noticed_within_four_seconds() -> None:
    city = wall(40.0)
    air = estimate(1, city, Weather(), 0.24)
    assert thickest(air) < math.inf
    beams = see(0, 1, city, Weather(), 0.24)
    for number in range(12, 61):
        air.update(number * PERIOD_NS, VIEW, beams._replace(distance_m=0.0 * beams.distance_m), city)
    assert thickest(air) == math.inf


def test_what_hides_the_map_is_not_taken_for_fog_nor_for_the_map() -> None:
    """Everything returns at 20 m; the map has a wall at 40 m."""
    air = AirEstimate(EXTINCTIONS, MISSED)
    for number in range(12):
        beams = see(number, 1, wall(20.0), Weather(), 0.24)
        air.update(number * PERIOD_NS, VIEW, beams, wall(40.0))
    assert thickest(air) == math.inf
    before = deepcopy(air)
    air.update(13 * PERIOD_NS, VIEW, see(13, 1, wall(40.0), Weather(), 0.24), wall(40.0))
    assert thickest(air) < math.inf
    assert thickest(before) == math.inf


@pytest.mark.parametrize("extinctions", [CLEAR, EXTINCTIONS])
def test_clear_air_is_always_possible(extinctions: tuple[float, ...]) -> None:
    air = AirEstimate(extinctions, MISSED)
    assert air.count_allowed() == len(extinctions)
    for number in range(12):
        air.update(number * PERIOD_NS, VIEW, see(number, 1, wall(80.0), Weather(), BRIGHTEST), wall(80.0))
    assert air.count_allowed() >= 1


def test_depth_cameras_contradict_nothing() -> None:
    air = AirEstimate(EXTINCTIONS, MISSED)
    camera = SensorView(MountedSensor("blue/b1", "d435", 0, D435, (0.1, 0.0, 0.0)), NS_PER_S)
    count = D435.pattern.width * D435.pattern.height
    beams = Beams(HERE, np.tile([1.0, 0.0, 0.0], (count, 1)), np.full(count, 8.0))
    air.update(0, camera, beams, wall(8.0))
    assert air.count_allowed() == len(EXTINCTIONS)
