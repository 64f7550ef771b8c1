"""Claimed airspace: the volumes of operational intents in a grid, and the search for overlaps.

Outlines are compared in the plane of longitude and latitude, in degrees, because F3548 states corners alone. Two
volumes overlap if their outlines meet and their heights and times have more than an end in common. A ring that crosses
itself counts as its convex hull; F3548 allows none. Convex rings, as those of legs are, are compared in compiled code;
others, and those that all but touch, by GEOS.
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
from skyrange.utm.convex import APART, MAX_CORNERS, MEETING, UNDECIDED, compare, is_convex

CELL_DEG: Final = 0.002
"""Size of a cell: 222 m of latitude."""
MAX_CELLS: Final = 1_024
"""A volume that covers more cells is in none of them, and compared with every query."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Outline = tuple[tuple[float, float], ...]


class Overlap(NamedTuple):
    """One volume of a query and one that is claimed."""

    place: int
    """Which volume of the query."""
    intent: str
    """The intent that claims the other volume."""
    start_ns: Time
    end_ns: Time
    """When that is claimed."""


class Query(NamedTuple):
    """A search for overlaps."""

    volumes: Sequence[Volume4D]
    later_ns: Time = 0
    """By how much later they may be flown."""


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
        self._rings = np.zeros((16, MAX_CORNERS, 2))
        self._counts: Ints = np.zeros(16, dtype=np.int64)
        """Corners of a convex ring; 0 for another one."""
        self._outlines: list[Outline] = []
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
        rings, counts, boxes = _shapes(volumes)
        rows = self._rows[intent] = []
        for place, (volume, box) in enumerate(zip(volumes, boxes, strict=True)):
            row = self._free.pop() if self._free else self._grow()
            rows.append(row)
            self._owners[row] = intent
            self._boxes[row], self._rings[row], self._counts[row] = box, rings[place], counts[place]
            self._outlines[row] = volume.outline
            self._heights[row] = volume.lower_m, volume.upper_m
            self._times[row] = volume.start_ns, volume.end_ns
            self._add(row, box)

    def remove(self, intent: str) -> None:
        """Release the volumes of an intent, if it has any."""
        for row in self._rows.pop(intent, ()):
            self._free.append(row)
            cells = _cells_of(self._boxes[row].tolist())
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
        cells = _cells_of(box.tolist())
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
        return self.find_each([Query(volumes, later_ns)], ignored)[0]

    def find_each(self, queries: Sequence[Query], ignored: str = "") -> list[list[Overlap]]:
        """What `find_overlaps` finds for each query, in one pass."""
        volumes = [volume for query in queries for volume in query.volumes]
        if not volumes:
            return [[] for _ in queries]
        rings, counts, boxes = _shapes(volumes)
        near, ends = self._near(boxes)
        heights = np.array([(one.lower_m, one.upper_m) for one in volumes])
        times = np.array(
            [(one.start_ns, one.end_ns + later) for query, later in queries for one in query], dtype=np.int64
        )
        claimed = self._boxes, self._heights, self._times, self._rings, self._counts
        rows, places, verdicts = _search(near, ends, *claimed, boxes, heights, times, rings, counts)
        owners, found = self._owners, set()
        for row, place, verdict in zip(rows.tolist(), places.tolist(), verdicts.tolist(), strict=True):
            if owners[row] != ignored and (verdict == MEETING or _meet(self._outlines[row], volumes[place].outline)):
                found.add((place, owners[row], *self._times[row].tolist()))
        answers: list[list[Overlap]] = []
        first = 0
        for query, _ in queries:
            last = first + len(query)
            own = sorted(one for one in found if first <= one[0] < last)
            answers.append([Overlap(place - first, *rest) for place, *rest in own])
            first = last
        return answers

    def _near(self, boxes: Floats) -> tuple[Ints, Ints]:
        """Rows that share a cell with each box, some of them several times, and those in no cell; and where those of
        each box end.
        """
        found: list[Ints] = []
        ends: list[int] = []
        count = 0
        for box in boxes.tolist():
            cells = _cells_of(box)
            if cells is None:
                arrays = [np.fromiter((row for each in self._rows.values() for row in each), dtype=np.int64)]
            else:
                arrays = [self._array(cell) for cell in cells if cell in self._cells]
                if self._wide:
                    arrays.append(np.fromiter(self._wide, dtype=np.int64, count=len(self._wide)))
            found += arrays
            count += sum(map(len, arrays))
            ends.append(count)
        near = np.concatenate(found) if found else np.empty(0, dtype=np.int64)
        return near, np.array(ends, dtype=np.int64)

    def _array(self, cell: tuple[int, int]) -> Ints:
        array = self._arrays.get(cell)
        if array is None:
            rows = self._cells[cell]
            array = self._arrays[cell] = np.fromiter(rows, dtype=np.int64, count=len(rows))
        return array

    def _grow(self) -> int:
        row = len(self._owners)
        self._owners.append("")
        self._outlines.append(())
        if row == len(self._boxes):
            self._boxes = _doubled(self._boxes)
            self._heights = _doubled(self._heights)
            self._times = _doubled(self._times)
            self._rings = _doubled(self._rings)
            self._counts = _doubled(self._counts)
        return row


def _doubled(array: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate([array, np.zeros_like(array)])


@compiled
def _search(
    near: Ints,
    ends: Ints,
    boxes: Floats,
    heights: Floats,
    times: Ints,
    rings: Floats,
    counts: Ints,
    asked: Floats,
    high: Floats,
    when: Ints,
    wanted: Floats,
    corners: Ints,
) -> tuple[Ints, Ints, Ints]:
    """The claimed volumes that a query overlaps, or may: their rows, its volumes, and verdicts of `convex.compare`.

    `near[ends[k - 1] : ends[k]]` are the rows to be compared with volume k. A row may come several times.
    """
    rows, places = np.empty(len(near), dtype=np.int64), np.empty(len(near), dtype=np.int64)
    verdicts = np.empty(len(near), dtype=np.int64)
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
            verdict = UNDECIDED
            if counts[row] > 0 and corners[place] > 0:
                verdict = compare(rings[row], counts[row], wanted[place], corners[place])
                if verdict == APART:
                    continue
            rows[count], places[count], verdicts[count] = row, place, verdict
            count += 1
        begin = ends[place]
    return rows[:count], places[:count], verdicts[:count]


def _meet(one: Outline, other: Outline) -> bool:
    """Whether two rings have a point in common, by GEOS."""
    return bool(_polygon(one).intersects(_polygon(other)))


def _polygon(outline: Outline) -> shapely.Geometry:
    polygon = shapely.Polygon([(lng, lat) for lat, lng in outline])
    return polygon if polygon.is_valid else polygon.convex_hull


def find_invalid(volumes: Sequence[Volume4D]) -> int | None:
    """The place of the first volume whose outline crosses itself or has no area; `None` if all are valid."""
    _, counts, _ = _shapes(volumes)
    for place in np.flatnonzero(counts == 0).tolist():
        if not shapely.Polygon(volumes[place].outline).is_valid:
            return int(place)
    return None


def _shapes(volumes: Sequence[Volume4D]) -> tuple[Floats, Ints, Floats]:
    """(n, `MAX_CORNERS`, 2) rings in longitude and latitude, (n,) corners of the convex ones, and 0 for the others; and
    (n, 4) their least and greatest longitude and latitude.
    """
    lengths = np.array([len(volume.outline) for volume in volumes], dtype=np.int64)
    corners = np.array([corner for volume in volumes for corner in volume.outline])[:, ::-1]
    return _gather(np.ascontiguousarray(corners), lengths)


@compiled
def _gather(corners: Floats, lengths: Ints) -> tuple[Floats, Ints, Floats]:
    rings = np.zeros((len(lengths), MAX_CORNERS, 2))
    counts = np.zeros(len(lengths), dtype=np.int64)
    boxes = np.empty((len(lengths), 4))
    first = 0
    for place in range(len(lengths)):
        ring = corners[first : first + lengths[place]]
        for axis in range(2):
            boxes[place, axis] = ring[:, axis].min()
            boxes[place, 2 + axis] = ring[:, axis].max()
        if lengths[place] <= MAX_CORNERS:
            rings[place, : lengths[place]] = ring
            if is_convex(ring, lengths[place]):
                counts[place] = lengths[place]
        first += lengths[place]
    return rings, counts, boxes


def _cells_of(box: Sequence[float]) -> list[tuple[int, int]] | None:
    """The cells that a box meets; `None` if they are too many."""
    west, south, east, north = (math.floor(degrees / CELL_DEG) for degrees in box)
    if (east - west + 1) * (north - south + 1) > MAX_CELLS:
        return None
    return [(x, y) for x in range(west, east + 1) for y in range(south, north + 1)]
