"""Flight plans: routes planned around buildings, and the plans of ground stations where aircraft start."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from functools import partial
from pathlib import Path

from skyrange.city.city import City
from skyrange.codec.mission.fence_and_rally import Items, circle, polygon, rally_point
from skyrange.core.errors import InputError, Problem
from skyrange.core.geodesy import Origin
from skyrange.core.ids import hash64, vehicle_id
from skyrange.gcs.plan import paths, plans
from skyrange.gcs.plan.plans import CRUISE_MPS, FlightPlan
from skyrange.planning.limits import Costs, Limits, NoRouteError
from skyrange.planning.routes import find_route
from skyrange.planning.sampling import Sampling, load_ompl
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.plan import Path as PlanPath
from skyrange.scenario.model.plan import Plan
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.validation.error_messages import spell_path
from skyrange.world.airframes import AIRFRAMES


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
    for name, declared, from_file in (("fence", fence, made.fence), ("rally", rally, made.rally)):
        if declared and from_file:
            problem = f"{len(from_file)} items in the file, {len(declared)} in the scenario"
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
    items = [
        item
        for shape in fence.polygons
        for item in polygon([at(*point) for point in shape.points], inclusion=shape.inclusion)
    ]
    items += [
        item for shape in fence.circles for item in circle(at(*shape.center), shape.radius_m, inclusion=shape.inclusion)
    ]
    return tuple(items)


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


_STREAM = "planning.ompl"
_ROUNDED = 1
"""Decimals of the points of a path in metres."""
_REPLACED = {"square", "path", "route", "file", "anchor"}
"""Keys of a plan that its planned path replaces."""


def plan_routes(scenario: Scenario, city: City | None) -> Scenario:
    """The scenario with paths instead of routes. Raises `InputError` for each route without a way."""
    if all(vehicle.plan.route is None for _, vehicle in scenario.fleet):
        return scenario
    problems: list[Problem] = []
    fleets = []
    for o, operator in enumerate(scenario.operators):
        fleet = []
        for v, vehicle in enumerate(operator.vehicles):
            where = f"{spell_path(('operators', o, 'vehicles', v), scenario)}.plan.route"
            try:
                fleet.append(_planned(scenario, f"{operator.id}/{vehicle.id}", vehicle, city, where))
            except NoRouteError as error:
                problems.append(Problem(where, "no way", "a way around the buildings", f"{error}."))
            except InputError as error:
                problems += error.problems
        fleets.append(operator.model_copy(update={"vehicles": tuple(fleet)}))
    if problems:
        raise InputError(f"scenario {scenario.name}", problems)
    return scenario.model_copy(update={"operators": tuple(fleets)})


def _planned(scenario: Scenario, name: str, vehicle: Vehicle, city: City | None, where: str) -> Vehicle:
    """The aircraft with a path instead of a route. Raises `NoRouteError`, and `InputError` for a start to be found."""
    plan, route = vehicle.plan, vehicle.plan.route
    if route is None:
        return vehicle
    if vehicle.placing != "exact":
        raise InputError.one(
            where, "placing", vehicle.placing, "exact, because a route begins where the aircraft stands"
        )
    start = vehicle.start.east_m, vehicle.start.north_m
    places = [start, *((start[0] + east, start[1] + north) for east, north in (*route.via, route.to))]
    power_w = AIRFRAMES[vehicle.airframe].power_for if route.minimize == "energy" else None
    costs = Costs(plan.speed_mps or CRUISE_MPS, scenario.wind.air.steady_enu_mps, power_w)
    limits = Limits(route.alt_m, route.ceiling_m, route.clearance_m, costs=costs)
    sampling = None
    if route.planner == "ompl":
        load_ompl(where)
        sampling = Sampling(route.iterations, hash64(f"{_STREAM}|{scenario.seed}|{name}"))
    points = [
        (round(east - start[0], _ROUNDED), round(north - start[1], _ROUNDED), round(up, _ROUNDED))
        for east, north, up in find_route(city, places, limits, sampling)
    ]
    kept_fields = {name: getattr(plan, name) for name in Plan.model_fields.keys() - _REPLACED}
    return vehicle.model_copy(update={"plan": Plan(path=PlanPath(points=tuple(points)), **kept_fields)})
