"""What a route may be, and the error of one that there is not."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from skyrange.planning.costs import Costs

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
