"""Which samples of a track must a drawing keep? Those without which its path or its timing would visibly change.

Top-down splitting (Douglas & Peucker, 1973) with the distance taken at equal time rather than at right angles
("synchronised Euclidean distance", Meratnia & de By, EDBT 2004), so that an animation of the thinned track is
as true as its line. Splitting goes worst first, so a budget of samples is spent where it matters.
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STRIDE_ABOVE = 8_000
"""Longer tracks are first sampled down to this many evenly spaced rows, which bounds the work."""


def kept_rows(time_ns: Ints, values: Floats, budget: int, tolerance: float) -> Ints:
    """Ascending row numbers of the samples to keep.

    `time_ns` (n,) ascending; `values` (n, k) in comparable units; at most `budget` (≥ 2) rows. Where the budget
    suffices, no dropped sample is further than `tolerance` (the unit of `values`, ≥ 0) from the thinned track at
    its own time.
    """
    count = int(time_ns.shape[0])
    if count <= 2:
        return np.arange(count)
    rows = np.unique(np.linspace(0, count - 1, min(count, STRIDE_ABOVE)).astype(np.int64))
    times = (time_ns[rows] - time_ns[rows[0]]).astype(np.float64)
    points = values[rows]
    keep = [0, len(rows) - 1]
    heap: list[tuple[float, int, int, int]] = []
    _push(heap, times, points, 0, len(rows) - 1)
    while heap and len(keep) < budget:
        worst, first, split, last = heapq.heappop(heap)
        if -worst <= tolerance:
            break
        keep.append(split)
        _push(heap, times, points, first, split)
        _push(heap, times, points, split, last)
    return rows[np.sort(np.array(keep, dtype=np.int64))]


def _push(heap: list[tuple[float, int, int, int]], times: Floats, points: Floats, first: int, last: int) -> None:
    """Queue the stretch between two kept samples by its worst departure from the straight line in time."""
    if last - first < 2:
        return
    span = times[last] - times[first]
    part = ((times[first + 1 : last] - times[first]) / span if span > 0 else np.zeros(last - first - 1))[:, None]
    straight = points[first] + part * (points[last] - points[first])
    squared = ((points[first + 1 : last] - straight) ** 2).sum(axis=1)
    worst = int(np.argmax(squared))
    heapq.heappush(heap, (-float(np.sqrt(squared[worst])), first, first + 1 + worst, last))
