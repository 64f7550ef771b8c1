"""Triggers of attacks: conditions on the true state, which the kernel evaluates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementary_python
from skyrange.core.time import Time


@dataclass(frozen=True, slots=True)
class Near:
    """Holds while a vehicle is within `within_m` of a place or of another vehicle, in three dimensions.

    `vehicles` has the vehicle and the other vehicle, or the vehicle only if `place_enu_m` is given.
    """

    vehicles: Sequence[str]
    within_m: float
    place_enu_m: tuple[float, float, float] | None = None

    def holds(self, now: Time, truth: Mapping[str, NDArray[np.float64]], rows: Sequence[int]) -> bool:
        """Whether the condition holds now."""
        columns = [truth[name] for name in ("east_m", "north_m", "up_m")]
        here = np.array([column[rows[0]] for column in columns])
        there = np.array(self.place_enu_m if self.place_enu_m is not None else [c[rows[1]] for c in columns])
        return float(elementary_python.square(here - there).sum()) <= (self.within_m * self.within_m)
