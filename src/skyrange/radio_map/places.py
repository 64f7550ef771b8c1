"""Places of a radio map: its area, the grid of receivers, and the transmitters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.core.errors import InputError, Problem
from skyrange.radio.propagation.loss_table import LossGrid

MAX_TRANSMITTERS: Final = 400
"""Most transmitters of one map: half an hour to an hour of tracing on two cores."""
MAX_RECEIVERS: Final = 500_000
REACH_OF_SPACING: Final = 0.75
"""Reach of a place as a share of the spacing of the transmitters: a little more than half of a square's diagonal."""

Area = tuple[float, float, float, float]
"""West, south, east and north edge in metres."""


@dataclass(frozen=True, slots=True)
class MapLayout:
    """What a map covers. Lengths are metres; heights are above the ground."""

    area: Area
    spacing_m: float = 10.0
    """Spacing of the receivers."""
    heights_m: tuple[float, ...] = (1.5, 30.0, 60.0, 90.0, 120.0)
    """Heights of the receivers: a person's hand, and aircraft up to the 120 m of most rules."""
    transmitter_spacing_m: float = 100.0
    transmitter_heights_m: tuple[float, ...] = (60.0,)
    reach_up_m: float = 15.0
    """Vertical reach of a transmitter place."""

    @property
    def reach_m(self) -> float:
        """Horizontal reach of a transmitter place."""
        return REACH_OF_SPACING * self.transmitter_spacing_m

    @property
    def grid(self) -> LossGrid:
        """The grid of receivers: points in the middle of squares that fill the area."""
        west, south, east, north = self.area
        columns, rows = (max(1, math.ceil(round(w / self.spacing_m, 6))) for w in (east - west, north - south))
        first_east = 0.5 * (west + east) - 0.5 * (columns - 1) * self.spacing_m
        first_north = 0.5 * (south + north) - 0.5 * (rows - 1) * self.spacing_m
        return LossGrid(first_east, first_north, self.spacing_m, columns, rows, self.heights_m)

    def check(self) -> None:
        """Raise one `InputError` with everything that is wrong."""
        west, south, east, north = self.area
        problems = []
        if not (all(map(math.isfinite, self.area)) and west < east and south < north):
            problems.append(Problem("area", repr(list(self.area)), "[west, south, east, north] in metres"))
        for name, value in (("spacing", self.spacing_m), ("transmitter spacing", self.transmitter_spacing_m)):
            if not 1.0 <= value <= 10_000.0:
                problems.append(Problem(name, f"{value:g}", "1 to 10000 m"))
        for name, heights in (("heights", self.heights_m), ("transmitter heights", self.transmitter_heights_m)):
            rising = all(low < high for low, high in pairwise(heights))
            if not rising or not all(0.5 <= height <= 1_000.0 for height in heights):
                problems.append(Problem(name, repr(list(heights)), "ascending heights from 0.5 to 1000 m"))
        if not 1 <= len(self.heights_m) <= 20:
            problems.append(Problem("heights", f"{len(self.heights_m)} heights", "1 to 20 of them"))
        if not problems and math.prod(self.grid.shape) > MAX_RECEIVERS:
            hint = "Take a wider spacing, fewer heights or a smaller area."
            problems.append(Problem("receivers", f"{math.prod(self.grid.shape):,}", f"at most {MAX_RECEIVERS:,}", hint))
        if problems:
            raise InputError("radio map", problems)


def transmitter_places(
    layout: MapLayout, city: City, fixed: Sequence[tuple[float, float, float]]
) -> NDArray[np.float64]:
    """(t, 3) places: the fixed radios, then a grid over the area, without those inside buildings.

    Raises `InputError` if there are none or too many of them.
    """
    west, south, east, north = layout.area
    step = layout.transmitter_spacing_m
    places = list(dict.fromkeys(fixed))
    for up in layout.transmitter_heights_m:
        for y in _centred(south, north, step):
            places += [(x, y, up) for x in _centred(west, east, step)]
    if len(places) > 50 * MAX_TRANSMITTERS:
        raise _too_many(len(places))
    free = [place for place in places if city.inside(*place) is None]
    if len(free) > MAX_TRANSMITTERS:
        raise _too_many(len(free))
    if not free:
        expected = "at least one transmitter outside buildings"
        raise InputError.one("radio map", "transmitters", "none", expected, "Add heights above the roofs.")
    return np.array(free, dtype=np.float64)


def _centred(low: float, high: float, step: float) -> list[float]:
    count = max(1, int((high - low) / step + 1e-6))
    first = 0.5 * (low + high) - 0.5 * (count - 1) * step
    return [first + k * step for k in range(count)]


def _too_many(count: int) -> InputError:
    hint = "Take a wider --transmitter-spacing, fewer --transmitter-heights or a smaller --area."
    return InputError.one("radio map", "transmitters", f"{count:,}", f"at most {MAX_TRANSMITTERS}", hint)


def is_outside(city: City, grid: LossGrid) -> NDArray[np.bool_]:
    """(heights, rows, columns): whether each point of a grid is outside buildings."""
    points = grid.points_enu_m.reshape(-1, 3).tolist()
    return np.array([city.inside(*point) is None for point in points]).reshape(grid.shape)
