"""Self-starting standardisation: values in standard deviations of the earlier values of the same link end.

After D. M. Hawkins, "Self-starting CUSUM Charts for Location and Scale", The Statistician 36 (1987), p. 299-315: mean
and deviation are those of all values so far, so that no flight for training is needed. Here values far outside do not
enter them, and old values are forgotten, so that a slow change of conditions raises no alert.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.contracts.frames import Ints
from skyrange.detect.series import Floats, grown, rounds

_LEAST: Final = 20
"""Values before which there is no result."""
_MOST: Final = 600
"""Values after which old ones are forgotten: 200 s at 3 Hz."""
_OUTSIDE: Final = 4.0
"""Standard deviations from which on a value does not enter the mean."""
_LARGEST: Final = 8.0
"""Greatest result, so that one value alone does not reach a threshold."""


class SelfStarting:
    """Mean and deviation of one quantity at every link end."""

    def __init__(self, floor: float) -> None:
        """`floor` is the least standard deviation, in units of the quantity."""
        self._floor = floor
        self._moments: Floats = np.zeros((0, 3))
        """Number, mean and variance of the values."""

    def standardise(self, places: Ints, values: Floats) -> Floats:
        """The (n,) deviations of new values at link ends from what was before them; 0 while too few are known.

        Values of one call are compared with those of earlier calls.
        """
        self._moments = grown(self._moments, int(places.max(initial=-1)) + 1)
        number, mean, variance = self._moments[places].T
        found = (values - mean) / np.maximum(np.sqrt(variance), self._floor)
        found = np.where(number >= _LEAST, np.minimum(found, _LARGEST), 0.0)
        inside = np.flatnonzero(np.abs(found) < _OUTSIDE)
        for rows in rounds(places[inside]):
            at = places[inside[rows]]
            number, mean, variance = self._moments[at].T
            number = np.minimum(number + 1.0, _MOST)
            away = values[inside[rows]] - mean
            mean = mean + away / number
            variance = variance + (away * (values[inside[rows]] - mean) - variance) / number
            self._moments[at] = np.column_stack([number, mean, np.maximum(variance, 0.0)])
        return found
