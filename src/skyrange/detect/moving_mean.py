"""Exponentially weighted moving means of one quantity at every link end."""

from __future__ import annotations

import numpy as np

from skyrange.contracts.frames import Ints
from skyrange.detect.series import Floats, grown, rounds


class MovingMean:
    """Means with the time constant `seconds`; they begin at `first`, or with the first value."""

    def __init__(self, seconds: float, first: float = np.nan) -> None:
        self._seconds, self._first = seconds, first
        self._means: Floats = np.zeros(0)

    def add(self, places: Ints, seconds: Floats, values: Floats) -> Floats:
        """Take in (n,) values, each `seconds` after the one before at its link end; returns the mean after each.

        Values of one end are in order of time. One that is not finite leaves the mean as it is, and NaN seconds count
        as none.
        """
        self._means = grown(self._means, int(places.max(initial=-1)) + 1, self._first)
        weights = -np.expm1(-np.maximum(np.nan_to_num(seconds), 0.0) / self._seconds)
        found = np.empty(len(places))
        for rows in rounds(places):
            at = places[rows]
            mean, value = self._means[at], values[rows]
            mean = np.where(np.isfinite(mean), mean, value)
            mean = np.where(np.isfinite(value), mean + weights[rows] * (value - mean), mean)
            self._means[at] = found[rows] = mean
        return found
