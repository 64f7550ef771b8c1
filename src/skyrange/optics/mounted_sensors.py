"""Mounted sensors: a LiDAR or a depth camera on an aircraft, with its place, its direction and its scans."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from skyrange.codec.range_scans import DEPTH, LIDAR
from skyrange.core import elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.time import NS_PER_S, Time
from skyrange.optics.scan_patterns import Firing, PixelGrid, RotatingPattern, ScanPattern, ScatteredPattern, SingleBeam
from skyrange.optics.sensor_models import DepthCameraModel, LidarModel

SensorModel = LidarModel | DepthCameraModel
_RADIANS: Final = math.pi / 180.0


@dataclass(frozen=True, slots=True)
class MountedSensor:
    """A sensor of an aircraft."""

    vehicle: str
    id: str
    number: int
    """On its aircraft, from 0."""
    model: SensorModel
    place_m: tuple[float, float, float]
    """On the body, from the bottom of the gear: forward, left, up in m."""
    yaw_deg: float = 0.0
    """Direction of its forward axis, clockwise from that of the body, seen from above."""
    pitch_deg: float = 0.0
    """And above the horizontal plane of the body."""
    is_stabilised: bool = False
    """Whether a gimbal keeps it level: it then has the heading of the body alone."""

    @property
    def name(self) -> str:
        """Unique in the scenario."""
        return f"{self.vehicle}.{self.id}"

    @property
    def kind(self) -> int:
        """As of `codec.range_scans.RangeScan`."""
        return LIDAR if isinstance(self.model, LidarModel) else DEPTH

    @property
    def period_ns(self) -> Time:
        """From one scan to the next."""
        return round(NS_PER_S / self.model.pattern.rate_hz)

    @property
    def duration_ns(self) -> Time:
        """From the start of a scan to its last pulse."""
        return self.period_ns if isinstance(self.model, LidarModel) else 0

    def list_rays(self, scan: int) -> Firing:
        """The pulses of a scan, in the frame of the sensor's base: that of the body, or the level one of a gimbal."""
        firing = list_pulses(self.model.pattern, scan)
        if self.yaw_deg == 0.0 and self.pitch_deg == 0.0:
            return firing
        turn = turn_mount(self.yaw_deg, self.pitch_deg)
        x, y, z = firing.direction.T
        turned = np.column_stack([turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * z for k in range(3)])
        return firing._replace(direction=turned)


def turn_mount(yaw_deg: float, pitch_deg: float) -> Floats:
    """(3, 3): from the frame of a sensor to that of its base."""
    yaw, pitch = -yaw_deg * _RADIANS, pitch_deg * _RADIANS
    cy, sy = elementary_python.cos(yaw), elementary_python.sin(yaw)
    cp, sp = elementary_python.cos(pitch), elementary_python.sin(pitch)
    return np.array([[cy * cp, -sy, -cy * sp], [sy * cp, cy, -sy * sp], [sp, 0.0, cp]])


def list_pulses(pattern: ScanPattern, scan: int) -> Firing:
    """`ScanPattern.list_rays`. The last scans are kept, for who makes a scan and who receives it."""
    if isinstance(pattern, (RotatingPattern, SingleBeam, PixelGrid)):
        return _list_kept(pattern, 0)
    return _list_kept(pattern, scan) if isinstance(pattern, ScatteredPattern) else pattern.list_rays(scan)


@lru_cache(maxsize=16)
def _list_kept(pattern: RotatingPattern | ScatteredPattern | SingleBeam | PixelGrid, scan: int) -> Firing:
    firing = pattern.list_rays(scan)
    for array in firing:
        array.setflags(write=False)
    return firing
