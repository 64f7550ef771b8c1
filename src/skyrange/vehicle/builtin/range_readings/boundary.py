"""Boundary around an aircraft: the filtered distances of obstacles in eight sectors, and lines between their edges.

After libraries/AP_Proximity/AP_Proximity_Boundary_3D.cpp, of which MAVLink fills the level layer alone. Vectors are
of a level body, in metres: ahead, right. Angles are clockwise from the nose.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.core import elementary_python
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.vehicle.builtin.range_readings.plane_vectors import Vector2

SECTORS: Final = 8
SECTOR_DEG: Final = 45.0
DEFAULT_M: Final = 100.0  # PROXIMITY_BOUNDARY_DIST_DEFAULT
MIN_M: Final = 0.6  # PROXIMITY_BOUNDARY_DIST_MIN
_FILTER_RESET_NS: Final[Time] = 1000 * NS_PER_MS  # PROXIMITY_FILT_RESET_TIME
_FACE_RESET_NS: Final[Time] = 1000 * NS_PER_MS  # PROXIMITY_FACE_RESET_MS
_CHECK_NS: Final[Time] = 750 * NS_PER_MS  # PROXIMITY_BOUNDARY_3D_TIMEOUT_MS


def _find_edges() -> tuple[Vector2, ...]:
    angles = [math.pi / 180.0 * (SECTOR_DEG * sector + 0.5 * SECTOR_DEG) for sector in range(SECTORS)]
    return tuple((elementary_python.cos(angle), elementary_python.sin(angle)) for angle in angles)


_EDGES: Final = _find_edges()
"""Direction of the edge between each sector and the next one clockwise."""


def find_sector(angle_deg: float) -> int:
    """The sector of a direction, 0 around the nose (`get_face`)."""
    return int((angle_deg + 0.5 * SECTOR_DEG) % 360.0 / SECTOR_DEG)


class Boundary:
    """Distances by sector, and the points between sectors. Deep-copyable."""

    def __init__(self) -> None:
        self._valid = [False] * SECTORS
        self._distance_m = [0.0] * SECTORS
        self._filtered_m = [0.0] * SECTORS
        self._updated_ns: list[Time] = [-_FILTER_RESET_NS] * SECTORS
        self._points: list[Vector2] = [(DEFAULT_M * x, DEFAULT_M * y) for x, y in _EDGES]
        self._checked_ns: Time = 0

    def clear(self) -> None:
        """Forget which distances are valid (`reset`): what follows says all of them anew."""
        self._valid = [False] * SECTORS

    def set_distance(self, now: Time, sector: int, distance_m: float, filter_hz: float) -> None:
        """A distance of a sector (`set_face_attributes`)."""
        self._distance_m[sector] = distance_m
        self._valid[sector] = True
        since_ns = now - self._updated_ns[sector]
        if since_ns < _FILTER_RESET_NS:
            before = self._filtered_m[sector]
            self._filtered_m[sector] = before + (distance_m - before) * _find_weight(since_ns / NS_PER_S, filter_hz)
        else:
            self._filtered_m[sector] = distance_m
        self._updated_ns[sector] = now
        self._update_points(sector)

    def drop_old(self, now: Time) -> None:
        """Drop distances that were not renewed for a second, as often as ArduPilot looks (`check_face_timeout`)."""
        if now - self._checked_ns < _CHECK_NS:
            return
        self._checked_ns = now
        for sector in range(SECTORS):
            if self._valid[sector] and now - self._updated_ns[sector] > _FACE_RESET_NS:
                self._valid[sector] = False
                self._update_points(sector)

    def list_lines(self) -> list[tuple[Vector2, Vector2]]:
        """The lines that stand for obstacles, each from its clockwise end (`convert_obstacle_num_to_face`)."""
        return [
            (self._points[(sector + 1) % SECTORS], self._points[sector])
            for sector in range(SECTORS)
            if any(self._valid[(sector + k) % SECTORS] for k in range(3))
        ]

    def find_closest(self) -> float:
        """The nearest unfiltered distance, infinite without one (`get_closest_object`)."""
        return min((d for d, valid in zip(self._distance_m, self._valid, strict=True) if valid), default=math.inf)

    def _shortest(self, first: int, second: int) -> float:
        """The shorter filtered distance of two neighbours."""
        return min((self._filtered_m[sector] for sector in (first, second) if self._valid[sector]), default=DEFAULT_M)

    def _update_points(self, sector: int) -> None:
        """Move the points at both edges of a sector, and those of neighbours without a distance (`update_boundary`)."""
        after, before, far = (sector + 1) % SECTORS, (sector - 1) % SECTORS, (sector - 2) % SECTORS
        distance = max(self._shortest(sector, after), MIN_M)
        self._place(sector, distance)
        if not self._valid[after]:
            self._place(after, distance)
        distance = self._shortest(before, sector)
        self._place(before, distance)
        if not self._valid[far]:
            self._place(far, distance)

    def _place(self, edge: int, distance_m: float) -> None:
        x, y = _EDGES[edge]
        self._points[edge] = (x * distance_m, y * distance_m)


def _find_weight(dt_s: float, hz: float) -> float:
    """Weight of a new value (`calc_lowpass_alpha_dt`): all of it without a filter, none of it at the same instant."""
    if hz <= 0.0:
        return 1.0
    return dt_s / (dt_s + 1.0 / (2.0 * math.pi * hz)) if dt_s > 0.0 else 0.0
