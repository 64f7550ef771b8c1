"""Obstacle sectors: the nearest returns of a scan in 72 sectors of 5° around an aircraft, and the return of one beam.

Directions come from the sensor's model, the tilt from the attitude that the scan brings: sectors lie in the horizontal
plane and count clockwise from the nose, as ArduPilot reads OBSTACLE_DISTANCE (AC_Avoid.cpp rotates obstacles by the
yaw alone).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.range_scans import LIDAR, RangeScan
from skyrange.core import elementwise
from skyrange.core.arrays import Floats
from skyrange.optics.mounted_sensors import MountedSensor, list_pulses

SECTORS: Final = 72
"""Elements of OBSTACLE_DISTANCE.distances."""
SECTOR_DEG: Final = 360.0 / SECTORS
BAND_M: Final = (0.15, 1.0)
"""Heights above the bottom of the gear between which a return is an obstacle (assumed). The lower one keeps the ground
of a landed aircraft out, up to a tilt error of 0.5° at 15 m."""
CONFIRM_M: Final = 0.5
"""A return counts if another one of its sector is so near in distance (assumed): single returns may be noise."""


class ObstacleSectors(NamedTuple):
    """What a scan says of the sectors around an aircraft."""

    distance_m: Floats
    """(72,): horizontal distance of the nearest obstacle from the middle of the aircraft; infinite where is none."""
    looked: NDArray[np.bool_]
    """(72,): whether the scan has pulses or pixels there."""


def find_obstacles(scan: RangeScan, sensor: MountedSensor) -> ObstacleSectors:
    """The sectors of a scan of this sensor."""
    direction = sensor.list_rays(scan.scan).direction
    ahead, left, up = _level(scan.attitude, direction)
    sector = _find_sectors(ahead, left)
    looked = np.bincount(sector, minlength=SECTORS) > 0
    distance = scan.steps * scan.resolution_m
    if scan.kind != LIDAR:
        distance = distance / list_pulses(sensor.model.pattern, scan.scan).direction[:, 0]
    place = _level(scan.attitude, np.array([sensor.place_m]))
    ahead, left, up = ahead * distance + place[0], left * distance + place[1], up * distance + place[2]
    met = (scan.steps > 0) & (up >= BAND_M[0]) & (up <= BAND_M[1])
    return ObstacleSectors(_find_nearest(ahead[met], left[met]), looked)


def measure_beam(scan: RangeScan) -> float | None:
    """The distance of a single beam in metres; None without a return."""
    return int(scan.steps[0]) * scan.resolution_m if scan.steps[0] else None


def _level(attitude: tuple[float, float, float, float], vectors: Floats) -> tuple[Floats, Floats, Floats]:
    """Vectors (n, 3) of a sensor's base, ahead, left and up of a level aircraft with the same heading."""
    w, x, y, z = attitude
    a, b, c = vectors.T
    east = (1.0 - 2.0 * (y * y + z * z)) * a + 2.0 * (x * y - w * z) * b + 2.0 * (x * z + w * y) * c
    north = 2.0 * (x * y + w * z) * a + (1.0 - 2.0 * (x * x + z * z)) * b + 2.0 * (y * z - w * x) * c
    up = 2.0 * (x * z - w * y) * a + 2.0 * (y * z + w * x) * b + (1.0 - 2.0 * (x * x + y * y)) * c
    nose_e, nose_n = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    length = math.sqrt(nose_e * nose_e + nose_n * nose_n)
    if length < 1e-6:  # nose up or down: there is no heading
        nose_e, nose_n, length = 1.0, 0.0, 1.0
    cos, sin = nose_e / length, nose_n / length
    return cos * east + sin * north, cos * north - sin * east, up


def _find_sectors(ahead: Floats, left: Floats) -> NDArray[np.int64]:
    """(n,): the sector of each direction; sector 0 is centred on the nose, they count clockwise."""
    clockwise = elementwise.atan2(-left, ahead) * (180.0 / math.pi)
    return np.floor(clockwise / SECTOR_DEG + 0.5).astype(np.int64) % SECTORS


def _find_nearest(ahead: Floats, left: Floats) -> Floats:
    """(72,): distance of the nearest return of each sector that another one confirms."""
    nearest = np.full(SECTORS, np.inf)
    if len(ahead) < 2:
        return nearest
    sector, distance = _find_sectors(ahead, left), np.sqrt(ahead * ahead + left * left)
    order = np.lexsort((distance, sector))
    sector, distance = sector[order], distance[order]
    confirmed = (sector[1:] == sector[:-1]) & (distance[1:] - distance[:-1] <= CONFIRM_M)
    np.minimum.at(nearest, sector[:-1][confirmed], distance[:-1][confirmed])
    return nearest
