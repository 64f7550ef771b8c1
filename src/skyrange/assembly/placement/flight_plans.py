"""Flight plans of ground stations, made from a vehicle's plan at the place where it starts."""

from __future__ import annotations

from skyrange.core.geodesy import Origin
from skyrange.gcs.plan import paths, plans
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.scenario.model.fleet import Vehicle


def make_flight_plan(origin: Origin, vehicle: Vehicle) -> FlightPlan:
    """The flight plan of `vehicle`, anchored at its start. Raises InputError for a mission file that cannot be read."""
    plan = vehicle.plan
    home_enu_m = (vehicle.start.east_m, vehicle.start.north_m, 0.0)
    if plan.file is not None:
        return plans.from_file(origin, home_enu_m, plan.file, anchor=plan.anchor == "start")
    if plan.square is not None:
        points = paths.square(plan.square.side_m, plan.square.alt_m)
        name = "square"
    else:
        assert plan.path is not None  # the model allows exactly one of the three
        points = tuple(paths.Point(*point) for point in plan.path.points_enu_m)
        name = "path"
    return plans.path(
        origin,
        home_enu_m,
        points,
        kind=plan.mode,
        cruise_mps=plan.speed_mps or plans.CRUISE_MPS,
        end=plan.end or "rtl",
        name=name,
    )
