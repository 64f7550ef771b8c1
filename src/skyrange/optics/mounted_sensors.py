"""Mounted sensors: a LiDAR or a depth camera on an aircraft, with its place, its direction and its scans."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from skyrange.codec.range_scans import DEPTH, LIDAR, RangeScan
from skyrange.core import elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.errors import DecodeError
from skyrange.core.time import NS_PER_S, Time
from skyrange.optics.scan_patterns import (
    Firing,
    PixelGrid,
    RotatingPattern,
    ScanPattern,
    ScatteredPattern,
    SingleBeam,
    count_pulses,
)
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
        return list_pulses(self.model.pattern, scan, self.yaw_deg, self.pitch_deg)


def check_scan(scan: RangeScan, sensor: MountedSensor) -> None:
    """Raise `DecodeError` unless kind, resolution and number of pulses of a scan are those of a sensor."""
    count = count_pulses(sensor.model.pattern)
    if scan.kind != sensor.kind or len(scan.steps) != count:
        raise DecodeError(f"kind {scan.kind} with {len(scan.steps)} steps: not a scan of {sensor.name}, with {count}")
    if round(scan.resolution_m * 1e6) != round(sensor.model.resolution_m * 1e6):
        raise DecodeError(f"a resolution of {scan.resolution_m} m: not that of {sensor.name}")


def turn_mount(yaw_deg: float, pitch_deg: float) -> Floats:
    """(3, 3): from the frame of a sensor to that of its base."""
    yaw, pitch = -yaw_deg * _RADIANS, pitch_deg * _RADIANS
    cy, sy = elementary_python.cos(yaw), elementary_python.sin(yaw)
    cp, sp = elementary_python.cos(pitch), elementary_python.sin(pitch)
    return np.array([[cy * cp, -sy, -cy * sp], [sy * cp, cy, -sy * sp], [sp, 0.0, cp]])


def list_pulses(pattern: ScanPattern, scan: int, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> Firing:
    """`ScanPattern.list_rays`, turned as a mount turns the sensor. The last scans are kept, for who makes a scan and
    who receives it.
    """
    if isinstance(pattern, (RotatingPattern, SingleBeam, PixelGrid)):
        return _list_kept(pattern, 0, yaw_deg, pitch_deg)
    if isinstance(pattern, ScatteredPattern):
        return _list_kept(pattern, scan, yaw_deg, pitch_deg)
    return _list_turned(pattern, scan, yaw_deg, pitch_deg)


def _list_turned(pattern: ScanPattern, scan: int, yaw_deg: float, pitch_deg: float) -> Firing:
    firing = pattern.list_rays(scan)
    if yaw_deg == 0.0 and pitch_deg == 0.0:
        return firing
    turn = turn_mount(yaw_deg, pitch_deg)
    x, y, z = firing.direction.T
    turned = np.column_stack([turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * z for k in range(3)])
    return firing._replace(direction=turned)


@lru_cache(maxsize=16)
def _list_kept(
    pattern: RotatingPattern | ScatteredPattern | SingleBeam | PixelGrid, scan: int, yaw_deg: float, pitch_deg: float
) -> Firing:
    firing = _list_turned(pattern, scan, yaw_deg, pitch_deg)
    for array in firing:
        array.setflags(write=False)
    return firing
