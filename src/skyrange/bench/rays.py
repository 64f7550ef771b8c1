"""Benchmark of ray casting: scans of rotating LiDARs on aircraft over a city, with the other aircraft in it.

Ten sensors have 16 beams from -15 to 15 degrees and 720 azimuths, and their aircraft move during the scan. Rays reach
100 m.
"""

from __future__ import annotations

import math
import time
from hashlib import sha256
from typing import Any, Final

import numpy as np

from skyrange.bench.yardstick import yardstick_us
from skyrange.city.city import City
from skyrange.core import elementary_python, elementwise
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.ids import hash64
from skyrange.optics.ray_casting import AIRCRAFT, BUILDING, GROUND, NONE, Hits, Rays, cast_rays, make_rays
from skyrange.optics.ray_index import RayIndex, build_ray_index
from skyrange.optics.targets import Targets, place_targets
from skyrange.world.airframes import IRIS

BEAMS: Final = 16
AZIMUTHS: Final = 720
SCAN_S: Final = 0.1
REACH_M: Final = 100.0
SENSORS: Final = 10
_LOWEST_M, _HIGHEST_M = 5.0, 60.0
_SPEED_MPS: Final = 10.0
_STREAM: Final = "bench.rays"
_MOST_TRIES: Final = 100


def measure(city: City, scene: str, aircraft: int, scans: int) -> dict[str, Any]:
    """Cast the rays of `scans` scans of ten sensors over a city with `aircraft` of the Iris's outline.

    `rays_per_s` are per second of processor time; the best of three rounds, because other programs use the machine.
    `real_time_factor` is how much faster than real time ten such sensors at 10 Hz are. `met` are the shares of
    rays that meet nothing, the ground, a building and an aircraft. `digest` is that of all results, the same for the
    same scene on every machine. Raises `InputError` for a city without space for the aircraft.
    """
    if aircraft < SENSORS:
        raise InputError.one("bench rays", "--aircraft", str(aircraft), f"{SENSORS} or more: they carry the sensors")
    began = time.process_time()
    index = build_ray_index(city.walls())
    build_s = time.process_time() - began
    targets = _place_aircraft(city, index, aircraft)
    scanned = [_scan(targets, k) for k in range(SENSORS)]
    results = [cast_rays(index, rays, REACH_M, targets) for rays in scanned]  # compiled before the measurement
    best_s = math.inf
    for _ in range(3):
        began = time.process_time()
        for _ in range(scans):
            for rays in scanned:
                cast_rays(index, rays, REACH_M, targets)
        best_s = min(best_s, time.process_time() - began)
    kinds = np.bincount(np.concatenate([hits.kind for hits in results]), minlength=4) / (SENSORS * BEAMS * AZIMUTHS)
    rays_per_s = scans * SENSORS * BEAMS * AZIMUTHS / best_s
    names = {"nothing": NONE, "ground": GROUND, "building": BUILDING, "aircraft": AIRCRAFT}
    return {
        "scene": scene,
        "buildings": len(city),
        "walls": len(city.walls().edges),
        "aircraft": aircraft,
        "rays": scans * SENSORS * BEAMS * AZIMUTHS,
        "rays_per_s": round(rays_per_s),
        "real_time_factor": round(rays_per_s * SCAN_S / (SENSORS * BEAMS * AZIMUTHS), 1),
        "build_ms": round(build_s * 1e3, 2),
        "met": {name: round(float(kinds[kind]), 5) for name, kind in names.items()},
        "digest": _digest(results),
        "yardstick_us": round(yardstick_us(), 2),
    }


def list_scans(city: City) -> list[Rays]:
    """The rays of ten sensors over a city, one scan each: what the benchmark casts with ten aircraft."""
    targets = _place_aircraft(city, build_ray_index(city.walls()), SENSORS)
    return [_scan(targets, k) for k in range(SENSORS)]


def _place_aircraft(city: City, index: RayIndex, count: int) -> Targets:
    """Aircraft at random places that are 2 m from any building, in level flight."""
    chance = Chance(1)
    west, south, east, north = city.bounds
    places: list[tuple[float, float, float]] = []
    courses: list[float] = []
    tried = 0
    while len(places) < count and tried < _MOST_TRIES * count:
        across, along, up, turn = chance.uniform4(_STREAM, hash64("aircraft"), tried)
        tried += 1
        place = (
            west + across * (east - west),
            south + along * (north - south),
            _LOWEST_M + up * (_HIGHEST_M - _LOWEST_M),
        )
        if city.is_clear([place], 2.0):
            places.append(place)
            courses.append(2.0 * math.pi * turn)
    if len(places) < count:
        raise InputError.one("bench rays", "city", f"space for {len(places)} aircraft", f"space for {count}")
    level = [
        (_SPEED_MPS * elementary_python.sin(course), _SPEED_MPS * elementary_python.cos(course), 0.0)
        for course in courses
    ]
    outline = np.full(count, IRIS.radius_m), np.full(count, IRIS.height_m)
    return place_targets(index, np.array(places), np.array(level), *outline, during_s=SCAN_S)


def _scan(targets: Targets, k: int) -> Rays:
    """The rays of one scan from above aircraft `k`, in the order in which a rotating sensor fires them."""
    azimuth = np.repeat(2.0 * math.pi * np.arange(AZIMUTHS) / AZIMUTHS, BEAMS)
    elevation = np.tile(math.pi / 180.0 * (2.0 * np.arange(BEAMS) - 15.0), AZIMUTHS)
    level = elementwise.cos(elevation)
    direction = np.column_stack(
        [level * elementwise.sin(azimuth), level * elementwise.cos(azimuth), elementwise.sin(elevation)]
    )
    delay_s = SCAN_S * np.arange(len(direction)) / len(direction)
    origin = targets.position[k] + (0.0, 0.0, IRIS.height_m) + delay_s[:, None] * targets.velocity[k]
    return make_rays(origin, direction, delay_s, k)


def _digest(results: list[Hits]) -> str:
    digest = sha256()
    for hits in results:
        for values in hits:
            digest.update(values.tobytes())
    return digest.hexdigest()[:16]
