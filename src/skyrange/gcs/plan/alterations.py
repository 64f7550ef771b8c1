"""Alterations of a flight plan: the same flight higher, or beside its way; take-off and landing stay where they are."""

from __future__ import annotations

from dataclasses import replace

from skyrange.codec.mission import MissionItem
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.plans import GLOBAL_FRAMES, LANDINGS, LOCATED, TAKEOFFS, FlightPlan, is_navigation


def altered(plan: FlightPlan, climb_m: float, east_m: float, north_m: float) -> FlightPlan:
    """The plan with all that is flown between take-off and landing raised and shifted by these metres."""
    if plan.kind == "guided":
        last = len(plan.targets_enu_m) - 1
        targets = tuple(
            Point(one.east_m, one.north_m, one.up_m + climb_m)
            if plan.end == "land" and place == last
            else Point(one.east_m + east_m, one.north_m + north_m, one.up_m + climb_m)
            for place, one in enumerate(plan.targets_enu_m)
        )
        return replace(plan, targets_enu_m=targets)
    if plan.mission is None:
        return plan
    items = tuple(_altered_item(plan, item, climb_m, east_m, north_m) for item in plan.mission.items)
    return replace(plan, mission=replace(plan.mission, items=items))


def _altered_item(plan: FlightPlan, item: MissionItem, climb_m: float, east_m: float, north_m: float) -> MissionItem:
    """A waypoint moves; a take-off climbs higher; altitude 0 and position 0, 0 are the current ones and stay so."""
    if item.command not in LOCATED or not is_navigation(item.command) or item.frame not in GLOBAL_FRAMES:
        return item
    if item.command in LANDINGS:
        return item
    if item.z != 0.0:
        item = replace(item, z=item.z + climb_m)
    if item.command in TAKEOFFS or (item.x == 0.0 and item.y == 0.0):
        return item
    at = plan.origin.enu_of(item.x, item.y)
    lat, lon = plan.origin.geodetic_of(at[0] + east_m, at[1] + north_m)
    return replace(item, x=lat, y=lon)
