"""Paths and legs in metres east, north and up of home, with estimated durations.

Durations are estimates from ArduCopter's default speeds; airspace volumes add their own margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from skyrange.core import elementary_python

CLIMB_MPS = 2.5
"""ArduCopter WPNAV_SPEED_UP, default 250 cm/s (libraries/AC_WPNav/AC_WPNav.cpp)."""
DESCENT_MPS = 1.5
"""ArduCopter WPNAV_SPEED_DN, default 150 cm/s (libraries/AC_WPNav/AC_WPNav.cpp)."""
LAND_MPS = 0.5
"""ArduCopter LAND_SPEED, default 50 cm/s (ArduCopter/config.h), below `LAND_SLOW_M`."""
LAND_SLOW_M = 10.0
"""ArduCopter LAND_ALT_LOW, default 1000 cm."""
TURN_S = 2.0
"""Time lost by braking and accelerating at each point, for WPNAV_ACCEL's default of 2.5 m/s² and 5 m/s."""


class Point(NamedTuple):
    """A point in metres: east, north, up."""

    east_m: float
    north_m: float
    up_m: float


class Leg(NamedTuple):
    """One straight segment of a flight: its end points and how long it takes."""

    start: Point
    end: Point
    duration_s: float


def rectangle(east_m: float, north_m: float, alt_m: float, *, clockwise: bool = True) -> tuple[Point, ...]:
    """Five points around a rectangle whose south-west corner is home; the last point equals the first.

    Clockwise (seen from above) goes north first. The order is that of the published helper
    `create_rectangle_path` of uav-cyber-sim.
    """
    corners = [(0.0, 0.0), (0.0, north_m), (east_m, north_m), (east_m, 0.0), (0.0, 0.0)]
    return tuple(Point(east, north, alt_m) for east, north in (corners if clockwise else reversed(corners)))


def square(side_m: float, alt_m: float, *, clockwise: bool = True) -> tuple[Point, ...]:
    """Five points around a square whose south-west corner is home; the last point equals the first."""
    return rectangle(side_m, side_m, alt_m, clockwise=clockwise)


def leg(start: Point, end: Point, speed_mps: float, *, landing: bool = False) -> Leg:
    """The leg between two points. Horizontal and vertical motion overlap; the longer of the two times counts.

    With `landing`, the last `LAND_SLOW_M` metres of the descent are flown at `LAND_MPS`.
    """
    flat_s = elementary_python.hypot(end.east_m - start.east_m, end.north_m - start.north_m) / speed_mps
    rise_m = end.up_m - start.up_m
    if landing:
        slow_m = min(LAND_SLOW_M, max(-rise_m, 0.0))
        tall_s = slow_m / LAND_MPS + max(-rise_m - slow_m, 0.0) / DESCENT_MPS
    else:
        tall_s = rise_m / CLIMB_MPS if rise_m > 0 else -rise_m / DESCENT_MPS
    return Leg(start, end, max(flat_s, tall_s) + TURN_S)


def length_m(points: Sequence[Point]) -> float:
    """Length of the polyline through `points`, in metres."""
    total = 0.0
    for a, b in pairwise(points):
        total += elementary_python.distance(a, b)
    return total
