"""Distances of an attacked flight from its baseline over time: how large they get, and how fast they still grow."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.record.read.run import RunRecord
from skyrange.study.measures.aircraft_measures import read_ticks

Floats = NDArray[np.float64]

GROWTH_NS: Final = 60_000_000_000
"""Growth is that of the last minute of the attack."""


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


def measure_growth(series: DistanceSeries, start_ns: int, stop_ns: int) -> float:
    """How much the largest distance of any aircraft grew in the last minute of an attack, in metres a minute.

    It ends with the attack or with the flight. Of an attack of less than a minute it is that of its whole time.
    """
    highest = np.maximum.accumulate(series.away_m, axis=0)
    fastest = 0.0
    for k in range(series.away_m.shape[1]):
        acting = np.flatnonzero(series.aloft[:, k] & (series.time_ns >= start_ns) & (series.time_ns <= stop_ns))
        if acting.size < 2:
            continue
        last = int(acting[-1])
        since_ns = max(int(series.time_ns[last]) - GROWTH_NS, int(series.time_ns[acting[0]]))
        first = int(np.searchsorted(series.time_ns, since_ns))
        span_min = (int(series.time_ns[last]) - int(series.time_ns[first])) / GROWTH_NS
        if span_min > 0.0:
            fastest = max(fastest, float(highest[last, k] - highest[first, k]) / span_min)
    return fastest
