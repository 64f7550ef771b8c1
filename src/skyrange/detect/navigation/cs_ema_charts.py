"""CS-EMA charts: a CUSUM and an exponential moving average of the innovations of one sensor, at every link end.

The algorithm of `navigation.cs_ema`, which describes its source.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skyrange.contracts.frames import Ints
from skyrange.detect.bases.telemetry import MOST_SCORE
from skyrange.detect.series import Floats, grown, rounds


class Chart(NamedTuple):
    """The design of the charts of a sensor; all but `weight` in standard deviations of the innovation."""

    weight: float
    """λ, the weight of a new value in the moving average."""
    cap: float
    """R, the greatest absolute value that enters the moving average."""
    ema_limit: float
    """The control limit of the moving average; 0 leaves it out."""
    shift: float
    """b, the part of an absolute value that the CUSUM does not add."""
    cusum_limit: float
    """The control limit of the CUSUM; 0 leaves it out."""


class CsEma:
    """The charts of the axes of one sensor at every link end."""

    def __init__(self, chart: Chart, axes: int) -> None:
        self._chart = chart
        self._sums: Floats = np.zeros((0, axes))
        self._means: Floats = np.zeros((0, axes))

    def add(self, places: Ints, ratios: Floats) -> tuple[Floats, Floats]:
        """Take in innovations at link ends; returns the statistics after each, over their limits.

        `places` are (n,) link ends, and rows of one end are in order of time. `ratios` are (n, axes) finite
        innovations in standard deviations. Returns the CUSUM and the absolute moving average, (n, axes) each; 0 where
        the chart is left out.
        """
        chart, count = self._chart, int(places.max(initial=-1)) + 1
        self._sums, self._means = grown(self._sums, count), grown(self._means, count)
        sums, means = np.zeros(ratios.shape), np.zeros(ratios.shape)
        capped = np.clip(ratios, -chart.cap, chart.cap)
        excess = np.abs(ratios) - chart.shift
        for rows in rounds(places):
            at = places[rows]
            if chart.cusum_limit > 0.0:
                kept = np.clip(self._sums[at] + excess[rows] / chart.cusum_limit, 0.0, MOST_SCORE)
                self._sums[at] = sums[rows] = kept
            if chart.ema_limit > 0.0:
                self._means[at] = (1.0 - chart.weight) * self._means[at] + chart.weight * capped[rows]
                means[rows] = np.abs(self._means[at]) / chart.ema_limit
        return sums, means
