"""Truth as samples while a run flies, and the last seconds of it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import Time
from skyrange.metrics.time_series import Track
from skyrange.record.write.rows.ticks import TruthTick
from skyrange.view.stream.held import KEPT_NS
from skyrange.view.stream.positions import Grid, Layer, Samples
from skyrange.view.stream.tracks import find_noses

Floats = NDArray[np.float64]


class _Tick(NamedTuple):
    """Places (n, 3) and noses (n, 2) of all aircraft at one time; NaN for those that are absent."""

    time_ns: Time
    enu_m: Floats
    nose: Floats


class TruthWindow:
    """The true positions of the last seconds, sampled on a grid that begins with the first."""

    def __init__(self, places: Mapping[str, int], step_ns: Time) -> None:
        self._places = places
        self._step_ns = step_ns
        self._rows: tuple[Sequence[str], list[int]] = ((), [])
        self._ticks: list[_Tick] = []
        self._newest: dict[int, Time] = {}
        """By recorder."""
        self.start_ns: Time | None = None
        """The first time."""
        self._until_ns: Time | None = None

    def add(self, ticks: Iterable[TruthTick], recorder: int = 0) -> None:
        """Add ticks of one of the recorders, each of which records aircraft of its own, in order of time."""
        for tick in ticks:
            if self._rows[0] != tick.vehicles:
                self._rows = tick.vehicles, [self._places[vehicle] for vehicle in tick.vehicles]
            enu_m, nose = (np.full((len(self._places), width), np.nan) for width in (3, 2))
            enu_m[self._rows[1]] = np.stack([tick.columns[name] for name in ("east_m", "north_m", "up_m")], axis=1)
            nose[self._rows[1]] = find_noses(*(tick.columns[name] for name in ("qw", "qx", "qy", "qz")))
            self._insert(_Tick(tick.time_ns, enu_m, nose))
            self._newest[recorder] = tick.time_ns
            if self._until_ns is None:
                self.start_ns = self._ticks[0].time_ns

    def _insert(self, tick: _Tick) -> None:
        place = bisect_left(self._ticks, tick.time_ns, key=lambda other: other.time_ns)
        if place < len(self._ticks) and self._ticks[place].time_ns == tick.time_ns:
            known = np.isfinite(tick.enu_m).all(axis=1)
            self._ticks[place].enu_m[known], self._ticks[place].nose[known] = tick.enu_m[known], tick.nose[known]
        else:
            self._ticks.insert(place, tick)

    @property
    def newest_ns(self) -> Time | None:
        """The last time on the grid that is known of all recorders."""
        if self.start_ns is None:
            return None
        newest = min(self._newest.values())
        return newest - (newest - self.start_ns) % self._step_ns

    def take(self) -> Samples | None:
        """The samples since the last call, which begin with its last one; None if there is nothing new."""
        newest = self.newest_ns
        if newest is None or self.start_ns is None or newest == self._until_ns:
            return None
        first = self.start_ns if self._until_ns is None else self._until_ns
        self._until_ns = newest
        grid = Grid(first, self._step_ns, (newest - first) // self._step_ns + 1)
        times = np.array([tick.time_ns for tick in self._ticks])
        before = np.searchsorted(times, grid.times, side="right") - 1
        after = np.minimum(before + 1, len(times) - 1)
        share = (grid.times - times[before]) / np.maximum(times[after] - times[before], 1)
        enu_m = _between(np.stack([tick.enu_m for tick in self._ticks]), before, after, share)
        nose = _between(np.stack([tick.nose for tick in self._ticks]), before, after, share)
        kept_from = int(np.searchsorted(times, newest - KEPT_NS, side="right")) - 1
        self._ticks = self._ticks[max(min(kept_from, int(before[-1])), 0) :]
        rows = np.flatnonzero(np.isfinite(enu_m).any(axis=(0, 2)))
        if not len(rows):
            return None
        heading = np.arctan2(nose[:, rows, 0], nose[:, rows, 1]).T
        return Samples(0, Layer.TRUTH, grid, rows.tolist(), enu_m[:, rows].transpose(1, 2, 0), heading)

    def tracks(self, vehicles: Iterable[str]) -> dict[str, Track]:
        """Where some aircraft were in the last seconds."""
        found = {}
        for name in vehicles:
            place = self._places.get(name)
            known = [tick for tick in self._ticks if place is not None and np.isfinite(tick.enu_m[place]).all()]
            if known:
                places = np.stack([tick.enu_m[place] for tick in known])
                found[name] = Track(np.array([tick.time_ns for tick in known]), places, np.zeros(len(known)))
        return found


def _between(values: Floats, before: NDArray[np.int64], after: NDArray[np.int64], share: Floats) -> Floats:
    """(m, n, axes) values on the lines between rows of (k, n, axes), exact where there is nothing between."""
    part = share[:, None, None]
    found: Floats = np.where(part > 0.0, values[before] + (values[after] - values[before]) * part, values[before])
    return found
