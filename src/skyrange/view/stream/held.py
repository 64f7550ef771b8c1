"""Reported positions as samples while a run flies: an aircraft stays where it was said to be until the next report."""

from __future__ import annotations

from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S, Time
from skyrange.view.stream.positions import Grid, Layer, Samples

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

KEPT_NS: Final = 10 * NS_PER_S
"""Reports that are recorded so much later than they were made still alter samples that were published before."""


class Reports(NamedTuple):
    """Positions that were reported."""

    time_ns: Ints
    """(n,)"""
    places: Ints
    """(n,) of the aircraft in the scene."""
    enu_m: Floats
    """(n, 3)"""

    @classmethod
    def join(cls, some: list[Reports]) -> Self:
        """Several in order of time."""
        none = Reports(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
        joined = cls(*(np.concatenate(columns) for columns in zip(none, *some, strict=True)))
        return joined.take(np.argsort(joined.time_ns, kind="stable"))

    def take(self, rows: Ints | NDArray[np.bool_]) -> Self:
        """Some of them."""
        return type(self)(self.time_ns[rows], self.places[rows], self.enu_m[rows])


class HeldPositions:
    """The last reported position of each aircraft, sampled on a grid from a first time on."""

    def __init__(self, layer: Layer, count: int, start_ns: Time, step_ns: Time) -> None:
        self._layer = layer
        self._step_ns = step_ns
        self._base_ns = start_ns
        self._places = np.full((count, 3), np.nan)
        """The newest position of each aircraft up to `_base_ns`; NaN for none."""
        self._heard_ns = np.zeros(count, dtype=np.int64)
        """When that was reported."""
        self._kept = Reports.join([])
        """Later reports that are in samples."""
        self._new: list[Reports] = []
        self._until_ns: Time | None = None
        """The last time that was sampled."""

    def add(self, reports: Reports) -> None:
        """Add reports."""
        self._new.append(reports)

    def take(self, until_ns: Time) -> Samples | None:
        """The samples since the last call, which begin with its last one, up to `until_ns`, which is on the grid;
        earlier ones again where reports of their time have come since. None if there is nothing new.
        """
        new = Reports.join(self._new)
        self._new = [new.take(new.time_ns > until_ns)]
        new = new.take(new.time_ns <= until_ns)
        first = self._base_ns if self._until_ns is None else self._until_ns
        if self._until_ns is not None and len(new.time_ns):
            steps = (int(new.time_ns[0]) - 1 - self._base_ns) // self._step_ns  # the last one that stays as it was
            first = min(first, self._base_ns + max(steps, 0) * self._step_ns)
        if until_ns < first or (until_ns == self._until_ns and not len(new.time_ns)):
            return None
        self._until_ns = until_ns
        self._kept = Reports.join([self._kept, new])
        samples = self._sample(Grid(first, self._step_ns, (until_ns - first) // self._step_ns + 1))
        self._forget(until_ns - KEPT_NS)
        return samples

    def _sample(self, grid: Grid) -> Samples | None:
        count = len(self._places)
        enu_m = np.full((count, grid.count, 3), np.nan)
        heard_ns = np.zeros((count, grid.count), dtype=np.int64)
        is_set = np.zeros((count, grid.count), dtype=np.bool_)
        is_set[:, 0] = np.isfinite(self._places).all(axis=1)
        enu_m[:, 0], heard_ns[:, 0] = self._places, self._heard_ns
        times, places, reported_m = self._kept
        column = np.maximum(-(-(times - grid.start_ns) // grid.step_ns), 0)
        enu_m[places, column] = reported_m  # of several in one cell, the last one stays
        heard_ns[places, column] = times
        is_set[places, column] = True
        last = np.maximum.accumulate(np.where(is_set, np.arange(grid.count), -1), axis=1)
        rows = np.flatnonzero(last[:, -1] >= 0)
        if not len(rows):
            return None
        known = np.maximum(last[rows], 0)
        enu_m = np.where(last[rows, :, None] >= 0, np.take_along_axis(enu_m[rows], known[:, :, None], axis=1), np.nan)
        age_s = (grid.times - np.take_along_axis(heard_ns[rows], known, axis=1)) / NS_PER_S
        shown = age_s if self._layer is Layer.STATION else None
        return Samples(0, self._layer, grid, rows.tolist(), enu_m.transpose(0, 2, 1), age_s=shown)

    def _forget(self, before_ns: Time) -> None:
        """Keep only the newest of reports that are too old to be altered."""
        steps = (before_ns - self._base_ns) // self._step_ns
        if steps <= 0:
            return
        self._base_ns += steps * self._step_ns
        old = self._kept.time_ns <= self._base_ns
        times, places, enu_m = self._kept.take(old)
        self._places[places], self._heard_ns[places] = enu_m, times
        self._kept = self._kept.take(~old)
