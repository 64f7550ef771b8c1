"""Limits of a route: what it may be, what a straight flight costs, and the error of a route that there is not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementary_python

CLIMB_MPS: Final = 2.5
SINK_MPS: Final = 1.5
"""ArduCopter's WPNAV_SPEED_UP and WPNAV_SPEED_DN."""
COMPASS: Final = tuple((north, east) for north in (-1, 0, 1) for east in (-1, 0, 1) if (north, east) != (0, 0))
"""The eight level moves of the lattice in their order: (rows, columns)."""
Power = Callable[[float, float, float], float]
"""Watts at a velocity through the air: east, north and up, in m/s."""


@dataclass(frozen=True, slots=True)
class Costs:
    """What a straight flight costs. Horizontal and vertical motion overlap; the longer of the two times counts."""

    speed_mps: float = 5.0
    """Ground speed."""
    wind_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the air: east, north, up."""
    power_w: Power | None = None
    """The cost is the energy that this power takes, in joules; without it the time in seconds."""

    def of(self, start: Sequence[float], end: Sequence[float]) -> float:
        """The cost of the flight from one point (east, north, up) to another one."""
        seconds = self.seconds(start, end)
        if self.power_w is None or seconds == 0.0:
            return seconds
        through = [(there - here) / seconds - wind for here, there, wind in zip(start, end, self.wind_mps, strict=True)]
        return seconds * self.power_w(through[0], through[1], through[2])

    def seconds(self, start: Sequence[float], end: Sequence[float]) -> float:
        """How long the flight takes."""
        rise_m = end[2] - start[2]
        tall_s = rise_m / CLIMB_MPS if rise_m > 0.0 else -rise_m / SINK_MPS
        return max(elementary_python.hypot(end[0] - start[0], end[1] - start[1]) / self.speed_mps, tall_s)

    def least(self, start: Sequence[float], end: Sequence[float]) -> float:
        """About what the flight costs at least, whatever way it takes: a descent in still air takes little power."""
        per_second = 1.0 if self.power_w is None else self.power_w(0.0, 0.0, -SINK_MPS)
        return per_second * self.seconds(start, end)

    def paces(self) -> NDArray[np.float64]:
        """(10,) How many metres one gets for a unit of cost by the level moves of `COMPASS`, up, and down."""
        if self.power_w is None:
            return np.array([self.speed_mps] * len(COMPASS) + [CLIMB_MPS, SINK_MPS])
        ways = [(east, north, 0.0) for north, east in COMPASS] + [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
        return np.array([elementary_python.hypot3(*move) / self.of((0.0, 0.0, 0.0), move) for move in ways])


Place = tuple[float, float]
"""East and north in metres."""

AROUND_M: Final = 250.0
"""How far around its places a route may lead."""


class NoRouteError(Exception):
    """There is no way; the message says what is in it, and from which height on there is one."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a route may be."""

    alt_m: float
    """Height above the ground at which it begins and ends, and that it keeps where it can."""
    ceiling_m: float
    """Greatest height above the ground."""
    clearance_m: float = 5.0
    """Least distance from walls and roofs."""
    step_m: float = 3.0
    """Distance of two places of the lattice. A gap narrower than two clearances and three of these may be missed."""
    layer_m: float = 5.0
    """Distance of two layers of height."""
    costs: Costs = field(default_factory=Costs)
    """What a way around costs, against a climb."""
