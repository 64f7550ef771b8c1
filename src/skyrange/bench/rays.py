"""Benchmark of ray casting: scans of rotating LiDARs on aircraft over a city, with the other aircraft in it.

Ten sensors have 16 beams from -15 to 15 degrees and 720 azimuths, and their aircraft move during the scan. Rays reach
100 m.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from hashlib import sha256
from typing import Any, Final

import numpy as np

from skyrange.bench.yardstick import yardstick_us
from skyrange.city.city import City
from skyrange.core import elementary_python
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.ids import hash64
from skyrange.optics.depth_images import DepthImage, make_depth_image
from skyrange.optics.extinction import Weather
from skyrange.optics.ray_casting import AIRCRAFT, BUILDING, GROUND, NONE, Hits, Rays, cast_rays
from skyrange.optics.ray_index import RayIndex, build_ray_index
from skyrange.optics.reflectivity import make_surfaces
from skyrange.optics.returns import Address, Returns, find_returns
from skyrange.optics.scan_patterns import RotatingPattern
from skyrange.optics.sensor_models import D435, VLP_16
from skyrange.optics.sensor_poses import SensorPose, make_pulse_rays
from skyrange.optics.targets import Targets, place_targets
from skyrange.world.airframes import IRIS

PATTERN: Final = RotatingPattern(tuple(range(-15, 16, 2)), 1.0 / 7200.0, 0.0, 10.0)
SCAN_S: Final = 0.1
REACH_M: Final = 100.0
SENSORS: Final = 10
_LOWEST_M, _HIGHEST_M = 5.0, 60.0
_SPEED_MPS: Final = 10.0
_STREAM: Final = "bench.rays"
_MOST_TRIES: Final = 100
_ROUNDS: Final = 3


def measure(city: City, scene: str, aircraft: int, scans: int) -> dict[str, Any]:
    """Cast the rays of `scans` scans of ten sensors over a city with `aircraft` of the Iris's outline.

    `rays_per_s` are per second of processor time; the best of three rounds, because other programs use the machine.
    `lidar_factor` is how many times as fast as real time ten such sensors at 10 Hz are, with poses, casting and
    returns, and `depth_factor` the same for one depth camera of 320 x 240 pixels at 10 Hz. `met` are the shares of rays
    that meet nothing, the ground, a building and an aircraft. `digest` is that of all results, the same for the same
    scene on every machine. Raises `InputError` for a city without space for the aircraft.
    """
    if aircraft < SENSORS:
        raise InputError.one("bench rays", "--aircraft", str(aircraft), f"{SENSORS} or more: they carry the sensors")
    began = time.process_time()
    index = build_ray_index(city.walls())
    build_s = time.process_time() - began
    targets = _place_aircraft(city, index, aircraft)
    poses = [_find_pose(targets, k) for k in range(SENSORS)]
    firing, image = PATTERN.list_rays(0), D435.pattern.list_rays(0)
    scanned = [make_pulse_rays(firing, pose, own=k) for k, pose in enumerate(poses)]
    surfaces, address = make_surfaces(), Address(Chance(1), hash64(_STREAM), 0)

    def cast() -> list[Hits]:
        return [cast_rays(index, rays, REACH_M, targets) for rays in scanned]

    def scan() -> list[Returns]:
        found = []
        for k, pose in enumerate(poses):
            hits = cast_rays(index, make_pulse_rays(firing, pose, own=k), REACH_M, targets)
            found.append(find_returns(VLP_16, firing, hits, surfaces, Weather(), address))
        return found

    def take_image() -> DepthImage:
        hits = cast_rays(index, make_pulse_rays(image, poses[0], own=0), D435.reach_m, targets)
        return make_depth_image(D435, image, hits, address)

    hits, returns, depth = cast(), scan(), take_image()  # compiled before the measurement
    cast_s, scan_s, image_s = (_time(work, scans) for work in (cast, scan, take_image))
    kinds = np.bincount(np.concatenate([one.kind for one in hits]), minlength=4) / (SENSORS * len(firing.number))
    names = {"nothing": NONE, "ground": GROUND, "building": BUILDING, "aircraft": AIRCRAFT}
    return {
        "scene": scene,
        "buildings": len(city),
        "walls": len(city.walls().edges),
        "aircraft": aircraft,
        "rays": scans * SENSORS * len(firing.number),
        "rays_per_s": round(SENSORS * len(firing.number) / cast_s),
        "lidar_factor": round(SCAN_S / scan_s, 2),
        "depth_factor": round(1.0 / D435.pattern.rate_hz / image_s, 2),
        "build_ms": round(build_s * 1e3, 2),
        "met": {name: round(float(kinds[kind]), 5) for name, kind in names.items()},
        "digest": _digest([*hits, *returns, depth]),
        "yardstick_us": round(yardstick_us(), 2),
    }


def _time(work: Callable[[], object], times: int) -> float:
    """Processor time of one call in seconds, in the best of the rounds."""
    best_s = math.inf
    for _ in range(_ROUNDS):
        began = time.process_time()
        for _ in range(times):
            work()
        best_s = min(best_s, time.process_time() - began)
    return best_s / times


def list_scans(city: City) -> list[Rays]:
    """The rays of ten sensors over a city, one scan each: what the benchmark casts with ten aircraft."""
    targets = _place_aircraft(city, build_ray_index(city.walls()), SENSORS)
    firing = PATTERN.list_rays(0)
    return [make_pulse_rays(firing, _find_pose(targets, k), own=k) for k in range(SENSORS)]


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


def _find_pose(targets: Targets, k: int) -> SensorPose:
    """The pose of a sensor above aircraft `k`, which flies level, forward to the east."""
    mount = np.array([0.0, 0.0, IRIS.height_m])
    level = np.array([1.0, 0.0, 0.0, 0.0])
    return SensorPose(targets.position[k], targets.velocity[k], level, np.zeros(3), mount)


def _digest(results: Sequence[tuple[Any, ...]]) -> str:
    digest = sha256()
    for arrays in results:
        for values in arrays:
            digest.update(values.tobytes())
    return digest.hexdigest()[:16]
