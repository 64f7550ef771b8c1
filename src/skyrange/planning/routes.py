"""Routes of flights: the quickest way over a city from place to place, within limits of height and clearance."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.planning.lattice import EXHAUSTED, NO_WAY, is_free, raise_field, search
from skyrange.planning.limits import AROUND_M, Costs, Limits, NoRouteError, Place
from skyrange.planning.sampling import Point3, Sampling, sample_leg

Floats = NDArray[np.float64]
MAX_STATES: Final = 40_000_000
MAX_EXPANDED: Final = 20_000_000
_DIAGONAL: Final = math.sqrt(0.5)
_ROUNDING: Final = 1e-6
"""Seconds or joules: by how much sums of costs may be off."""


def find_route(
    city: City | None, places: Sequence[Place], limits: Limits, sampling: Sampling | None = None
) -> list[Point3]:
    """The points of the cheapest way through `places` in their order, the first one included: east, north, up.

    It is searched on the lattice, or with `sampling` by BIT*. Turns are the corners of the way after shortcuts that
    keep the same clearance. Without a city the way is straight. Raises `NoRouteError`.
    """
    if city is None:
        return [(east, north, limits.alt_m) for east, north in places]
    points: list[Point3] = []
    for number, (start, end) in enumerate(pairwise(places), 1):
        name = f"leg {number}"
        if sampling is None:
            leg = _find_leg(city, start, end, limits, name)
        else:
            leg = sample_leg(city, start, end, limits, replace(sampling, seed=sampling.seed + number), name)
        points += leg if not points else leg[1:]
    return points


def _find_leg(city: City, from_place: Place, to_place: Place, limits: Limits, name: str) -> list[Point3]:
    walls, step = city.walls(), limits.step_m
    west, south = min(from_place[0], to_place[0]) - AROUND_M, min(from_place[1], to_place[1]) - AROUND_M
    columns = math.ceil((max(from_place[0], to_place[0]) + AROUND_M - west) / step) + 1
    rows = math.ceil((max(from_place[1], to_place[1]) + AROUND_M - south) / step) + 1
    layers = int((limits.ceiling_m - limits.alt_m) / limits.layer_m + 1e-9) + 1
    if columns * rows * layers > MAX_STATES:
        raise NoRouteError(f"{name} is too long for one search; give places between (via)")
    reach_m = limits.clearance_m + step * _DIAGONAL
    roofs = raise_field(walls, west, south, step, columns, rows, reach_m)
    heights = limits.alt_m + limits.layer_m * np.arange(layers, dtype=np.float64)

    def state_of(place: Place) -> int:
        return round((place[1] - south) / step) * columns + round((place[0] - west) / step)

    start, goal = state_of(from_place), state_of(to_place)
    for place, state, what in ((from_place, start, "begins"), (to_place, goal, "ends")):
        top = float(roofs.flat[state])
        if top > 0.0 and top + limits.clearance_m > limits.alt_m:
            raise NoRouteError(
                f"{name} {what} at ({place[0]:g}, {place[1]:g}) m, nearer than {limits.clearance_m:g} m to a building "
                f"{top:.0f} m high; it is free there above {top + limits.clearance_m:.0f} m"
            )
    margin, paces = limits.clearance_m, limits.costs.paces()
    done, states = search(roofs, step, heights, margin, start, goal, paces, MAX_EXPANDED)
    if done == EXHAUSTED:
        raise NoRouteError(f"{name} is too long for one search; give places between (via)")
    if done == NO_WAY:
        raise NoRouteError(_explain(city, roofs, from_place, to_place, ends=(start, goal), limits=limits, name=name))
    if len(states) == 1:  # both ends are nearest to one place of the lattice
        states = np.repeat(states, 2)
    plane = columns * rows
    rows_of, columns_of = states % plane // columns, states % columns
    points = np.column_stack([west + columns_of * step, south + rows_of * step, heights[states // plane]])
    points[0, :2], points[-1, :2] = from_place, to_place
    kept = _shorten(points, roofs, west, south, limits)
    return [(float(east), float(north), float(up)) for east, north, up in kept]


def _shorten(points: Floats, roofs: Floats, west: float, south: float, limits: Limits) -> Floats:
    """The points that are left when shortcuts at one height are taken, from each point a long one. In a wind a shortcut
    may cost more.
    """
    kept, spent = [0], _spend(points, limits.costs)
    while kept[-1] < len(points) - 1:
        at = kept[-1]
        level = at + 1
        while level + 1 < len(points) and points[level + 1, 2] == points[at, 2]:
            level += 1
        if points[level, 2] != points[at, 2]:  # a climb or a descent, on the spot
            while level + 1 < len(points) and (points[level + 1, :2] == points[at, :2]).all():
                level += 1
            kept.append(level)
            continue
        low, high = at + 1, level
        while high > low and not (
            is_free(roofs, west, south, limits.step_m, limits.clearance_m, points[at], points[high])
            and limits.costs.of(points[at], points[high]) <= spent[high] - spent[at] + _ROUNDING
        ):
            high = max(low, high - max(1, (high - low) // 8))
        kept.append(high)
    return np.asarray(points[kept])


def _spend(points: Floats, costs: Costs) -> Floats:
    """What the flight through all points has cost at each of them."""
    prices = [costs.of(start, end) for start, end in pairwise(points.tolist())]
    return np.concatenate([[0.0], np.cumsum(prices)])


def _explain(
    city: City, roofs: Floats, from_place: Place, to_place: Place, *, ends: tuple[int, int], limits: Limits, name: str
) -> str:
    """Who is in the way, and from which height on there is a way."""
    straight = [(*from_place, limits.alt_m), (*to_place, limits.alt_m)]
    building = city.first_obstruction(straight, limits.clearance_m)
    who = f"{building.name or building.id}, {building.height_m:g} m high, is in the way" if building else "no way"
    tops = np.unique(roofs[roofs + limits.clearance_m > limits.ceiling_m]).tolist()
    margin, step, paces = limits.clearance_m, limits.step_m, limits.costs.paces()

    def is_way(top: float) -> bool:
        heights = np.array([limits.alt_m, top + margin])
        done, _ = search(roofs, step, heights, margin, *ends, paces, MAX_EXPANDED)
        return done >= 0

    place = bisect_left(tops, x=True, key=is_way)  # what is free at one height is so above it
    if place < len(tops):
        below = f"there is no way below {limits.ceiling_m:g} m"
        return f"{name}: {who}, and {below}; there is one at {tops[place] + margin:.0f} m"
    return f"{name}: {who}, and there is no way at any height within {AROUND_M:g} m of its ends"
