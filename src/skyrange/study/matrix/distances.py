"""Distances of an attacked flight from its baseline over time: how large they get, and how fast they still grow."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.metrics.aircraft_measures import read_ticks
from skyrange.record.read.run import RunRecord

Floats = NDArray[np.float64]

GROWTH_NS: Final = 60_000_000_000
"""Growth is that of the last minute of the attack at most."""
LEAST_NS: Final = 20_000_000_000
"""Of an attack that acts for less than this no growth is measured: it is over before its effect is."""


class DistanceSeries(NamedTuple):
    """The distances of the aircraft of a run from their baselines; those of the ground come last and do not change."""

    time_ns: NDArray[np.int64]
    """(t,)"""
    away_m: Floats
    """(t, n)"""
    aloft: NDArray[np.bool_]
    """(t, n)"""


def measure_departures(attacked: RunRecord, baseline: RunRecord) -> DistanceSeries:
    """Distances from where each aircraft is at the same time in the baseline. Times of one run alone are left out."""
    mine, other = read_ticks(attacked), read_ticks(baseline)
    time_ns, here, there = np.intersect1d(mine.time_ns, other.time_ns, assume_unique=True, return_indices=True)
    away_m = np.sqrt(((mine.enu_m[here] - other.enu_m[there]) ** 2).sum(axis=2))
    return DistanceSeries(time_ns, away_m, mine.aloft[here])


def measure_straying(attacked: RunRecord, baseline: RunRecord) -> DistanceSeries:
    """Horizontal distances from the path that each aircraft flew in the baseline, whatever the time."""
    mine, other = read_ticks(attacked), read_ticks(baseline)
    away_m = np.zeros(mine.aloft.shape)
    for k in range(mine.enu_m.shape[1]):
        if len(other.time_ns) > 1:
            path = shapely.LineString(other.enu_m[:, k, :2])
            away_m[:, k] = shapely.distance(shapely.points(mine.enu_m[:, k, :2]), path)
    return DistanceSeries(mine.time_ns, away_m, mine.aloft)


def measure_growth(series: DistanceSeries, start_ns: int, stop_ns: int) -> float | None:
    """How much the largest distance of any aircraft still grew in the second half of an attack, or in its last minute
    if that is shorter, in metres a minute; `None` for an attack of less than 20 s.

    It ends with the attack or with the flight.
    """
    highest = np.maximum.accumulate(series.away_m, axis=0)
    found: list[float] = []
    for k in range(series.away_m.shape[1]):
        acting = np.flatnonzero(series.aloft[:, k] & (series.time_ns >= start_ns) & (series.time_ns <= stop_ns))
        begin_ns, end_ns = (int(series.time_ns[acting[place]]) for place in (0, -1)) if acting.size else (0, 0)
        if end_ns - begin_ns < LEAST_NS:
            continue
        since_ns = max(end_ns - GROWTH_NS, (begin_ns + end_ns) // 2)
        first, last = int(np.searchsorted(series.time_ns, since_ns)), int(acting[-1])
        span_min = (end_ns - int(series.time_ns[first])) / GROWTH_NS
        found.append(float(highest[last, k] - highest[first, k]) / span_min)
    return max(found, default=None)
