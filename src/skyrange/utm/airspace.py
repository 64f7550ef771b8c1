"""Claimed airspace: the volumes of operational intents in a grid, and the search for overlaps.

Outlines are compared in the plane of longitude and latitude, in degrees, because F3548 states corners alone. Two
volumes overlap if their outlines meet and their heights and times have more than an end in common. A ring that crosses
itself counts as its convex hull; F3548 allows none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.time import Time
from skyrange.core.volumes import Volume4D

CELL_DEG: Final = 0.002
"""Size of a cell: 222 m of latitude."""
MAX_CELLS: Final = 1_024
"""A volume that covers more cells is in none of them, and compared with every query."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Overlap(NamedTuple):
    """One volume of a query and one that is claimed."""

    place: int
    """Which volume of the query."""
    intent: str
    """The intent that claims the other volume."""
    start_ns: Time
    end_ns: Time
    """When that is claimed."""


class Airspace:
    """Volumes of intents by cell of the ground; of those of a cell, boxes, heights and times are compared in arrays.

    Deep-copyable.
    """

    def __init__(self) -> None:
        self._rows: dict[str, list[int]] = {}
        self._owners: list[str] = []
        self._boxes = np.zeros((16, 4))
        self._heights = np.zeros((16, 2))
        self._times: Ints = np.zeros((16, 2), dtype=np.int64)
        self._outlines: NDArray[Any] = np.empty(16, dtype=object)
        self._free: list[int] = []
        self._cells: dict[tuple[int, int], dict[int, None]] = {}
        self._arrays: dict[tuple[int, int], Ints] = {}
        """Rows of cells that were looked at since they changed."""
        self._wide: dict[int, None] = {}

    def __len__(self) -> int:
        """The number of intents."""
        return len(self._rows)

    def __contains__(self, intent: str) -> bool:
        return intent in self._rows

    def put(self, intent: str, volumes: Sequence[Volume4D]) -> None:
        """Claim `volumes`, instead of those that the intent has claimed so far."""
        self.remove(intent)
        outlines, boxes = _shapes(volumes)
        rows = self._rows[intent] = []
        for volume, outline, box in zip(volumes, outlines, boxes, strict=True):
            row = self._free.pop() if self._free else self._grow()
            rows.append(row)
            self._owners[row] = intent
            self._boxes[row], self._outlines[row] = box, outline
            self._heights[row] = volume.lower_m, volume.upper_m
            self._times[row] = volume.start_ns, volume.end_ns
            self._add(row, box)

    def remove(self, intent: str) -> None:
        """Release the volumes of an intent, if it has any."""
        for row in self._rows.pop(intent, ()):
            self._free.append(row)
            cells = _cells_of(self._boxes[row])
            if cells is None:
                del self._wide[row]
                continue
            for cell in cells:
                rows = self._cells[cell]
                del rows[row]
                self._arrays.pop(cell, None)
                if not rows:
                    del self._cells[cell]

    def _add(self, row: int, box: Floats) -> None:
        cells = _cells_of(box)
        if cells is None:
            self._wide[row] = None
            return
        for cell in cells:
            self._cells.setdefault(cell, {})[row] = None
            self._arrays.pop(cell, None)

    def find_overlaps(self, volumes: Sequence[Volume4D], later_ns: Time = 0, ignored: str = "") -> list[Overlap]:
        """Every claimed volume that one of `volumes` overlaps, if it is flown at its time or up to `later_ns` later.

        Those of the intent `ignored` are left out. In the order of `volumes`, then of intents and times.
        """
        outlines, boxes = _shapes(volumes)
        near = [self._near(box) for box in boxes]
        heights = np.array([(one.lower_m, one.upper_m) for one in volumes])
        times = np.array([(one.start_ns, one.end_ns + later_ns) for one in volumes], dtype=np.int64)
        ends = np.cumsum(np.array([len(rows) for rows in near], dtype=np.int64))
        claimed = self._boxes, self._heights, self._times
        rows, places = _filter(np.concatenate(near), ends, *claimed, boxes, heights, times)
        met = np.flatnonzero(shapely.intersects(self._outlines[rows], outlines[places]))
        owners = self._owners
        found = {
            Overlap(place, owners[row], *self._times[row].tolist())
            for place, row in zip(places[met].tolist(), rows[met].tolist(), strict=True)
            if owners[row] != ignored
        }
        return sorted(found)

    def _near(self, box: Floats) -> Ints:
        """Rows that share a cell with a box, some of them several times, and those in no cell."""
        cells = _cells_of(box)
        if cells is None:
            return np.fromiter((row for each in self._rows.values() for row in each), dtype=np.int64)
        return np.concatenate([self._array(cell) for cell in cells if cell in self._cells] + [self._wide_rows()])

    def _array(self, cell: tuple[int, int]) -> Ints:
        array = self._arrays.get(cell)
        if array is None:
            rows = self._cells[cell]
            array = self._arrays[cell] = np.fromiter(rows, dtype=np.int64, count=len(rows))
        return array

    def _wide_rows(self) -> Ints:
        return np.fromiter(self._wide, dtype=np.int64, count=len(self._wide))

    def _grow(self) -> int:
        row = len(self._owners)
        self._owners.append("")
        if row == len(self._boxes):
            self._boxes = np.concatenate([self._boxes, np.zeros_like(self._boxes)])
            self._heights = np.concatenate([self._heights, np.zeros_like(self._heights)])
            self._times = np.concatenate([self._times, np.zeros_like(self._times)])
            self._outlines = np.concatenate([self._outlines, np.empty_like(self._outlines)])
        return row


@compiled
def _filter(
    near: Ints, ends: Ints, boxes: Floats, heights: Floats, times: Ints, asked: Floats, high: Floats, when: Ints
) -> tuple[Ints, Ints]:
    """The claimed volumes whose times, heights and boxes overlap those of a query: their rows, and its volumes.

    `near[ends[k - 1] : ends[k]]` are the rows to be compared with volume k. A row may come several times.
    """
    rows, places = np.empty(len(near), dtype=np.int64), np.empty(len(near), dtype=np.int64)
    count = begin = 0
    for place in range(len(ends)):
        for k in range(begin, ends[place]):
            row = near[k]
            if times[row, 0] >= when[place, 1] or times[row, 1] <= when[place, 0]:
                continue
            if heights[row, 0] >= high[place, 1] or heights[row, 1] <= high[place, 0]:
                continue
            if boxes[row, 0] > asked[place, 2] or boxes[row, 2] < asked[place, 0]:
                continue
            if boxes[row, 1] > asked[place, 3] or boxes[row, 3] < asked[place, 1]:
                continue
            rows[count], places[count] = row, place
            count += 1
        begin = ends[place]
    return rows[:count], places[:count]


def outlines_of(volumes: Sequence[Volume4D]) -> NDArray[Any]:
    """(n,) The outlines as polygons in longitude and latitude, degrees."""
    corners, counts = _corners(volumes)
    return np.asarray(shapely.polygons(shapely.linearrings(corners, indices=np.repeat(np.arange(len(counts)), counts))))


def _corners(volumes: Sequence[Volume4D]) -> tuple[Floats, list[int]]:
    """All corners (m, 2), longitude and latitude, and how many each volume has."""
    counts = [len(volume.outline) for volume in volumes]
    return np.array([corner for volume in volumes for corner in volume.outline])[:, ::-1], counts


def _shapes(volumes: Sequence[Volume4D]) -> tuple[NDArray[Any], Floats]:
    """(n,) outlines, and (n, 4) their least and greatest longitude and latitude."""
    corners, counts = _corners(volumes)
    outlines = outlines_of(volumes)
    crossed = ~shapely.is_valid(outlines)
    if crossed.any():
        outlines[crossed] = shapely.convex_hull(outlines[crossed])
    shapely.prepare(outlines)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    least, most = np.minimum.reduceat(corners, starts), np.maximum.reduceat(corners, starts)
    return outlines, np.concatenate([least, most], axis=1)


def _cells_of(box: Floats) -> list[tuple[int, int]] | None:
    """The cells that a box meets; `None` if they are too many."""
    west, south, east, north = (math.floor(degrees / CELL_DEG) for degrees in box.tolist())
    if (east - west + 1) * (north - south + 1) > MAX_CELLS:
        return None
    return [(x, y) for x in range(west, east + 1) for y in range(south, north + 1)]
