"""Airspace taken by flight paths: legs with their heights, in a spatial index.

Time is left out: two paths that share a place are too near even if they are flown an hour apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.gcs.plan.paths import Point

APART_M = 10.0
"""Kept from other aircraft's paths seen from above…"""
RISE_M = 8.0
"""…or in height: several times what barometers of two aircraft may differ by."""

_Legs = tuple[NDArray[np.object_], NDArray[np.float64], NDArray[np.float64]]


class Airspace:
    """The paths placed so far."""

    def __init__(self) -> None:
        self._lines: list[Any] = []
        self._low_m: list[float] = []
        self._high_m: list[float] = []

    def add(self, path: Sequence[Point]) -> None:
        """Add a path, corner by corner in metres."""
        lines, low_m, high_m = _legs(path)
        self._lines += lines.tolist()
        self._low_m += low_m.tolist()
        self._high_m += high_m.tolist()

    def neighbours_of(self, path: Sequence[Point]) -> Neighbours:
        """What `path` must keep clear of, wherever it is shifted to at its heights."""
        lines = np.array(self._lines, dtype=object)
        low_m, high_m = np.array(self._low_m), np.array(self._high_m)
        indices = []
        for one_low_m, one_high_m in zip(*_legs(path)[1:], strict=True):
            level = (low_m < one_high_m + RISE_M) & (high_m > one_low_m - RISE_M)
            indices.append(shapely.STRtree(lines[level]))
        return Neighbours(indices, _ends(path))


class Neighbours:
    """For each leg of one path, the legs of others at its height."""

    def __init__(self, indices: Sequence[Any], ends: NDArray[np.float64]) -> None:
        self._indices = [(index, leg) for index, leg in zip(indices, ends, strict=True) if len(index)]

    def conflict(self, east_m: float, north_m: float) -> bool:
        """Whether the path, shifted so, comes within `APART_M` of one of them."""
        shift = (east_m, north_m)
        return any(
            index.query(_seen(leg + shift), predicate="dwithin", distance=APART_M).size for index, leg in self._indices
        )


def _seen(leg: NDArray[np.float64]) -> Any:
    """A leg from above: one straight up is a point, since GEOS finds no distance to a line without length."""
    return shapely.points(leg[0]) if (leg[0] == leg[1]).all() else shapely.linestrings(leg)


def _ends(path: Sequence[Point]) -> NDArray[np.float64]:
    """(legs, 2 ends, east and north); a path of one point is a leg without length."""
    pairs = list(pairwise(path)) or [(path[0], path[0])]
    return np.array([[a[:2], b[:2]] for a, b in pairs])


def _legs(path: Sequence[Point]) -> _Legs:
    """Each leg seen from above, and its least and greatest height."""
    pairs = list(pairwise(path)) or [(path[0], path[0])]
    heights_m = np.array([[a[2], b[2]] for a, b in pairs])
    lines = np.array([_seen(leg) for leg in _ends(path)], dtype=object)
    return lines, heights_m.min(axis=1), heights_m.max(axis=1)
