"""Claimed airspace: the volumes of operational intents in a grid, the search for overlaps, and for the least delay.

Two volumes overlap if their outlines meet and their heights and times have more than an end in common. While a flight
is delayed, each volume that its own ones meet forbids an interval of delays; the first delay that none forbids is free.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.geodesy import unwrap_outline
from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.airspace.cell_grid import MAX_WALKED, NONE, CellGrid, Lists, bucket_of, cells_of, count_cells
from skyrange.utm.airspace.solids import (
    APART,
    NOWHERE,
    UNDECIDED,
    Outline,
    Solids,
    compare,
    find_meeting,
    make_solids,
    solids_of,
    turned,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STEP_NS: Final = NS_PER_S
"""Delays are whole seconds."""
ANY_RANK: Final = -(1 << 62)
MAX_RANK: Final = 1 << 62


class Overlap(NamedTuple):
    """One volume of a query, and an intent that claims a volume which it overlaps."""

    place: int
    """Which volume of the query."""
    intent: str


class Query(NamedTuple):
    """A search for the least delay."""

    volumes: Sequence[Volume4D]
    most_ns: Time
    """The longest delay."""


class Airspace:
    """Volumes of intents by cell of the ground and of time; what is near a query is compared in compiled code.

    Deep-copyable.
    """

    def __init__(self) -> None:
        self._rows: dict[str, list[int]] = {}
        self._owners: list[str] = []
        self._outlines: list[Outline] = []
        self._solids = make_solids(16)
        self._claims = np.zeros((16, 2), dtype=np.int64)
        """Of each row, the first row of its intent, and the rank of that."""
        self._stamps: Ints = np.full(16, -1)
        """The number of the query volume with which a row was compared last."""
        self._asked = 0
        """How many query volumes there were."""
        self._free: list[int] = []
        self._grid = CellGrid()
        self._wide: dict[int, None] = {}
        """Rows that are in no cell."""
        self._east_deg = 180.0
        """The greatest longitude that was ever claimed; more than 180 where a ring crosses the date line."""

    def __len__(self) -> int:
        """The number of intents."""
        return len(self._rows)

    def __contains__(self, intent: str) -> bool:
        return intent in self._rows

    def put(self, intent: str, volumes: Sequence[Volume4D], rank: int = 0) -> None:
        """Claim `volumes`, instead of those that the intent has claimed so far. `rank`, between `ANY_RANK` and
        `MAX_RANK`, says which searches regard it.
        """
        self.remove(intent)
        given = solids_of(volumes)
        self._east_deg = max(self._east_deg, float(given.boxes[:, 2].max()))
        rows = self._rows[intent] = []
        for place, volume in enumerate(volumes):
            row = self._free.pop() if self._free else self._grow()
            rows.append(row)
            self._owners[row], self._outlines[row] = intent, unwrap_outline(volume.outline)
            self._claims[row] = rows[0], rank
            for column, new in zip(self._solids, given, strict=True):
                column[row] = new[place]
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
            self._solids.boxes[row] = NOWHERE

    def find_overlaps(self, volumes: Sequence[Volume4D], ignored: str = "") -> list[Overlap]:
        """Each of `volumes` with each intent but `ignored` that claims what it overlaps, in order."""
        if not volumes:
            return []
        rows, places = self._search(volumes, solids_of(volumes), ignored, ANY_RANK)
        pairs = {*zip(places.tolist(), self._claims[rows, 0].tolist(), strict=True)}
        return sorted(Overlap(place, self._owners[first]) for place, first in pairs)

    def find_least_delays(
        self, queries: Sequence[Query], ignored: str = "", lowest_rank: int = ANY_RANK
    ) -> list[Time | None]:
        """For each query the least delay in whole seconds, 0 included, after which its volumes overlap none of another
        intent than `ignored` that has `lowest_rank` or more; `None` if that exceeds its longest delay.
        """
        volumes = [volume for query in queries for volume in query.volumes]
        if not volumes:
            return [0 for _ in queries]
        numbers = np.repeat(np.arange(len(queries)), [len(query.volumes) for query in queries])
        most = np.array([query.most_ns for query in queries], dtype=np.int64)
        queried = solids_of(volumes)
        ends = queried.times[:, 1].copy()
        queried.times[:, 1] += most[numbers]
        rows, places = self._search(volumes, queried, ignored, lowest_rank)
        claimed = self._solids.times[rows]
        begins, over = claimed[:, 0] - ends[places], claimed[:, 1] - queried.times[places, 0]
        delays = _sweep(numbers[places], begins, over, len(queries)).tolist()
        return [delay if delay <= query.most_ns else None for delay, query in zip(delays, queries, strict=True)]

    def _search(
        self, volumes: Sequence[Volume4D], queried: Solids, ignored: str, lowest_rank: int
    ) -> tuple[Ints, Ints]:
        """Rows and places of claimed volumes and those of a query that overlap, each pair once."""
        every, turns = np.arange(len(volumes)), np.zeros(len(volumes))
        # what crosses the date line, or is west of it while claims cross it, is also where it is by a turn less or more
        across = [(np.flatnonzero(queried.boxes[:, 2] >= 180.0), -360.0)]
        across.append((np.flatnonzero(queried.boxes[:, 0] + 360.0 <= self._east_deg), 360.0))
        for some, turn in across:
            if len(some):
                pairs: Any = zip(queried, turned(queried, some, turn), strict=True)
                queried = Solids(*map(np.concatenate, pairs))
                every, turns = np.concatenate([every, some]), np.concatenate([turns, np.full(len(some), turn)])
        wide = np.fromiter(self._wide, dtype=np.int64, count=len(self._wide))
        lists, first = self._grid.lists, self._asked
        self._asked += len(every)
        left_out = self._rows[ignored][0] if ignored in self._rows else NONE
        rows, places, verdicts = _search(
            self._solids,
            self._claims,
            queried,
            lists,
            wide,
            self._stamps,
            first,
            len(self._owners),
            left_out,
            lowest_rank,
        )
        near = np.flatnonzero(verdicts == UNDECIDED)
        if len(near):
            doubtful = np.column_stack((rows[near], places[near]))
            meeting = verdicts != UNDECIDED
            outlines = [
                tuple((lat, lng + turn) for lat, lng in unwrap_outline(volumes[place].outline))
                for place, turn in zip(every.tolist(), turns.tolist(), strict=True)
            ]
            meeting[near] = find_meeting(self._outlines, outlines, doubtful)
            rows, places = rows[meeting], places[meeting]
        return rows, every[places]

    def _grow(self) -> int:
        row = len(self._owners)
        self._owners.append("")
        self._outlines.append(())
        if row == len(self._stamps):
            more = make_solids(row)
            self._solids = Solids(*(np.concatenate(pair) for pair in zip(self._solids, more, strict=True)))
            self._claims = np.concatenate([self._claims, np.zeros_like(self._claims)])
            self._stamps = np.concatenate([self._stamps, np.full(row, -1)])
        return row


@compiled
def _search(  # noqa: PLR0917
    claimed: Solids,
    claims: Ints,
    queried: Solids,
    lists: Lists,
    wide: Ints,
    stamps: Ints,
    first: int,
    used: int,
    left_out: int,
    lowest_rank: int,
) -> tuple[Ints, Ints, Ints]:
    """The claimed volumes that those of `queried` overlap, or may: their rows, the places, and verdicts of
    `convex.compare`, each pair once.
    """
    boxes, heights, times, rings, counts = claimed  # a tuple of arrays that is passed on costs more than the comparison
    rows, places = np.empty(256, dtype=np.int64), np.empty(256, dtype=np.int64)
    verdicts = np.empty(256, dtype=np.int64)
    count = 0
    for place in range(len(queried.counts)):
        box, lowest, highest = queried.boxes[place], queried.heights[place, 0], queried.heights[place, 1]
        begins, ends = queried.times[place, 0], queried.times[place, 1]
        if count_cells(box, queried.times[place]) > MAX_WALKED:
            near = np.arange(used)
        else:
            near = np.concatenate((_rows_near(lists, box, queried.times[place], stamps, first + place), wide))
        for k in range(len(near)):
            row = near[k]
            if times[row, 0] >= ends or times[row, 1] <= begins:
                continue
            if heights[row, 0] >= highest or heights[row, 1] <= lowest:
                continue
            if boxes[row, 0] > box[2] or boxes[row, 2] < box[0] or boxes[row, 1] > box[3] or boxes[row, 3] < box[1]:
                continue
            if claims[row, 0] == left_out or claims[row, 1] < lowest_rank:
                continue
            verdict = UNDECIDED
            if counts[row] > 0 and queried.counts[place] > 0:
                verdict = compare(rings[row], counts[row], queried.rings[place], queried.counts[place])
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
    rows = np.empty(64, dtype=np.int64)
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
                            if count == len(rows):
                                rows = np.concatenate((rows, rows))
                            rows[count] = row
                            count += 1
                    chunk = lists.following[chunk]
    return rows[:count]


@compiled
def _sweep(numbers: Ints, begins: Ints, ends: Ints, count: int) -> Ints:
    """The least delay of each of `count` flights that is in none of the intervals of delays, ends excluded, that are
    forbidden to it; `numbers` says to which flight each is.
    """
    delays = np.zeros(count, dtype=np.int64)
    for k in np.argsort(begins):
        delay = delays[numbers[k]]
        if begins[k] < delay < ends[k]:
            delays[numbers[k]] = -(-ends[k] // STEP_NS) * STEP_NS
    return delays
