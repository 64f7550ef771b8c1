"""Beams of a scan in local coordinates, as a companion computes them: by its own position and the scan's attitude."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.range_scans import RangeScan
from skyrange.core import elementary_python, elementwise
from skyrange.core.arrays import Floats
from skyrange.core.time import NS_PER_S, Time
from skyrange.optics.mounted_sensors import MountedSensor, list_pulses
from skyrange.optics.ray_casting import NONE, Rays, cast_rays
from skyrange.optics.ray_index import RayIndex
from skyrange.optics.returns import make_detector
from skyrange.optics.scan_patterns import PixelGrid, RotatingPattern, ScatteredPattern
from skyrange.optics.sensor_models import LidarModel

BODY_M: Final = (0.47, 0.11)
"""Width and height of the body of another aircraft: those of an Iris (assumed of all)."""
_SQRT_HALF: Final = math.sqrt(0.5)
_AROUND: Final = np.array(
    [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, -1)]
    + [(x * _SQRT_HALF, y * _SQRT_HALF, 0.0) for x in (1, -1) for y in (1, -1)]
    + [(x * _SQRT_HALF, y * _SQRT_HALF, -_SQRT_HALF) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))],
    dtype=np.float64,
)
"""Directions in which a surface of the map is looked for: eight in the plane, four below it, and down."""
REFLECTIVITY: Final = 0.1
"""Of another aircraft (assumed, as `optics.reflectivity`)."""
WALL_M: Final = 2.0
"""How near to a surface of the map a return may be its own: errors of the own position, and of the map (assumed)."""


class Beams(NamedTuple):
    """The n pulses or pixels of a scan."""

    origin: Floats
    """(3,): of the sensor in the middle of the scan, east, north and up in m."""
    direction: Floats
    """(n, 3): unit vectors."""
    distance_m: Floats
    """(n,): 0 where nothing came back."""


class SensorView:
    """What a companion knows of a sensor of its aircraft."""

    __slots__ = ("apart_ns", "number", "reach_m", "sensor", "spacing_rad")

    def __init__(self, sensor: MountedSensor, apart_ns: Time) -> None:
        """`apart_ns` is how long the scans of a pattern that repeats are no news to each other."""
        self.sensor = sensor
        self.number = sensor.number
        self.reach_m = sensor.model.reach_m
        pattern = sensor.model.pattern
        self.spacing_rad = find_spacing(pattern)
        """Mean angle between neighbouring pulses, across and up."""
        self.apart_ns = sensor.period_ns if isinstance(pattern, ScatteredPattern) else max(apart_ns, sensor.period_ns)

    def place_beams(self, scan: RangeScan, position: Floats, velocity: Floats, at_ns: Time) -> Beams:
        """The beams of a scan of this sensor, of an aircraft that was at `position` (3,) at `at_ns`."""
        firing = self.sensor.list_rays(scan.scan)
        turn = find_rotation(scan.attitude)
        direction = _turn(turn, firing.direction)
        mount = np.array(self.sensor.place_m)
        middle_ns = scan.start_ns + self.sensor.duration_ns // 2
        origin = position + velocity * ((middle_ns - at_ns) / NS_PER_S) + _turn(turn, mount[None])[0]
        distance = scan.steps.astype(np.float64) * scan.resolution_m
        if not isinstance(self.sensor.model, LidarModel):  # a depth is along the axis
            distance = distance / list_pulses(self.sensor.model.pattern, 0).direction[:, 0]
        return Beams(origin, direction, distance)

    def find_probability(self, away_m: float, extinction_per_m: float = 0.0) -> float:
        """Probability that a pulse in the middle of another aircraft's body returns it. Depth cameras see it through
        any air.
        """
        model = self.sensor.model
        if not model.near_m <= away_m <= model.reach_m:
            return 0.0
        if not isinstance(model, LidarModel):
            return 1.0
        share = 1.0
        for size, aperture, divergence in zip(BODY_M, model.aperture_m, model.divergence_rad, strict=True):
            share *= min(1.0, size / (aperture + away_m * divergence))
        near = model.reference_m / away_m
        detector = make_detector(model)
        amplitude = detector.reference * share * (REFLECTIVITY / model.reference_reflectivity) * near * near
        amplitude *= elementary_python.exp(-2.0 * extinction_per_m * away_m)
        found = 0.5 * elementary_python.erfc((detector.threshold - amplitude) * math.sqrt(0.5))
        return found * (1.0 - model.drop_out)

    @property
    def false_alarm_per_m(self) -> float:
        """Probability that a pulse returns noise within a metre of its range."""
        model = self.sensor.model
        return model.false_alarm / (model.reach_m - model.near_m) if isinstance(model, LidarModel) else 0.0


def find_spacing(pattern: Any) -> tuple[float, float]:
    """Mean angle between neighbouring pulses of a scan, across and up, in radians."""
    if isinstance(pattern, RotatingPattern):
        beams = sorted(pattern.elevation_deg)
        up = math.radians((beams[-1] - beams[0]) / (len(beams) - 1)) if len(beams) > 1 else math.pi
        return 2.0 * math.pi / pattern.sequences, up
    if isinstance(pattern, ScatteredPattern):
        across = math.radians(pattern.azimuth_deg[1] - pattern.azimuth_deg[0])
        low, high = (elementary_python.sin(math.radians(angle)) for angle in pattern.elevation_deg)
        apart = math.sqrt(across * (high - low) / pattern.rays)
        return apart, apart
    if isinstance(pattern, PixelGrid):
        focal = pattern.focal_px
        return 1.0 / focal[0], 1.0 / focal[1]
    return math.pi, math.pi


def find_field(pattern: Any) -> tuple[float, float]:
    """Angles of the field of view, across and up, in radians; 0 for a single beam."""
    if isinstance(pattern, RotatingPattern):
        return 2.0 * math.pi, math.radians(max(pattern.elevation_deg) - min(pattern.elevation_deg))
    if isinstance(pattern, ScatteredPattern):
        across, up = pattern.azimuth_deg, pattern.elevation_deg
        return math.radians(across[1] - across[0]), math.radians(up[1] - up[0])
    if isinstance(pattern, PixelGrid):
        return math.radians(pattern.field_deg[0]), math.radians(pattern.field_deg[1])
    return 0.0, 0.0


def find_rotation(attitude: tuple[float, float, float, float]) -> Floats:
    """(3, 3): the rotation of a unit quaternion, w first."""
    w, x, y, z = attitude
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _turn(turn: Floats, vectors: Floats) -> Floats:
    """(n, 3): rotated, axis by axis, because a product of matrices has other bits on other machines."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.column_stack([turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * z for k in range(3)])


def find_near_surfaces(city: RayIndex, points: Floats, within_m: float) -> NDArray[np.bool_]:
    """(k,): whether a surface of the map is within `within_m` of each point (k, 3), in one of thirteen directions.

    So what returns from an edge of a roof is the roof's, though the map has nothing on the beam itself.
    """
    count, ways = len(points), len(_AROUND)
    rays = Rays(
        np.repeat(points, ways, axis=0),
        np.tile(_AROUND, (count, 1)),
        np.zeros(count * ways),
        np.full(count * ways, -1, dtype=np.int32),
    )
    return np.asarray((cast_rays(city, rays, within_m).kind != NONE).reshape(count, ways).any(axis=1))


def find_map_distances(city: RayIndex, beams: Beams, rows: Any, reach_m: float) -> Floats:
    """(k,): distance of the first surface of the map on some beams; infinite without one within `reach_m`."""
    return find_map_hits(city, beams, rows, reach_m)[0]


def find_map_hits(city: RayIndex, beams: Beams, rows: Any, reach_m: float) -> tuple[Floats, Floats]:
    """The same, and (k,): the cosine of the angle of incidence there."""
    count = len(rows)
    rays = Rays(
        np.tile(beams.origin, (count, 1)), beams.direction[rows], np.zeros(count), np.full(count, -1, dtype=np.int32)
    )
    length = elementwise.length(rays.direction)
    hits = cast_rays(city, rays._replace(direction=rays.direction / length[:, None]), reach_m)
    return np.where(hits.kind == NONE, np.inf, hits.distance_m), hits.cosine
