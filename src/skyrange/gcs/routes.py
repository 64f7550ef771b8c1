"""Where does a plan lead, leg by leg, and how long does it take? The mission unrolled as ArduCopter flies it.

Jumps are followed, speed changes obeyed, holds waited; RETURN_TO_LAUNCH climbs under its cone, crosses
and lands. What is estimated here feeds approval volumes, checks against buildings and time limits.
"""

from __future__ import annotations

import math

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.missions import MissionItem
from skyrange.gcs import paths
from skyrange.gcs.paths import Leg, Point, leg
from skyrange.gcs.plans import MSL_FRAMES, TERRAIN_FRAMES, FlightPlan

RTL_ALT_M = 15.0
"""ArduCopter RTL_ALT, default 1500 cm above home (ArduCopter/config.h)."""
RTL_CONE_SLOPE = 3.0
"""ArduCopter RTL_CONE_SLOPE, default 3: near home it climbs no higher than 3 times the distance."""
RTL_LOITER_S = 5.0
"""ArduCopter RTL_LOIT_TIME, default 5000 ms above home before landing."""
CIRCLE_RADIUS_M = 10.0
"""ArduCopter CIRCLE_RADIUS, default 1000 cm: how wide LOITER_TURNS circles that names no radius."""
MAX_LEGS = 10_000
"""Where unrolling jumps stops; `checks.check` rejects plans that get there."""

_STAY = (mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_CMD_NAV_LOITER_TIME, mav.MAV_CMD_NAV_SPLINE_WAYPOINT)
_GO = (*_STAY, mav.MAV_CMD_NAV_LOITER_TURNS, mav.MAV_CMD_NAV_LOITER_UNLIM, mav.MAV_CMD_NAV_LOITER_TO_ALT)


def legs(plan: FlightPlan) -> tuple[Leg, ...]:
    """The plan's legs in flying order, from home to where it lands; at most `MAX_LEGS`.

    Meaningful for plans without faults (`checks.check`).
    """
    return _guided(plan) if plan.kind == "guided" else _auto(plan)[0]


def comes_to_an_end(plan: FlightPlan) -> bool:
    """Whether a plan's jumps end within `MAX_LEGS`."""
    return plan.kind == "guided" or _auto(plan)[1]


def enu_points(plan: FlightPlan) -> tuple[Point, ...]:
    """The corners of the flight from home on, in metres from the origin, without repeats in place."""
    points = [plan.home_enu_m]
    for piece in legs(plan):
        if piece.end != points[-1]:
            points.append(piece.end)
    return tuple(points)


def length_m(plan: FlightPlan) -> float:
    """Length of the whole flight, climbs and landing included."""
    return paths.length_m(enu_points(plan))


def estimated_duration_s(plan: FlightPlan) -> float:
    """Seconds from take-off to disarmed, by ArduCopter's default speeds and the plan's own."""
    return math.fsum(piece.duration_s for piece in legs(plan))


def _guided(plan: FlightPlan) -> tuple[Leg, ...]:
    here = plan.home_enu_m
    out: list[Leg] = []
    if plan.targets_enu_m:
        above = Point(here.east_m, here.north_m, plan.targets_enu_m[0].up_m)
        out.append(leg(here, above, plan.cruise_mps))
        here = above
    for target in plan.targets_enu_m:
        out.append(leg(here, target, plan.cruise_mps))
        here = target
    return (*out, *_end(plan, here, plan.cruise_mps, plan.end == "rtl"))


def _end(plan: FlightPlan, here: Point, speed_mps: float, rtl: bool) -> list[Leg]:
    """Home (or not) and down."""
    out: list[Leg] = []
    home = plan.home_enu_m
    if rtl:
        distance_m = math.hypot(here.east_m - home.east_m, here.north_m - home.north_m)
        up_m = max(here.up_m, home.up_m + min(RTL_ALT_M, RTL_CONE_SLOPE * distance_m))
        high, above = Point(here.east_m, here.north_m, up_m), Point(home.east_m, home.north_m, up_m)
        out += [leg(here, high, speed_mps), leg(high, above, speed_mps), Leg(above, above, RTL_LOITER_S)]
        here = above
    ground_m = home.up_m if (here.east_m, here.north_m) == home[:2] else 0.0
    out.append(leg(here, Point(here.east_m, here.north_m, ground_m), speed_mps, landing=True))
    return out


def place(plan: FlightPlan, item: MissionItem, here: Point) -> Point:
    """Where a placed item is, in metres from the origin; zero coordinates and altitude mean "as `here`"."""
    east_m, north_m = here.east_m, here.north_m
    if not (item.x == 0.0 and item.y == 0.0):
        east_m, north_m = plan.origin.enu_of(item.x, item.y)
    if item.z == 0.0:
        return Point(east_m, north_m, here.up_m)
    return Point(east_m, north_m, up_m(plan, item))


def up_m(plan: FlightPlan, item: MissionItem) -> float:
    """Height of a placed item above the origin: its altitude's datum removed. The ground is at 0."""
    if item.frame in MSL_FRAMES:
        return item.z - plan.origin.alt_msl_m
    return item.z if item.frame in TERRAIN_FRAMES else plan.home_enu_m.up_m + item.z


def _auto(plan: FlightPlan) -> tuple[tuple[Leg, ...], bool]:
    """The legs, and whether these are all."""
    here, speed_mps = plan.home_enu_m, plan.cruise_mps
    items, out, jumped = plan.items, list[Leg](), dict[int, int]()
    at = 0
    while at < len(items):
        if len(out) >= MAX_LEGS or sum(jumped.values()) >= MAX_LEGS:
            return tuple(out), False
        item, at = items[at], at + 1
        command = item.command
        if command == mav.MAV_CMD_NAV_TAKEOFF:
            above = Point(here.east_m, here.north_m, up_m(plan, item))
            out.append(leg(here, above, speed_mps))  # straight up: ArduCopter ignores a take-off's place
            here = above
        elif command in _GO:
            there = place(plan, item, here)
            out.append(leg(here, there, speed_mps))
            here = there
            wait_s = _wait_s(item, speed_mps)
            if wait_s > 0.0:
                out.append(Leg(here, here, wait_s))
        elif command == mav.MAV_CMD_NAV_DELAY:
            out.append(Leg(here, here, max(item.param1, 0.0)))
        elif command == mav.MAV_CMD_DO_CHANGE_SPEED and item.param1 in (0.0, 1.0) and item.param2 > 0.0:
            speed_mps = item.param2
        elif command == mav.MAV_CMD_DO_JUMP and jumped.get(at, 0) < item.param2:
            jumped[at] = jumped.get(at, 0) + 1
            at = max(int(item.param1), 1) - 1  # item 1 is the first after home
        elif command == mav.MAV_CMD_NAV_LAND:
            there = place(plan, item, here)._replace(up_m=here.up_m)
            out.append(leg(here, there, speed_mps))
            return (*out, *_end(plan, there, speed_mps, rtl=False)), True
        elif command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return (*out, *_end(plan, here, speed_mps, rtl=True)), True
    return (*out, *_end(plan, here, speed_mps, rtl=plan.end == "rtl")), True


def _wait_s(item: MissionItem, speed_mps: float) -> float:
    if item.command in _STAY:
        return item.param1
    if item.command == mav.MAV_CMD_NAV_LOITER_TURNS:
        return item.param1 * 2.0 * math.pi * (abs(item.param3) or CIRCLE_RADIUS_M) / speed_mps
    return 0.0
