"""Simplification of tracks: keeps the samples without which the path or its timing would visibly change.

The method is top-down splitting (Douglas & Peucker, 1973) with the distance taken at equal time rather than at right
angles ("synchronised Euclidean distance", Meratnia & de By, EDBT 2004), so that an animation of the simplified track is
as accurate as its line. The segment with the largest error is split first, so a limited number of samples is spent
where it matters.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STRIDE_ABOVE = 8_000
"""Longer tracks are first reduced to this many evenly spaced rows, which bounds the computation."""


def select_samples(time_ns: Ints, values: Floats, budget: int, tolerance: float) -> Ints:
    """Row numbers of the samples to keep, in ascending order.

    `time_ns` (n,) is ascending, `values` (n, k) are in comparable units, and at most `budget` (≥ 2) rows are kept. If
    the budget suffices, no dropped sample is farther than `tolerance` (≥ 0, in the unit of `values`) from the
    simplified track at its own time.
    """
    count = int(time_ns.shape[0])
    if count <= 2:
        return np.arange(count)
    rows = np.unique(np.linspace(0, count - 1, min(count, STRIDE_ABOVE)).astype(np.int64))
    times = (time_ns[rows] - time_ns[rows[0]]).astype(np.float64)
    points = values[rows]
    kept: Ints = rows[_kept(times, points, budget, tolerance)]
    return kept


@compiled
def _kept(times: Floats, points: Floats, budget: int, tolerance: float) -> Ints:
    """Row numbers of at most `budget` samples to keep, in ascending order."""
    last = len(times) - 1
    keep = np.zeros(len(times), dtype=np.bool_)
    keep[0] = keep[last] = True
    count = 2
    heap = [_worst(times, points, 0, last)]
    while len(heap) > 0 and count < budget:
        worst, first, split, end = heapq.heappop(heap)
        if -worst <= tolerance:
            break
        keep[split] = True
        count += 1
        if split - first > 1:
            heapq.heappush(heap, _worst(times, points, first, split))
        if end - split > 1:
            heapq.heappush(heap, _worst(times, points, split, end))
    return np.nonzero(keep)[0].astype(np.int64)


@compiled
def _worst(times: Floats, points: Floats, first: int, last: int) -> tuple[float, int, int, int]:
    """The sample between two kept ones that is farthest from the line in time: (-distance, first, row, last)."""
    span = times[last] - times[first]
    worst, most = first + 1, -1.0
    for row in range(first + 1, last):
        part = (times[row] - times[first]) / span if span > 0.0 else 0.0
        squared = 0.0
        for column in range(points.shape[1]):
            off = points[row, column] - (points[first, column] + part * (points[last, column] - points[first, column]))
            squared += off * off
        if squared > most:
            worst, most = row, squared
    return -math.sqrt(most), first, worst, last
