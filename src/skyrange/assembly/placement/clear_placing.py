"""Placing of missions: the nearest shift that keeps start and plan clear of walls and of other paths.

Start and plan move together, so a mission keeps its shape; a receiver on the ground moves out of a building. Places are
tried on a square lattice, nearest first; equal distances go by angle. Nothing depends on chance.

The airspace that paths take is kept in a spatial index: legs with their heights. Time is left out: two paths that share
a place are too near even if they are flown an hour apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.assembly.placement.flight_plans import make_flight_plan
from skyrange.city.city import City
from skyrange.core import elementary_python
from skyrange.core.errors import InputError, Problem
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.routes import enu_points
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.radio import Receiver
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.validation.error_messages import spell_path

APART_M = 10.0
"""Kept from other aircraft's paths seen from above…"""
RISE_M = 8.0
"""…or in height: several times what barometers of two aircraft may differ by."""

_Legs = tuple[NDArray[np.object_], NDArray[np.float64], NDArray[np.float64]]


class Airspace:
    """The paths placed so far."""

    def __init__(self) -> None:
        self._lines: list[Any] = []
        self._low_m: list[float] = []
        self._high_m: list[float] = []

    def add(self, path: Sequence[Point]) -> None:
        """Add a path, corner by corner in metres."""
        lines, low_m, high_m = _legs(path)
        self._lines += lines.tolist()
        self._low_m += low_m.tolist()
        self._high_m += high_m.tolist()

    def neighbours_of(self, path: Sequence[Point]) -> Neighbours:
        """What `path` must keep clear of, wherever it is shifted to at its heights."""
        lines = np.array(self._lines, dtype=object)
        low_m, high_m = np.array(self._low_m), np.array(self._high_m)
        indices = []
        for one_low_m, one_high_m in zip(*_legs(path)[1:], strict=True):
            level = (low_m < one_high_m + RISE_M) & (high_m > one_low_m - RISE_M)
            indices.append(shapely.STRtree(lines[level]))
        return Neighbours(indices, _ends(path))


class Neighbours:
    """For each leg of one path, the legs of others at its height."""

    def __init__(self, indices: Sequence[Any], ends: NDArray[np.float64]) -> None:
        self._indices = [(index, leg) for index, leg in zip(indices, ends, strict=True) if len(index)]

    def conflict(self, east_m: float, north_m: float) -> bool:
        """Whether the path, shifted so, comes within `APART_M` of one of them."""
        shift = (east_m, north_m)
        return any(
            index.query(_seen(leg + shift), predicate="dwithin", distance=APART_M).size for index, leg in self._indices
        )


def _seen(leg: NDArray[np.float64]) -> Any:
    """A leg from above: one straight up is a point, since GEOS finds no distance to a line without length."""
    return shapely.points(leg[0]) if (leg[0] == leg[1]).all() else shapely.linestrings(leg)


def _ends(path: Sequence[Point]) -> NDArray[np.float64]:
    """(legs, 2 ends, east and north); a path of one point is a leg without length."""
    pairs = list(pairwise(path)) or [(path[0], path[0])]
    return np.array([[a[:2], b[:2]] for a, b in pairs])


def _legs(path: Sequence[Point]) -> _Legs:
    """Each leg seen from above, and its least and greatest height."""
    pairs = list(pairwise(path)) or [(path[0], path[0])]
    heights_m = np.array([[a[2], b[2]] for a, b in pairs])
    lines = np.array([_seen(leg) for leg in _ends(path)], dtype=object)
    return lines, heights_m.min(axis=1), heights_m.max(axis=1)


MARGIN_M = 5.0
"""Kept from walls and roofs: an order above how far a multirotor strays from its path."""
STEP_M = 4.0
"""Spacing of the places tried: below the margin, so that no gap worth flying in is stepped over."""
REACH_M = 600.0
"""How far a mission may be shifted before it is no longer the same mission."""


def apply_placing(scenario: Scenario, city: City | None) -> Scenario:
    """The scenario with every `placing = "clear"` carried out: starts and receivers moved, placing exact.

    Vehicles are placed in order; each keeps clear of the exact ones' paths and of those placed before
    it, so that a shift makes no collision of its own. Raises InputError with a fault for each that finds
    no place or whose mission file is bad.
    """
    scenario = _receivers_placed(scenario, city)
    if all(vehicle.placing == "exact" for _, vehicle in scenario.fleet):
        return scenario
    datum = scenario.origin.datum
    fleets = [list(operator.vehicles) for operator in scenario.operators]
    order = [(o, v) for o, fleet in enumerate(fleets) for v, _ in enumerate(fleet)]
    order.sort(key=lambda place: fleets[place[0]][place[1]].placing == "clear")  # stable: the exact ones first
    taken = Airspace()
    problems: list[Problem] = []
    for o, v in order:
        vehicle = fleets[o][v]
        where = spell_path(("operators", o, "vehicles", v), scenario)
        try:
            path = enu_points(make_flight_plan(datum, vehicle))
        except InputError as error:
            problems += [Problem(f"{where}.plan.file: {f.where}", f.value, f.expected, f.hint) for f in error.problems]
            continue
        if vehicle.placing == "clear":
            shift = find_clear_shift(city, path, taken)
            if shift is None:
                problems.append(_no_place(where, path[0]))
                continue
            fleets[o][v] = _shifted(vehicle, shift)
            path = tuple(Point(east + shift[0], north + shift[1], up) for east, north, up in path)
        taken.add(path)
    if problems:
        raise InputError("scenario", problems)
    operators = tuple(
        operator.model_copy(update={"vehicles": tuple(fleet)})
        for operator, fleet in zip(scenario.operators, fleets, strict=True)
    )
    return scenario.model_copy(update={"operators": operators})


def find_clear_shift(
    city: City | None,
    path: Sequence[Point],
    taken: Airspace | None = None,
    *,
    margin_m: float = MARGIN_M,
) -> tuple[float, float] | None:
    """The least (east_m, north_m) by which to shift `path` to a place that is free.

    `path` is a flight's corners in metres, its first point the start. Free is a place where no building
    is within `margin_m` of the path and nothing of the airspace `taken` is near it. None if nothing within
    `REACH_M` will do.
    """
    others = None if taken is None else taken.neighbours_of(path)
    for east_m, north_m in _lattice():
        moved = [Point(e + east_m, n + north_m, up) for e, n, up in path]
        if city is not None and city.obstacles_within(moved[0].east_m, moved[0].north_m, margin_m):
            continue  # the cheap question first
        if others is not None and others.conflict(east_m, north_m):
            continue
        if city is None or city.is_clear(moved, margin_m):
            return east_m, north_m
    return None


def _shifted(vehicle: Vehicle, shift: tuple[float, float]) -> Vehicle:
    start = vehicle.start
    moved = start.model_copy(update={"east_m": start.east_m + shift[0], "north_m": start.north_m + shift[1]})
    return vehicle.model_copy(update={"start": moved, "placing": "exact"})


def _receivers_placed(scenario: Scenario, city: City | None) -> Scenario:
    """The scenario with its receivers outside buildings. Raises InputError for those that find no place."""
    radio = scenario.radio
    if radio is None or all(receiver.placing == "exact" for receiver in radio.receivers):
        return scenario
    placed = [_outside(receiver, city) for receiver in radio.receivers]
    problems = [
        Problem(
            f"radio.receivers.{index}.placing",
            f"clear, from {list(receiver.place)} m",
            f"a place within {REACH_M:g} m that is in no building",
            "Put it higher up, or elsewhere.",
        )
        for index, receiver in enumerate(radio.receivers)
        if placed[index] is None
    ]
    if problems:
        raise InputError("scenario", problems)
    receivers = tuple(receiver for receiver in placed if receiver is not None)
    return scenario.model_copy(update={"radio": radio.model_copy(update={"receivers": receivers})})


def _outside(receiver: Receiver, city: City | None) -> Receiver | None:
    """A receiver at the nearest place that is in no building; None if there is none within reach."""
    if receiver.placing == "exact":
        return receiver
    east_m, north_m, up_m = receiver.place
    for shift in _lattice():
        place = (east_m + shift[0], north_m + shift[1], up_m)
        if city is None or city.inside(*place) is None:
            return receiver.model_copy(update={"place": place, "placing": "exact"})
    return None


def _no_place(where: str, start: Point) -> Problem:
    return Problem(
        f"{where}.placing",
        f"clear, from ({start.east_m:g}, {start.north_m:g}) m",
        f"a place within {REACH_M:g} m where start and plan keep {MARGIN_M:g} m from buildings",
        "Fly higher or smaller, or start elsewhere.",
    )


@cache
def _lattice() -> tuple[tuple[float, float], ...]:
    """Shifts within reach by distance, then by angle from east: 70,000 of them, made once."""
    count = int(REACH_M / STEP_M)
    steps = [
        (i, j) for i in range(-count, count + 1) for j in range(-count, count + 1) if i * i + j * j <= count * count
    ]
    steps.sort(key=lambda step: ((step[0] * step[0]) + (step[1] * step[1]), elementary_python.atan2(step[1], step[0])))
    return tuple((i * STEP_M, j * STEP_M) for i, j in steps)
