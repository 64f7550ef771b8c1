"""Triggers of attacks: conditions on truth, which the kernel evaluates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import Time


@dataclass(frozen=True, slots=True)
class Near:
    """Holds while a vehicle is within `within_m` of a place, or of another vehicle, measured in space.

    `vehicles` is the vehicle, and the other where there is one; `place_enu_m` stands for the other where there is none.
    """

    vehicles: Sequence[str]
    within_m: float
    place_enu_m: tuple[float, float, float] | None = None

    def holds(self, now: Time, truth: Mapping[str, NDArray[np.float64]], rows: Sequence[int]) -> bool:
        """Whether it is that near now."""
        columns = [truth[name] for name in ("east_m", "north_m", "up_m")]
        here = np.array([column[rows[0]] for column in columns])
        there = np.array(self.place_enu_m if self.place_enu_m is not None else [c[rows[1]] for c in columns])
        return float(((here - there) ** 2).sum()) <= self.within_m**2
