"""Rerouting: the rest of a plan, around volumes that were closed while it is flown, or after them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.elementary_python import add_up
from skyrange.core.geodesy import Origin
from skyrange.core.time import Time, from_seconds, to_seconds
from skyrange.core.volumes import Volume4D
from skyrange.gcs.plan.paths import Leg, Point, leg
from skyrange.gcs.plan.plans import LANDINGS, TAKEOFFS, End, FlightPlan, is_navigation
from skyrange.gcs.plan.routes import final_legs, place
from skyrange.gcs.plan.volumes import Margins, leg_volumes
from skyrange.planning.limits import Costs, Limits, NoRouteError
from skyrange.planning.routes import find_route
from skyrange.utm.airspace.claimed_airspace import Airspace, Query

CLIMB_M: Final = 60.0
"""By how much higher than its plan the rest may be flown, where buildings or closed volumes are in the way."""
CLEARANCE_M: Final = 5.0
MAX_HOLD_S: Final = 120.0
"""How long an aircraft waits at most until its way is free."""
_SPARE_M: Final = 1.0
_TOP_M: Final = 1_000.0
"""A volume that reaches higher is not flown over."""
_WAYS: Final = 6
"""How many ways are planned at most."""
_ROUNDS: Final = 4
"""How often a hold is made longer, because the margins of what follows it grow with it."""


def reroute(
    plan: FlightPlan,
    progress: int,
    here: Point,
    closed: Sequence[Volume4D],
    *,
    now: Time,
    city: City | None,
    margins: Margins,
    direct: bool = False,
) -> FlightPlan:
    """The rest of a plan from `here` on as a guided plan whose volumes from `now` on are none of the closed ones.

    It holds where the aircraft is until the way is free, or leads around or above closed volumes, whichever takes less
    time; first around those that are in its way, then around those that are in the way of that way, and so on, and
    in the end around all.
    `progress` is the mission item, or the index of the target, that is being flown to; `direct` leaves out all points
    but the last. Raises `NoRouteError` where there is no way, and for a mission that does more than fly through points.
    """
    rest, end = _rest_of(plan, progress)
    if not rest:
        raise NoRouteError("nothing of the plan is left but its end")
    if direct:
        rest = rest[-1:]
    airspace = _airspace_of(closed)
    alt_m = max(point.up_m for point in (here, *rest))
    limits = Limits(alt_m, alt_m + CLIMB_M, CLEARANCE_M, costs=Costs(plan.cruise_mps))
    places = [(point.east_m, point.north_m) for point in (here, *rest)]
    avoided: dict[int, Building] = {}
    best: FlightPlan | None = None
    for number in range(_WAYS):
        buildings = [*(city.buildings if city is not None else ()), *avoided.values()]
        around = City(buildings, "closed volumes") if buildings else None
        try:
            points = [Point(*point) for point in find_route(around, places, limits)]
        except NoRouteError:
            if best is None:
                raise
            return best
        candidate = replace(plan, kind="guided", mission=None, targets_enu_m=tuple(points[1:]), end=end)
        in_the_way = [
            int(overlap.intent) for overlap in airspace.find_overlaps(_claimed(candidate, here, now, margins))
        ]
        held_plan = _hold(candidate, here, now, airspace, margins)
        if held_plan is not None and (best is None or _duration_s(held_plan, here) < _duration_s(best, here)):
            best = held_plan
        next_ones = range(len(closed)) if number == _WAYS - 2 else in_the_way
        new_numbers = [number for number in next_ones if number not in avoided]
        if not new_numbers:
            break
        avoided |= {
            closed_number: _obstacle(plan.origin, closed_number, closed[closed_number], margins)
            for closed_number in new_numbers
        }
    if best is None:
        raise NoRouteError("closed volumes are in the way at all times")
    return best


def _obstacle(origin: Origin, number: int, volume: Volume4D, margins: Margins) -> Building:
    """A closed volume as a building, from the ground up."""
    outline = shapely.Polygon([origin.enu_of(lat, lon) for lat, lon in volume.outline])
    top_m = volume.upper_m - origin.ellipsoid_of(origin.alt_msl_m) + margins.vertical_m
    return Building(
        f"closed-{number}", min(max(top_m, 0.0), _TOP_M), outline.convex_hull.buffer(margins.horizontal_m + _SPARE_M)
    )


def _hold(plan: FlightPlan, here: Point, now: Time, airspace: Airspace, margins: Margins) -> FlightPlan | None:
    """The way with the hold at `here` after which it is free; `None` without one."""
    hold_s = 0.0
    for _ in range(_ROUNDS):
        held_plan = plan if hold_s == 0.0 else replace(plan, targets_enu_m=(here, *plan.targets_enu_m), hold_s=hold_s)
        claimed = _claimed(held_plan, here, now, margins)
        if not airspace.find_overlaps(claimed):
            return held_plan
        flown = claimed[1:] if hold_s else claimed
        (more,) = airspace.find_least_delays([Query(flown, from_seconds(MAX_HOLD_S - hold_s))])
        if not more:  # the hold itself is in the way, or the way is not free in time
            return None
        hold_s += to_seconds(more)
    return None


def _claimed(plan: FlightPlan, here: Point, now: Time, margins: Margins) -> tuple[Volume4D, ...]:
    return leg_volumes(plan.origin, rest_legs(plan, here), now, margins)


def is_met(
    closed: Sequence[Volume4D], plan: FlightPlan, progress: int, here: Point, now: Time, margins: Margins
) -> bool:
    """Whether the rest of a plan from `here` on, flown straight, overlaps closed volumes."""
    rest = _straight_rest(plan, progress, direct=False)
    return rest is not None and bool(_airspace_of(closed).find_overlaps(_claimed(rest, here, now, margins)))


def rest_duration_s(plan: FlightPlan, progress: int, here: Point, *, direct: bool = False) -> float | None:
    """How long the rest of a plan takes from `here` on, flown straight; `None` if it is over, or more than points."""
    rest = _straight_rest(plan, progress, direct=direct)
    return None if rest is None else _duration_s(rest, here)


def _straight_rest(plan: FlightPlan, progress: int, *, direct: bool) -> FlightPlan | None:
    try:
        rest, end = _rest_of(plan, progress)
    except NoRouteError:
        return None
    if not rest:
        return None
    return replace(plan, kind="guided", targets_enu_m=tuple(rest[-1:] if direct else rest), end=end)


def _airspace_of(closed: Sequence[Volume4D]) -> Airspace:
    """Closed volumes, each under its number."""
    airspace = Airspace()
    for number, volume in enumerate(closed):
        airspace.put(str(number), [volume])
    return airspace


def _duration_s(plan: FlightPlan, here: Point) -> float:
    return add_up(leg.duration_s for leg in rest_legs(plan, here))


def rest_legs(plan: FlightPlan, here: Point) -> tuple[Leg, ...]:
    """The legs of a guided plan from `here` on."""
    out: list[Leg] = []
    for number, target in enumerate(plan.targets_enu_m):
        flown = leg(here, target, plan.cruise_mps)
        out.append(flown if number else flown._replace(duration_s=flown.duration_s + plan.hold_s))
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
            landing_point = place(plan, item, here)._replace(up_m=here.up_m)
            return [*points, *([landing_point] if landing_point != here else [])], "land"
        elif command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return points, "rtl"
        elif is_navigation(command) or command in (mav.MAV_CMD_DO_JUMP, mav.MAV_CMD_DO_JUMP_TAG):
            raise NoRouteError(f"item {seq} of the mission is more than a point to fly through")
    return points, end
