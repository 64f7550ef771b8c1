"""What the viewer asks about scans: the points of the newest ones of an aircraft, and the fields of its sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np

from skyrange.core.arrays import Floats
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.metrics.scans import Scan
from skyrange.optics.mounted_sensors import MountedSensor, turn_mount
from skyrange.optics.scan_patterns import Firing, PixelGrid, RotatingPattern, ScatteredPattern
from skyrange.optics.sensor_poses import make_pulse_rays
from skyrange.record import RunRecord
from skyrange.view.scan_index import NewestScans, ScanIndex

MAX_POINTS: Final = 12_000
"""Points of a scan at most; of more, every second, third … is left out."""
SHOWN_S: Final = 1.0
"""How long after it was sent a scan is shown, and two periods more."""
FIELD_M: Final = 6.0
"""How far from the sensor the field of a LiDAR is drawn."""
_CORNERS: Final = 24
_FALSE: Final = 4
"""Stands for noise beside what a pulse met."""


class ScanQueries:
    """Answers about the arms of a stream, by their numbers. All are values that JSON has."""

    def __init__(self, records: Sequence[RunRecord]) -> None:
        self._records = records
        self._index = lru_cache(maxsize=4)(self._make_index)

    def _make_index(self, arm: int) -> ScanIndex | None:
        if not 0 <= arm < len(self._records):
            raise InputError.one("viewer", "arm", str(arm), f"an arm, from 0 to {len(self._records) - 1}")
        record = self._records[arm]
        return ScanIndex(record) if record.keeps("scans") and record.rows("scans") else None

    def read_scans(self, arm: int, vehicle: str, until_s: float) -> dict[str, Any]:
        """The newest `scans` of an aircraft at a time, one for each sensor: `sensor`, `t` when it was sent, `of` how
        many points, `points` (east, north, up in cm of each that is shown, one after the other), `met` of each (as
        `Scan.kind`, 4 for noise), and `field`, lines of such numbers. None of a record without scans.
        """
        index = self._index(arm)
        return _answer([] if index is None else index.newest(vehicle, int(until_s * NS_PER_S)), until_s)


class FlyingScans:
    """The same about a run that flies, of which only the newest scans are known."""

    def __init__(self) -> None:
        self.known: NewestScans | None = None
        """None before the run, and of one that keeps none."""

    def read_scans(self, arm: int, vehicle: str, until_s: float) -> dict[str, Any]:
        """As `ScanQueries.read_scans`, of the only arm."""
        if arm:
            raise InputError.one("viewer", "arm", str(arm), "0")
        return _answer([] if self.known is None else self.known.newest(vehicle, int(until_s * NS_PER_S)), until_s)


def _answer(scans: Sequence[Scan], until_s: float) -> dict[str, Any]:
    return {"scans": [_describe(scan) for scan in scans if _is_shown(scan, until_s)]}


def _is_shown(scan: Scan, until_s: float) -> bool:
    return until_s - scan.sent_ns / NS_PER_S <= SHOWN_S + 2.0 * scan.sensor.period_ns / NS_PER_S


def _describe(scan: Scan) -> dict[str, Any]:
    points, returns = scan.points(), scan.returns
    step = math.ceil(len(points) / MAX_POINTS) or 1
    step += 1 - step % 2  # beams fire in turn: an even step would leave whole ones out
    met = np.zeros(len(points), dtype=np.int64) if scan.kind is None else scan.kind[returns].astype(np.int64)
    if scan.is_false is not None:
        met[scan.is_false[returns]] = _FALSE
    return {
        "sensor": scan.sensor.id,
        "t": scan.sent_ns / NS_PER_S,
        "of": len(points),
        "points": _centimetres(points[::step]),
        "met": met[::step].tolist(),
        "field": [_centimetres(line) for line in draw_field(scan)],
    }


def _centimetres(points: Floats) -> list[int]:
    found: list[int] = np.round(points * 100.0).astype(np.int64).reshape(-1).tolist()
    return found


def draw_field(scan: Scan) -> list[Floats]:
    """Lines (n, 3) in local coordinates that enclose the field of a sensor at the start of a scan, in the attitude that
    the scan has: of a camera as far as it sees, of a LiDAR `FIELD_M`.
    """
    return [_place(scan, line) for line in _outline(scan.sensor)]


def _outline(sensor: MountedSensor) -> list[Floats]:
    """The same from the sensor, in its own frame."""
    pattern, origin = sensor.model.pattern, np.zeros((1, 3))
    if isinstance(pattern, PixelGrid):
        across, up = (math.tan(math.radians(0.5 * angle)) for angle in pattern.field_deg)
        corners = sensor.model.reach_m * np.array(
            [[1, y * across, z * up] for y, z in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        )
        return [np.vstack([corners, corners[:1]]), *(np.vstack([origin, corner]) for corner in corners)]
    if isinstance(pattern, RotatingPattern):
        azimuth, elevation = (-180.0, 180.0), (min(pattern.elevation_deg), max(pattern.elevation_deg))
    elif isinstance(pattern, ScatteredPattern):
        azimuth, elevation = pattern.azimuth_deg, pattern.elevation_deg
    else:
        return [np.array([[0.0, 0.0, 0.0], [sensor.model.reach_m, 0.0, 0.0]])]
    turns = np.radians(np.linspace(*azimuth, _CORNERS + 1))
    rings = []
    for angle in np.radians(elevation):
        level = math.cos(angle)
        ring = np.column_stack([level * np.cos(turns), level * np.sin(turns), np.full(len(turns), math.sin(angle))])
        rings.append(FIELD_M * ring)
    return rings


def _place(scan: Scan, line: Floats) -> Floats:
    turned = line @ turn_mount(scan.sensor.yaw_deg, scan.sensor.pitch_deg).T
    length = np.linalg.norm(turned, axis=1)
    direction = turned / np.maximum(length, 1e-9)[:, np.newaxis]
    direction[length == 0.0] = [1.0, 0.0, 0.0]
    firing = Firing(direction, np.zeros(len(line)), np.arange(len(line), dtype=np.uint64))
    rays = make_pulse_rays(firing, scan.pose._replace(attitude=scan.estimate))
    placed: Floats = rays.origin + rays.direction * length[:, np.newaxis]
    return placed
