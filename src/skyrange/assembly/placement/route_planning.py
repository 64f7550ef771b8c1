"""Planning of routes: every `plan = { route = … }` becomes a path around the buildings of the city."""

from __future__ import annotations

from skyrange.city.city import City
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import hash64
from skyrange.gcs.plan.plans import CRUISE_MPS
from skyrange.planning.limits import Costs, Limits, NoRouteError
from skyrange.planning.routes import find_route
from skyrange.planning.sampling import Sampling, load_ompl
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.plan import Path, Plan
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.validation.error_messages import spell_path
from skyrange.world.airframes import AIRFRAMES

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
    own = {name: getattr(plan, name) for name in Plan.model_fields.keys() - _REPLACED}
    return vehicle.model_copy(update={"plan": Plan(path=Path(points=tuple(points)), **own)})
