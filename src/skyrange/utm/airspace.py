"""Claimed airspace: the volumes of operational intents in a grid, and the search for overlaps.

Outlines are compared in the plane of longitude and latitude, in degrees, because F3548 states corners alone. Two
volumes overlap if their outlines meet and their heights and times have more than an end in common. A ring that crosses
itself counts as its convex hull; F3548 allows none. Convex rings, as those of legs are, are compared in compiled code;
others, and those that all but touch, by GEOS.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.time import Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.cell_grid import MAX_WALKED, NONE, CellGrid, Lists, bucket_of, cells_of, count_cells
from skyrange.utm.convex import APART, MAX_CORNERS, MEETING, UNDECIDED, compare, is_convex

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


class _Solids(NamedTuple):
    """Volumes as arrays, row by row."""

    boxes: Floats
    """(n, 4) Least and greatest longitude and latitude; those of a free row meet nothing."""
    heights: Floats
    """(n, 2) Metres."""
    times: Ints
    """(n, 2) Nanoseconds."""
    rings: Floats
    """(n, `MAX_CORNERS`, 2) Corners in longitude and latitude."""
    counts: Ints
    """(n,) How many corners a convex ring has; 0 for another one."""


_NOWHERE: Final = (math.inf, math.inf, -math.inf, -math.inf)


class Airspace:
    """Volumes of intents by cell of the ground and of time; what is near a query is compared in compiled code.

    Deep-copyable.
    """

    def __init__(self) -> None:
        self._rows: dict[str, list[int]] = {}
        self._owners: list[str] = []
        self._outlines: list[Outline] = []
        self._solids = _make_solids(16)
        self._stamps: Ints = np.full(16, -1)
        """The number of the query volume with which a row was compared last."""
        self._asked = 0
        """How many query volumes there were."""
        self._free: list[int] = []
        self._grid = CellGrid()
        self._wide: dict[int, None] = {}
        """Rows that are in no cell."""

    def __len__(self) -> int:
        """The number of intents."""
        return len(self._rows)

    def __contains__(self, intent: str) -> bool:
        return intent in self._rows

    def put(self, intent: str, volumes: Sequence[Volume4D]) -> None:
        """Claim `volumes`, instead of those that the intent has claimed so far."""
        self.remove(intent)
        given = _solids_of(volumes)
        rows = self._rows[intent] = []
        for place, volume in enumerate(volumes):
            row = self._free.pop() if self._free else self._grow()
            rows.append(row)
            self._owners[row], self._outlines[row] = intent, volume.outline
            for own, new in zip(self._solids, given, strict=True):
                own[row] = new[place]
            if not self._grid.add(row, given.boxes[place], given.times[place]):
                self._wide[row] = None

    def remove(self, intent: str) -> None:
        """Release the volumes of an intent, if it has any."""
        for row in self._rows.pop(intent, ()):
            self._free.append(row)
            if row in self._wide:
                del self._wide[row]
            else:
                self._grid.remove(row, self._solids.boxes[row], self._solids.times[row])
            self._solids.boxes[row] = _NOWHERE

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
        asked = _solids_of(volumes)
        later = np.repeat([query.later_ns for query in queries], [len(query.volumes) for query in queries])
        asked.times[:, 1] += later
        wide = np.fromiter(self._wide, dtype=np.int64, count=len(self._wide))
        lists, first = self._grid.lists, self._asked
        self._asked += len(volumes)
        rows, places, verdicts = _search(self._solids, asked, lists, wide, self._stamps, first, len(self._owners))
        owners, times = self._owners, self._solids.times[rows].tolist()
        found: list[set[tuple[int, str, Time, Time]]] = [set() for _ in volumes]
        for row, place, verdict, (start, end) in zip(
            rows.tolist(), places.tolist(), verdicts.tolist(), times, strict=True
        ):
            if owners[row] != ignored and (verdict == MEETING or _meet(self._outlines[row], volumes[place].outline)):
                found[place].add((place, owners[row], start, end))
        answers: list[list[Overlap]] = []
        begin = 0
        for query, _ in queries:
            ends = begin + len(query)
            rows_found = [one for each in found[begin:ends] for one in sorted(each)]
            answers.append([Overlap(place - begin, intent, start, end) for place, intent, start, end in rows_found])
            begin = ends
        return answers

    def _grow(self) -> int:
        row = len(self._owners)
        self._owners.append("")
        self._outlines.append(())
        if row == len(self._stamps):
            more = _make_solids(row)
            self._solids = _Solids(*(np.concatenate(pair) for pair in zip(self._solids, more, strict=True)))
            self._stamps = np.concatenate([self._stamps, np.full(row, -1)])
        return row


def _make_solids(count: int) -> _Solids:
    """Rows that are free."""
    return _Solids(
        np.full((count, 4), _NOWHERE),
        np.zeros((count, 2)),
        np.zeros((count, 2), dtype=np.int64),
        np.zeros((count, MAX_CORNERS, 2)),
        np.zeros(count, dtype=np.int64),
    )


@compiled
def _search(
    claimed: _Solids, asked: _Solids, lists: Lists, wide: Ints, stamps: Ints, first: int, used: int
) -> tuple[Ints, Ints, Ints]:
    """The claimed volumes that those of `asked` overlap, or may: their rows, the places, and verdicts of
    `convex.compare`, each pair once.
    """
    boxes, heights, times, rings, counts = claimed  # a tuple of arrays that is passed on costs more than the comparison
    rows, places = np.empty(256, dtype=np.int64), np.empty(256, dtype=np.int64)
    verdicts = np.empty(256, dtype=np.int64)
    count = 0
    for place in range(len(asked.counts)):
        box, lowest, highest = asked.boxes[place], asked.heights[place, 0], asked.heights[place, 1]
        begins, ends = asked.times[place, 0], asked.times[place, 1]
        if count_cells(box, asked.times[place]) > MAX_WALKED:
            near = np.arange(used)
        else:
            near = np.concatenate((_rows_near(lists, box, asked.times[place], stamps, first + place), wide))
        for k in range(len(near)):
            row = near[k]
            if times[row, 0] >= ends or times[row, 1] <= begins:
                continue
            if heights[row, 0] >= highest or heights[row, 1] <= lowest:
                continue
            if boxes[row, 0] > box[2] or boxes[row, 2] < box[0] or boxes[row, 1] > box[3] or boxes[row, 3] < box[1]:
                continue
            verdict = UNDECIDED
            if counts[row] > 0 and asked.counts[place] > 0:
                verdict = compare(rings[row], counts[row], asked.rings[place], asked.counts[place])
                if verdict == APART:
                    continue
            if count == len(rows):
                rows, places = np.concatenate((rows, rows)), np.concatenate((places, places))
                verdicts = np.concatenate((verdicts, verdicts))
            rows[count], places[count], verdicts[count] = row, place, verdict
            count += 1
    return rows[:count], places[:count], verdicts[:count]


@compiled
def _rows_near(lists: Lists, box: Floats, times: Ints, stamps: Ints, stamp: int) -> Ints:
    """Rows in the cells of a box within its times, each once, and perhaps some of other cells."""
    found = np.empty(64, dtype=np.int64)
    count = 0
    west, south, begin, east, north, end = cells_of(box, times)
    for x in range(west, east + 1):
        for y in range(south, north + 1):
            for t in range(begin, end + 1):
                chunk = lists.heads[bucket_of(x, y, t)]
                while chunk != NONE:
                    for k in range(lists.fills[chunk]):
                        row = lists.rows[chunk, k]
                        if stamps[row] != stamp:
                            stamps[row] = stamp
                            if count == len(found):
                                found = np.concatenate((found, found))
                            found[count] = row
                            count += 1
                    chunk = lists.following[chunk]
    return found[:count]


def _meet(one: Outline, other: Outline) -> bool:
    """Whether two rings have a point in common, by GEOS."""
    return bool(_polygon(one).intersects(_polygon(other)))


def _polygon(outline: Outline) -> shapely.Geometry:
    polygon = shapely.Polygon([(lng, lat) for lat, lng in outline])
    return polygon if polygon.is_valid else polygon.convex_hull


def find_invalid(volumes: Sequence[Volume4D]) -> int | None:
    """The place of the first volume whose outline crosses itself or has no area; `None` if all are valid."""
    counts = _solids_of(volumes).counts
    for place in np.flatnonzero(counts == 0).tolist():
        if not shapely.Polygon(volumes[place].outline).is_valid:
            return int(place)
    return None


def _solids_of(volumes: Sequence[Volume4D]) -> _Solids:
    """Volumes, of which there is one at least, as arrays."""
    lengths = np.array([len(volume.outline) for volume in volumes], dtype=np.int64)
    corners = np.array([corner for volume in volumes for corner in volume.outline])[:, ::-1]
    rings, counts, boxes = _gather(np.ascontiguousarray(corners), lengths)
    heights = np.array([(one.lower_m, one.upper_m) for one in volumes])
    times = np.array([(one.start_ns, one.end_ns) for one in volumes], dtype=np.int64)
    return _Solids(boxes, heights, times, rings, counts)


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
