"""Encounters of the study: what a LiDAR returns of a target at a distance, and when it has detected one that closes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_S
from skyrange.optics.extinction import Weather
from skyrange.optics.ray_casting import AIRCRAFT, cast_rays
from skyrange.optics.ray_index import build_ray_index
from skyrange.optics.reflectivity import MATERIALS, Surfaces
from skyrange.optics.returns import Address, find_returns
from skyrange.optics.scan_patterns import Firing, ScatteredPattern, choose_rays
from skyrange.optics.sensor_models import LidarModel
from skyrange.optics.sensor_poses import SensorPose, make_pulse_rays, sample_footprint
from skyrange.optics.targets import place_targets
from skyrange.world.airframes import IRIS

STREAM: Final = "detection-range"
SAMPLES: Final = 5
"""Rays across and up in each pulse."""
NOD_RAD: Final = math.pi / 180.0
"""Standard deviation of pitch and of roll, independent between scans."""
APART_M: Final = 1.0
"""Greatest difference of the heights of two aircraft that are on a course to collide."""
CLEAR: Final = Weather()
_CUBE: Final = 1.05
"""Drag coefficient by which the side of the Iris's box became its drag area (`world.airframes`)."""
_ABOVE_M: Final = 200.0
_INDEX: Final = build_ray_index()


class Target(NamedTuple):
    """An upright cylinder."""

    name: str
    radius_m: float
    height_m: float
    reflectivity: float


_BODY_M: Final = 2.0 * IRIS.gear_half_track_m
OUTLINE: Final = Target("outline", IRIS.radius_m, IRIS.height_m, MATERIALS["aircraft"].reflectivity)
BODY: Final = Target("body", 0.5 * _BODY_M, IRIS.drag_area_m2 / _CUBE / _BODY_M, MATERIALS["aircraft"].reflectivity)
BIRD: Final = Target("bird", 0.15, 0.1, MATERIALS["bird"].reflectivity)
WIRE: Final = Target("wire", 0.014, 100.0, MATERIALS["wire"].reflectivity)


@dataclass(frozen=True, slots=True)
class Encounter:
    """One target in front of one sensor."""

    model: LidarModel
    target: Target
    weather: Weather = CLEAR
    level: bool = False
    """Whether the cylinder lies on its side, across the line of sight: a wire (the sensor is rolled instead)."""
    tilt_rad: float = 0.0
    """How far the sensor looks down; if it does, the target is straight ahead."""

    def count_returns(self, distance_m: float, closing_mps: float, trial: int, scan: int, rise: float) -> int:
        """Returns of the target in one scan that begins at `distance_m`; `rise` in -1 to 1 is the height between both.

        What is random is addressed by trial and scan: the bearing by the trial alone.
        """
        chance = Chance(trial)
        bearing, across, _, _ = chance.uniform4(STREAM, hash64(self.target.name), 0)
        u0, u1, _, _ = chance.uniform4(STREAM, hash64("nod"), scan)
        size = math.sqrt(-2.0 * elementary_python.log(1.0 - u0)) * NOD_RAD
        pitch = size * elementary_python.cos(2.0 * math.pi * u1) + self.tilt_rad
        roll = size * elementary_python.sin(2.0 * math.pi * u1) + (0.5 * math.pi if self.level else 0.0)
        yaw = 0.0 if self.level or self.tilt_rad else 2.0 * math.pi * bearing
        shift = across - 0.5 if self.level else 0.0  # of the wire, which no row prefers
        origin = np.array([0.0, 0.0, _ABOVE_M])
        attitude = turn_by(yaw, pitch, roll)
        place = np.array([distance_m, shift * distance_m * 0.1, _ABOVE_M + rise * APART_M])
        place[2] -= 0.5 * self.target.height_m
        speed = np.array([-closing_mps, 0.0, 0.0])
        firing = self._choose(attitude, place - origin, scan)
        if not len(firing.number):
            return 0
        one = np.ones(1)
        during_s = 1.0 / self.model.pattern.rate_hz
        radius, height = self.target.radius_m * one, self.target.height_m * one
        targets = place_targets(_INDEX, place[None], speed[None], radius, height, during_s=during_s)
        pose = SensorPose(origin, np.zeros(3), attitude, np.zeros(3), np.zeros(3))
        beam = sample_footprint(self.model, SAMPLES, SAMPLES)
        hits = cast_rays(_INDEX, make_pulse_rays(firing, pose, beam), self.model.reach_m, targets)
        surfaces = Surfaces(MATERIALS["asphalt"].reflectivity, one, self.target.reflectivity * one)
        start_ns = round(scan * during_s * NS_PER_S)
        address = Address(chance, hash64(self.model.name), start_ns)
        returns = find_returns(self.model, firing, hits, surfaces, self.weather, address)
        return int(((returns.steps > 0) & (returns.kind == AIRCRAFT) & ~returns.is_false).sum())

    def _choose(self, attitude: Floats, to_target: Floats, scan: int) -> Firing:
        """The pulses that can touch the target at some time of the scan."""
        firing = _list_rays(self.model, scan)
        away = math.sqrt(float((to_target**2).sum()))
        if self.target is WIRE:  # it is as high as the field: rays beside it cannot touch it
            ahead, left = (rotate_back(attitude, axis) for axis in np.eye(3)[:2])
            beside = firing.direction @ left - to_target[1] / to_target[0] * (firing.direction @ ahead)
            moves = abs(to_target[1]) * 3.0 / (to_target[0] * max(to_target[0] - 3.0, 0.5))
            near = np.abs(beside) < 0.01 + self.target.radius_m / away + moves
            return choose_rays(firing, near & (firing.direction @ ahead > 0.0))
        nearest = max(away - 3.0, 0.5)  # it closes by 2 m during a scan
        half = (self.target.radius_m + self.target.height_m + APART_M) / nearest + max(self.model.divergence_rad)
        ahead = rotate_back(attitude, to_target / away)
        return choose_rays(firing, firing.direction @ ahead > math.cos(min(half, math.pi)))


def _list_rays(model: LidarModel, scan: int) -> Firing:
    return _remember_rays(model, scan if isinstance(model.pattern, ScatteredPattern) else 0)


@lru_cache(maxsize=64)
def _remember_rays(model: LidarModel, scan: int) -> Firing:
    return model.pattern.list_rays(scan)


def turn_by(yaw: float, pitch: float, roll: float) -> Floats:
    """The quaternion of a body that turned left, then its nose down, then to the right side."""
    q = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, angle in ((3, yaw), (2, pitch), (1, roll)):
        half = np.zeros(4)
        half[0], half[axis] = elementary_python.cos(0.5 * angle), elementary_python.sin(0.5 * angle)
        q = multiply(q, half)
    return q


def multiply(a: Floats, b: Floats) -> Floats:
    """The product of two quaternions."""
    w, x, y, z = a
    return np.array(
        [
            w * b[0] - x * b[1] - y * b[2] - z * b[3],
            w * b[1] + x * b[0] + y * b[3] - z * b[2],
            w * b[2] - x * b[3] + y * b[0] + z * b[1],
            w * b[3] + x * b[2] - y * b[1] + z * b[0],
        ]
    )


def rotate_back(q: Floats, vector: Floats) -> Floats:
    """A vector of the local frame in that of a body with the attitude `q`."""
    inverse = q * np.array([1.0, -1.0, -1.0, -1.0])
    return multiply(multiply(inverse, np.array([0.0, *vector])), q)[1:]


def draw_rise(trial: int) -> float:
    """The height between both aircraft of a trial, -1 to 1 times `APART_M`."""
    return 2.0 * Chance(trial).uniform4(STREAM, hash64("rise"), 0)[0] - 1.0


def count_aimed(encounter: Encounter, distance_m: float, trials: int) -> int:
    """How many of so many pulses of a single beam that points at the middle of the target return it."""
    model, target, one = encounter.model, encounter.target, np.ones(1)
    origin = np.array([0.0, 0.0, _ABOVE_M])
    place = np.array([[distance_m, 0.0, _ABOVE_M - 0.5 * target.height_m]])
    outline = target.radius_m * one, target.height_m * one
    targets = place_targets(_INDEX, place, np.zeros((1, 3)), *outline)
    pose = SensorPose(origin, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    firing = model.pattern.list_rays(0)
    rays = make_pulse_rays(firing, pose, sample_footprint(model, 5 * SAMPLES, 5 * SAMPLES))
    hits = cast_rays(_INDEX, rays, model.reach_m, targets)
    surfaces = Surfaces(MATERIALS["asphalt"].reflectivity, one, target.reflectivity * one)
    addresses = (Address(Chance(k), hash64(model.name), 0) for k in range(trials))
    found = [find_returns(model, firing, hits, surfaces, encounter.weather, address) for address in addresses]
    return sum(bool(returns.steps[0] and not returns.is_false[0]) for returns in found)


def count_at(encounter: Encounter, distance_m: float, trials: int) -> NDArray[np.int64]:
    """Returns in one scan at a distance, for each trial."""
    return np.array([encounter.count_returns(distance_m, 0.0, k, k, draw_rise(k)) for k in range(trials)])


class Rule(NamedTuple):
    """A detection: `returns` or more in a scan, in `scans` of the last `of` scans."""

    returns: int
    scans: int
    of: int

    def __str__(self) -> str:
        scans = "a scan" if self.of == 1 else f"{self.scans} of {self.of} scans"
        return f"{self.returns} in {scans}"


RULE: Final = Rule(2, 2, 3)
"""That of the page."""


class Approach(NamedTuple):
    """The scans of one approach, until contact."""

    left_m: Floats
    """(n,): distance at the end of each scan."""
    returns: NDArray[np.int64]
    """(n,)."""

    def find_detection_m(self, rule: Rule) -> float:
        """Distance at the end of the scan in which a rule is met first, 0 if it is not before contact."""
        meets = self.returns >= rule.returns
        for k in range(len(meets)):
            if meets[max(k + 1 - rule.of, 0) : k + 1].sum() >= rule.scans:
                return float(self.left_m[k])
        return 0.0


def approach(encounter: Encounter, closing_mps: float, from_m: float, trial: int) -> Approach:
    """Fly one approach from about `from_m`."""
    moved_m = closing_mps / encounter.model.pattern.rate_hz
    start_m = from_m + moved_m * Chance(trial).uniform4(STREAM, hash64("phase"), 0)[0]
    scans = math.ceil((start_m - 2.0 * OUTLINE.radius_m) / moved_m) - 1
    begins = start_m - moved_m * np.arange(float(scans))
    rise = draw_rise(trial)
    found = [encounter.count_returns(float(away), closing_mps, trial, k, rise) for k, away in enumerate(begins)]
    return Approach(begins - moved_m, np.array(found))
