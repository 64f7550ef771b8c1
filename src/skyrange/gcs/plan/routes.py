"""Route of a flight plan: its legs with durations, unrolled as ArduCopter flies the mission.

Jumps are followed, and speed changes and hold times are applied. RETURN_TO_LAUNCH climbs within its cone, flies
home and lands. The estimates serve airspace volumes, checks against buildings, and time limits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import MissionItem
from skyrange.core import elementary_python
from skyrange.gcs.plan import paths
from skyrange.gcs.plan.paths import Leg, Point, leg
from skyrange.gcs.plan.plans import LANDINGS, MSL_FRAMES, TAKEOFFS, TERRAIN_FRAMES, FlightPlan, Unrolled, is_navigation

RTL_ALT_M = 15.0
"""ArduCopter RTL_ALT, default 1500 cm above home (ArduCopter/config.h)."""
RTL_CONE_SLOPE = 3.0
"""ArduCopter RTL_CONE_SLOPE, default 3: near home RTL climbs no higher than 3 times the distance to home."""
RTL_LOITER_S = 5.0
"""ArduCopter RTL_LOIT_TIME, default 5000 ms: loiter time above home before landing."""
CIRCLE_RADIUS_M = 10.0
"""ArduCopter CIRCLE_RADIUS, default 1000 cm: the radius of a LOITER_TURNS that states none."""
MAX_LEGS = 10_000
"""Unrolling stops at this number of legs or jumps; `plan.checks.check` rejects such plans."""
TAKEOFF_MIN_M = 1.0
"""A take-off on the ground climbs at least so high, whatever its altitude (ModeAuto::takeoff_start)."""

_JUMPS = (mav.MAV_CMD_DO_JUMP, mav.MAV_CMD_DO_JUMP_TAG)
_HOLD_COMMANDS = (mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_CMD_NAV_LOITER_TIME, mav.MAV_CMD_NAV_SPLINE_WAYPOINT)
_MOVE_COMMANDS = (
    *_HOLD_COMMANDS,
    mav.MAV_CMD_NAV_LOITER_TURNS,
    mav.MAV_CMD_NAV_LOITER_UNLIM,
    mav.MAV_CMD_NAV_LOITER_TO_ALT,
)


def legs(plan: FlightPlan) -> tuple[Leg, ...]:
    """The plan's legs in the order flown, from home to the landing; at most `MAX_LEGS`.

    The result is meaningful only for a plan in which `plan.checks.check` finds no problem. What is repeated for ever
    is flown twice in it, and a wait for ever takes no time.
    """
    return _guided_legs(plan) if plan.kind == "guided" else _unroll(plan).legs


def is_bounded(plan: FlightPlan) -> bool:
    """Whether unrolling the plan's jumps ends within `MAX_LEGS`, or they repeat for ever."""
    return plan.kind == "guided" or _unroll(plan).complete


def is_endless(plan: FlightPlan) -> bool:
    """Whether a mission never ends by itself: it repeats or waits for ever."""
    return plan.kind != "guided" and _unroll(plan).endless


def enu_points(plan: FlightPlan) -> tuple[Point, ...]:
    """The points of the flight from home on, in metres from the origin, without consecutive duplicates."""
    points = [plan.home_enu_m]
    for piece in legs(plan):
        if piece.end != points[-1]:
            points.append(piece.end)
    return tuple(points)


def length_m(plan: FlightPlan) -> float:
    """Length of the whole flight in metres, including climbs and landing."""
    return paths.length_m(enu_points(plan))


def estimated_duration_s(plan: FlightPlan) -> float:
    """Estimated seconds from take-off to disarming, from the plan's speeds and ArduCopter's defaults."""
    return math.fsum(piece.duration_s for piece in legs(plan))


def _guided_legs(plan: FlightPlan) -> tuple[Leg, ...]:
    here = plan.home_enu_m
    out: list[Leg] = []
    if plan.targets_enu_m:
        above = Point(here.east_m, here.north_m, plan.targets_enu_m[0].up_m)
        out.append(leg(here, above, plan.cruise_mps))
        here = above
    for target in plan.targets_enu_m:
        out.append(leg(here, target, plan.cruise_mps))
        here = target
    return (*out, *final_legs(plan, here, plan.cruise_mps, rtl=plan.end == "rtl"))


def return_legs(plan: FlightPlan, here: Point) -> tuple[Leg, ...]:
    """The legs of RETURN_TO_LAUNCH from `here`, at the plan's speed."""
    return tuple(final_legs(plan, here, plan.cruise_mps, rtl=True))


def final_legs(plan: FlightPlan, here: Point, speed_mps: float, *, rtl: bool) -> list[Leg]:
    """The legs of the landing, with the return home before it if `rtl`."""
    out: list[Leg] = []
    home = plan.home_enu_m
    if rtl:
        distance_m = elementary_python.hypot(here.east_m - home.east_m, here.north_m - home.north_m)
        up_m = max(here.up_m, home.up_m + min(RTL_ALT_M, RTL_CONE_SLOPE * distance_m))
        high, above = Point(here.east_m, here.north_m, up_m), Point(home.east_m, home.north_m, up_m)
        out += [leg(here, high, speed_mps), leg(high, above, speed_mps), Leg(above, above, RTL_LOITER_S)]
        here = above
    ground_m = home.up_m if (here.east_m, here.north_m) == home[:2] else 0.0
    out.append(leg(here, Point(here.east_m, here.north_m, ground_m), speed_mps, landing=True))
    return out


def place(plan: FlightPlan, item: MissionItem, here: Point) -> Point:
    """The position of an item in metres from the origin; zero coordinates or altitude mean those of `here`."""
    east_m, north_m = here.east_m, here.north_m
    if not (item.x == 0.0 and item.y == 0.0):
        east_m, north_m = plan.origin.enu_of(item.x, item.y)
    if item.z == 0.0:
        return Point(east_m, north_m, here.up_m)
    return Point(east_m, north_m, up_m(plan, item))


def up_m(plan: FlightPlan, item: MissionItem) -> float:
    """Height of an item above the origin in metres, converted from its altitude's datum. The ground is at 0."""
    if item.frame in MSL_FRAMES:
        return item.z - plan.origin.alt_msl_m
    return item.z if item.frame in TERRAIN_FRAMES else plan.home_enu_m.up_m + item.z


def climb_top_m(plan: FlightPlan, item: MissionItem, here: Point) -> float:
    """Height above the origin to which a take-off climbs from `here`, in metres."""
    return max(up_m(plan, item), here.up_m + (TAKEOFF_MIN_M if here.up_m <= plan.home_enu_m.up_m else 0.0))


def _unroll(plan: FlightPlan) -> Unrolled:
    """The mission unrolled, the first time that it is asked for."""
    known = plan.unrolled
    if known is None:
        known = _follow_mission(plan)
        object.__setattr__(plan, "unrolled", known)
    return known


def _follow_mission(plan: FlightPlan) -> Unrolled:
    here, speed_mps = plan.home_enu_m, plan.cruise_mps
    items, out, jumps_done = plan.items, list[Leg](), dict[int, int]()
    at = 0
    while at < len(items):
        if len(out) >= MAX_LEGS or sum(jumps_done.values()) >= MAX_LEGS:
            return Unrolled(tuple(out), complete=False, endless=False)
        item, at = items[at], at + 1
        command = item.command
        if command in TAKEOFFS:
            above = Point(here.east_m, here.north_m, climb_top_m(plan, item, here))
            out.append(leg(here, above, speed_mps))  # straight up: ArduCopter ignores a take-off's position
            here = above
        elif command in _MOVE_COMMANDS:
            target = place(plan, item, here)
            out.append(leg(here, target, speed_mps))
            here = target
            wait_s = _wait_s(item, speed_mps)
            if wait_s > 0.0:
                out.append(Leg(here, here, wait_s))
            if command == mav.MAV_CMD_NAV_LOITER_UNLIM:
                return Unrolled(tuple(out), complete=True, endless=True)
        elif command == mav.MAV_CMD_NAV_DELAY or command == mav.MAV_CMD_NAV_ATTITUDE_TIME:
            out.append(Leg(here, here, max(item.param1, 0.0)))
        elif command == mav.MAV_CMD_NAV_SCRIPT_TIME:
            out.append(Leg(here, here, max(item.param2, 0.0)))
        elif command == mav.MAV_CMD_DO_CHANGE_SPEED and item.param1 in (0.0, 1.0) and item.param2 > 0.0:
            speed_mps = item.param2
        elif command in _JUMPS and item.param2 < 0.0 and jumps_done.get(at, 0) > 0:
            return Unrolled(tuple(out), complete=True, endless=True)
        elif command in _JUMPS and (item.param2 < 0.0 or jumps_done.get(at, 0) < item.param2):
            jumps_done[at] = jumps_done.get(at, 0) + 1
            at = _jump_target(items, item) - 1  # item 1 is the first after home
        elif command in LANDINGS:
            target = place(plan, item, here)._replace(up_m=here.up_m)
            out.append(leg(here, target, speed_mps))
            return Unrolled((*out, *final_legs(plan, target, speed_mps, rtl=False)), complete=True, endless=False)
        elif command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return Unrolled((*out, *final_legs(plan, here, speed_mps, rtl=True)), complete=True, endless=False)
    return Unrolled((*out, *final_legs(plan, here, speed_mps, rtl=plan.end == "rtl")), complete=True, endless=False)


def _jump_target(items: Sequence[MissionItem], jump: MissionItem) -> int:
    """Number of the item that a jump leads to; the end of the mission for a tag that no item has."""
    if jump.command == mav.MAV_CMD_DO_JUMP:
        return max(int(jump.param1), 1)
    tagged = (
        seq
        for seq, item in enumerate(items, start=1)
        if item.command == mav.MAV_CMD_JUMP_TAG and item.param1 == jump.param1
    )
    return next(tagged, len(items) + 1)


def never_leaves(items: Sequence[MissionItem], jump_seq: int) -> bool:
    """Whether a jump for ever comes back to itself without a navigation command in between.

    Jumps that are repeated a number of times are over at some time, so they are passed. Autopilots stop following such
    a loop after 64 jumps, or 255 commands, and end the mission (AP_Mission.cpp, `get_next_cmd`,
    `advance_current_nav_cmd`).
    """
    at = jump_seq
    for _ in items:
        item = items[at - 1]
        at = _jump_target(items, item) if item.command in _JUMPS and item.param2 < 0.0 else at + 1
        if at > len(items) or is_navigation(items[at - 1].command):
            return False
        if at == jump_seq:
            return True
    return False


def _wait_s(item: MissionItem, speed_mps: float) -> float:
    if item.command in _HOLD_COMMANDS:
        return item.param1
    if item.command == mav.MAV_CMD_NAV_LOITER_TURNS:
        return item.param1 * 2.0 * math.pi * (abs(item.param3) or CIRCLE_RADIUS_M) / speed_mps
    return 0.0
