"""Coverings of volumes by S2 cells, as the DSS of InterUSS compares intents and subscriptions.

A DSS finds what may intersect: two entities that share a cell of level 13 (about 1 km across), and whose heights and
times overlap. USSs compare the volumes themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from s2sphere import LatLng, LatLngRect, RegionCoverer

from skyrange.codec.f3548.values import MAX_ALTITUDE_M, MIN_ALTITUDE_M, Area
from skyrange.core import elementary_python
from skyrange.core.geodesy import unwrap_outline, wrap_longitude
from skyrange.core.time import NEVER, Time

LEVEL: Final = 13
"""Level of the cells, which the DSSs of a pool have to agree on; InterUSS has this one."""
MAX_AREA_KM2: Final = 2_500.0
"""Largest area that a request may cover, as in the DSS of InterUSS (`maxAllowedAreaKm2`)."""
_KM_PER_DEG: Final = 111.32
_STEP_DEG: Final = 1e-4
"""Boxes are widened to multiples of this, 11 m, so that those of one place share a covering."""


class AreaError(Exception):
    """An area that is not searched."""


@dataclass(frozen=True, slots=True)
class Extent:
    """What a DSS knows of the volumes of an entity: cells, and the range of heights and times of all together."""

    cells: frozenset[int]
    lower_m: float
    upper_m: float
    start_ns: Time
    end_ns: Time

    def may_intersect(self, other: Extent) -> bool:
        """Whether volumes of the two may intersect."""
        return (
            self.start_ns <= other.end_ns
            and other.start_ns <= self.end_ns
            and self.lower_m <= other.upper_m
            and other.lower_m <= self.upper_m
            and not self.cells.isdisjoint(other.cells)
        )

    def covers(self, other: Extent) -> bool:
        """Whether it encloses the other."""
        return (
            self.cells >= other.cells
            and self.lower_m <= other.lower_m
            and other.upper_m <= self.upper_m
            and self.start_ns <= other.start_ns
            and other.end_ns <= self.end_ns
        )

    def joined(self, other: Extent) -> Extent:
        """The extent of both together."""
        return Extent(
            self.cells | other.cells,
            min(self.lower_m, other.lower_m),
            max(self.upper_m, other.upper_m),
            min(self.start_ns, other.start_ns),
            max(self.end_ns, other.end_ns),
        )


def extent_of(areas: Sequence[Area]) -> Extent:
    """The extent of at least one area, open bounds as wide as they can be. Raises `AreaError`."""
    cells: set[int] = set()
    for area in areas:
        cells |= _cover(_box(area))
    return Extent(
        frozenset(cells),
        min(MIN_ALTITUDE_M if area.lower_m is None else area.lower_m for area in areas),
        max(MAX_ALTITUDE_M if area.upper_m is None else area.upper_m for area in areas),
        min(-NEVER if area.start_ns is None else area.start_ns for area in areas),
        max(NEVER if area.end_ns is None else area.end_ns for area in areas),
    )


def _box(area: Area) -> tuple[int, int, int, int]:
    """South, west, north and east in steps; east may be beyond 180°."""
    lats, lngs = zip(*unwrap_outline(area.outline), strict=True)
    return (
        math.floor(min(lats) / _STEP_DEG),
        math.floor(min(lngs) / _STEP_DEG),
        math.ceil(max(lats) / _STEP_DEG),
        math.ceil(max(lngs) / _STEP_DEG),
    )


@lru_cache(maxsize=65_536)
def _cover(box: tuple[int, int, int, int]) -> frozenset[int]:
    south, west, north, east = (step * _STEP_DEG for step in box)
    height_km = (north - south) * _KM_PER_DEG
    width_km = (east - west) * _KM_PER_DEG * elementary_python.cos(math.radians((south + north) / 2.0))
    if height_km * width_km > MAX_AREA_KM2:
        raise AreaError(f"area too large: {height_km * width_km:.0f} km², at most {MAX_AREA_KM2:.0f} km² are searched")
    rect = LatLngRect(LatLng.from_degrees(south, west), LatLng.from_degrees(north, wrap_longitude(east)))
    coverer = RegionCoverer()
    coverer.min_level = coverer.max_level = LEVEL
    coverer.max_cells = 1_000_000
    return frozenset(cell.id() for cell in coverer.get_covering(rect))
