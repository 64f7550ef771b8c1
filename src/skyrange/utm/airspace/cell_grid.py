"""Rows by cell of the ground and of time, in arrays, so that compiled code adds, removes and walks them.

Cells share `BUCKETS` lists. Whoever walks one compares boxes anyway, so that rows of another cell do no harm. A list is
made of chunks of neighbouring numbers: a linked list of single rows takes six times as long to walk.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CELL_DEG: Final = 0.002
"""Size of a cell: 222 m of latitude."""
CELL_NS: Final = 600 * NS_PER_S
"""Duration of a cell; a leg takes less."""
MAX_CELLS: Final = 1_024
"""What covers more cells is in none of them."""
MAX_WALKED: Final = 16_384
"""A query that covers more cells is compared with every row."""
BUCKETS: Final = 16_384
CHUNK: Final = 32
NONE: Final = -1
_EAST: Final = 73_856_093
_NORTH: Final = 19_349_663
_TIME: Final = 83_492_791
"""Primes that spread cells over buckets (Teschner et al. 2003, Optimized Spatial Hashing, section 3)."""


class Lists(NamedTuple):
    """The rows of each bucket in chunks, of which all but the first are full."""

    heads: Ints
    """(`BUCKETS`,) The first chunk of each bucket."""
    rows: Ints
    """(n, `CHUNK`) Rows of each chunk."""
    fills: Ints
    """(n,) How many each chunk has."""
    following: Ints
    """(n,) The next chunk of the bucket; of a free chunk, the next free one."""


class CellGrid:
    """Rows by the cells of their boxes (west, south, east, north in degrees) and times (ns). Deep-copyable."""

    def __init__(self) -> None:
        self.lists = Lists(np.full(BUCKETS, NONE), *_make_chunks(16))
        self._free = NONE
        self._used = 0
        """Chunks that were ever used."""

    def add(self, row: int, box: Floats, times: Ints) -> bool:
        """Add a row that is not there; `False`, and nothing is done, if it covers too many cells."""
        count = count_cells(box, times)
        if count > MAX_CELLS:
            return False
        while len(self.lists.fills) - self._used < count:  # each cell takes one chunk at most
            pairs = zip(self.lists[1:], _make_chunks(len(self.lists.fills)), strict=True)
            self.lists = Lists(self.lists.heads, *(np.concatenate(pair) for pair in pairs))
        self._free, self._used = _add(self.lists, row, box, times, self._free, self._used)
        return True

    def remove(self, row: int, box: Floats, times: Ints) -> None:
        """Remove a row that was added with a box and times."""
        self._free = _remove(self.lists, row, box, times, self._free)


def _make_chunks(count: int) -> tuple[Ints, Ints, Ints]:
    return np.full((count, CHUNK), NONE), np.zeros(count, dtype=np.int64), np.full(count, NONE)


@compiled
def cells_of(box: Floats, times: Ints) -> tuple[int, int, int, int, int, int]:
    """The least cell to the east, north and in time, and the greatest."""
    return (
        math.floor(box[0] / CELL_DEG),
        math.floor(box[1] / CELL_DEG),
        times[0] // CELL_NS,
        math.floor(box[2] / CELL_DEG),
        math.floor(box[3] / CELL_DEG),
        times[1] // CELL_NS,
    )


@compiled
def count_cells(box: Floats, times: Ints) -> float:
    """How many cells a box meets within its times."""
    west, south, begin, east, north, end = cells_of(box, times)
    return float(east - west + 1) * float(north - south + 1) * float(end - begin + 1)


@compiled
def bucket_of(east: int, north: int, time: int) -> int:
    """The bucket of a cell."""
    return ((east * _EAST) ^ (north * _NORTH) ^ (time * _TIME)) & (BUCKETS - 1)


@compiled
def _add(lists: Lists, row: int, box: Floats, times: Ints, free: int, used: int) -> tuple[int, int]:
    """The first free chunk, and how many were ever used."""
    west, south, begin, east, north, end = cells_of(box, times)
    for x in range(west, east + 1):
        for y in range(south, north + 1):
            for t in range(begin, end + 1):
                bucket = bucket_of(x, y, t)
                head = lists.heads[bucket]
                if head == NONE or lists.fills[head] == CHUNK:
                    chunk = free
                    if chunk == NONE:
                        chunk = used
                        used += 1
                    else:
                        free = lists.following[chunk]
                    lists.following[chunk], lists.fills[chunk] = head, 0
                    lists.heads[bucket] = head = chunk
                lists.rows[head, lists.fills[head]] = row
                lists.fills[head] += 1
    return free, used


@compiled
def _remove(lists: Lists, row: int, box: Floats, times: Ints, free: int) -> int:
    """The first free chunk. The last row of the first chunk takes the place of the one that goes."""
    west, south, begin, east, north, end = cells_of(box, times)
    for x in range(west, east + 1):
        for y in range(south, north + 1):
            for t in range(begin, end + 1):
                bucket = bucket_of(x, y, t)
                head = lists.heads[bucket]
                chunk, place = head, 0
                while lists.rows[chunk, place] != row:
                    place += 1
                    if place == lists.fills[chunk]:
                        chunk, place = lists.following[chunk], 0
                lists.fills[head] -= 1
                lists.rows[chunk, place] = lists.rows[head, lists.fills[head]]
                if lists.fills[head] == 0:
                    lists.heads[bucket] = lists.following[head]
                    lists.following[head] = free
                    free = head
    return free
