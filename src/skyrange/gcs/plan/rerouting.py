"""Rerouting: the rest of a plan, around areas that were closed while it is flown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.volumes import Volume4D
from skyrange.gcs.plan.paths import Leg, Point, leg
from skyrange.gcs.plan.plans import LANDINGS, TAKEOFFS, End, FlightPlan, is_navigation
from skyrange.gcs.plan.routes import final_legs, place
from skyrange.planning.costs import Costs
from skyrange.planning.limits import Limits, NoRouteError
from skyrange.planning.routes import find_route

CLIMB_M: Final = 60.0
"""By how much higher than its plan the rest may be flown, where buildings are in the way."""
CLEARANCE_M: Final = 5.0
_SPARE_M: Final = 1.0
_TOP_M: Final = 1_000.0
"""An area is closed up to here, whatever its height: the way leads beside it."""


def reroute(
    plan: FlightPlan, progress: int, here: Point, closed: Sequence[Volume4D], city: City | None, margin_m: float
) -> FlightPlan:
    """The rest of a plan from `here` on as a guided plan, `margin_m` and more away from closed volumes.

    `progress` is the mission item, or the index of the target, that is being flown to. Raises `NoRouteError` where
    there is no way, and for a mission that does more than fly through points.
    """
    rest, end = _rest_of(plan, progress)
    if not rest:
        raise NoRouteError("nothing of the plan is left but its end")
    outlines = [shapely.Polygon([plan.origin.enu_of(lat, lon) for lat, lon in one.outline]) for one in closed]
    areas = [outline.convex_hull.buffer(margin_m + _SPARE_M) for outline in outlines]
    obstacles = [Building(f"closed-{number}", _TOP_M, area) for number, area in enumerate(areas)]
    alt_m = max(point.up_m for point in (here, *rest))
    limits = Limits(alt_m, alt_m + CLIMB_M, CLEARANCE_M, costs=Costs(plan.cruise_mps))
    augmented = City([*(city.buildings if city is not None else ()), *obstacles], "closed areas")
    places = [(point.east_m, point.north_m) for point in (here, *rest)]
    points = [Point(*point) for point in find_route(augmented, places, limits)]
    return replace(plan, kind="guided", mission=None, targets_enu_m=tuple(points[1:]), end=end)


def rest_legs(plan: FlightPlan, here: Point) -> tuple[Leg, ...]:
    """The legs of a guided plan from `here` on."""
    out: list[Leg] = []
    for target in plan.targets_enu_m:
        out.append(leg(here, target, plan.cruise_mps))
        here = target
    return (*out, *final_legs(plan, here, plan.cruise_mps, rtl=plan.end == "rtl"))


def _rest_of(plan: FlightPlan, progress: int) -> tuple[list[Point], End]:
    """The points that are left, and how the flight ends."""
    if plan.kind == "guided":
        return list(plan.targets_enu_m[max(progress, 0) :]), plan.end
    here, points, end = plan.home_enu_m, list[Point](), plan.end
    for seq, item in enumerate(plan.items, start=1):
        command = item.command
        if command in TAKEOFFS:
            continue
        if command == mav.MAV_CMD_NAV_WAYPOINT and item.param1 == 0.0:
            here = place(plan, item, here)
            if seq >= progress:
                points.append(here)
        elif command in LANDINGS:
            there = place(plan, item, here)._replace(up_m=here.up_m)
            return [*points, *([there] if there != here else [])], "land"
        elif command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return points, "rtl"
        elif is_navigation(command) or command in (mav.MAV_CMD_DO_JUMP, mav.MAV_CMD_DO_JUMP_TAG):
            raise NoRouteError(f"item {seq} of the mission is more than a point to fly through")
    return points, end
