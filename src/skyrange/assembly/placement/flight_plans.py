"""Flight plans of ground stations, made from a vehicle's plan at the place where it starts."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from functools import partial
from pathlib import Path

from skyrange.codec.mission.fence_and_rally import Items, circle, polygon, rally_point
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import vehicle_id
from skyrange.gcs.plan import paths, plans
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.scenario import Scenario


def make_flight_plans(scenario: Scenario, of: Container[str] | None = None) -> dict[str, FlightPlan | InputError]:
    """The flight plan of each vehicle by its id, or why it cannot be made; with `of` of these vehicles only."""
    made: dict[str, FlightPlan | InputError] = {}
    for operator, vehicle in scenario.fleet:
        name = vehicle_id(operator.id, vehicle.id)
        if of is None or name in of:
            try:
                made[name] = make_flight_plan(scenario.origin.datum, vehicle)
            except InputError as error:
                made[name] = error
    return made


def make_flight_plan(origin: Origin, vehicle: Vehicle) -> FlightPlan:
    """The flight plan of `vehicle`, anchored at its start. Raises InputError for a mission file that cannot be read,
    or that has a fence or rally points where the scenario has some too.
    """
    made = _make_flight_plan(origin, vehicle)
    fence, rally = _make_fence(origin, vehicle), _make_rally(origin, vehicle)
    for name, declared, own in (("fence", fence, made.fence), ("rally", rally, made.rally)):
        if declared and own:
            problem = f"{len(own)} items in the file, {len(declared)} in the scenario"
            raise InputError.one(made.name, name, problem, f"one {name}, of the plan file or of the scenario")
    return replace(made, fence=fence or made.fence, rally=rally or made.rally)


def _make_flight_plan(origin: Origin, vehicle: Vehicle) -> FlightPlan:
    plan = vehicle.plan
    home_enu_m = (vehicle.start.east_m, vehicle.start.north_m, 0.0)
    if plan.file is not None:
        return plans.from_file(origin, home_enu_m, plan.file, anchor=plan.anchor == "start")
    if plan.square is not None:
        points = paths.square(plan.square.side_m, plan.square.alt_m)
    else:
        assert plan.path is not None  # the model allows exactly one of the three
        points = tuple(paths.Point(*point) for point in plan.path.points_enu_m)
    return plans.path(
        origin,
        home_enu_m,
        points,
        kind=plan.mode,
        cruise_mps=plan.speed_mps or plans.CRUISE_MPS,
        end=plan.end or "rtl",
        name=name_flight_plan(vehicle),
    )


def _make_fence(origin: Origin, vehicle: Vehicle) -> Items:
    """The items of the fence that the scenario declares."""
    fence = vehicle.plan.fence
    if fence is None:
        return ()
    at = partial(_place, origin, vehicle)
    found = [
        item
        for one in fence.polygons
        for item in polygon([at(*point) for point in one.points], inclusion=one.inclusion)
    ]
    found += [item for one in fence.circles for item in circle(at(*one.center), one.radius_m, inclusion=one.inclusion)]
    return tuple(found)


def _make_rally(origin: Origin, vehicle: Vehicle) -> Items:
    """The items of the rally points that the scenario declares."""
    return tuple(rally_point(_place(origin, vehicle, east, north), up) for east, north, up in vehicle.plan.rally)


def _place(origin: Origin, vehicle: Vehicle, east_m: float, north_m: float) -> tuple[float, float]:
    """Latitude and longitude of a point that is given from the start."""
    return origin.geodetic_of(vehicle.start.east_m + east_m, vehicle.start.north_m + north_m)


def name_flight_plan(vehicle: Vehicle) -> str:
    """The name of the flight plan of `vehicle`."""
    if vehicle.plan.file is not None:
        return Path(vehicle.plan.file).name
    return "square" if vehicle.plan.square is not None else "path"
