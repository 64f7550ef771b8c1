"""Checks of a flight plan before it is flown: all problems at once."""

from __future__ import annotations

import math
from collections.abc import Iterator

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import MissionItem
from skyrange.core import elementary_python
from skyrange.core.errors import Problem
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.plans import GLOBAL_FRAMES, LANDINGS, LOCATED, TAKEOFFS, FlightPlan, is_navigation
from skyrange.gcs.plan.routes import MAX_LEGS, climb_top_m, is_bounded, never_leaves, place

MAX_ITEMS = 649
"""Mission items besides home that ArduCopter holds in 16 KiB of storage.

(2422 + 2132 + 5204 − 4) / 15 bytes = 650, home included (libraries/StorageManager/StorageManager.cpp,
AP_MISSION_EEPROM_COMMAND_SIZE)."""
MAX_TARGETS = 10_000
MAX_ALT_M = 83_000.0
"""Largest altitude ArduCopter accepts (LOCATION_ALT_MAX_M)."""
FOR_EVER = -1
"""param2 of a DO_JUMP that is repeated for ever (AP_MISSION_JUMP_REPEAT_FOREVER)."""
MAX_RADIUS_M = 100_000.0
"""Greatest distance from home that a plan may reach; farther away the local frame is not valid."""


def check(plan: FlightPlan, where: str) -> list[Problem]:
    """All problems of `plan`; `where` is the key or file that they name. A plan without problems can be flown.

    It finds: no items or too many, NaN and infinity, invalid coordinates, positions far from home, points below the
    ground, a mission that does not begin with a take-off, jumps that are out of range, repeat too often or never leave
    themselves, and speeds and radii that are not positive. A mission that repeats for ever or waits for ever is none of
    these.
    """
    problems = list(_check_numbers(plan, where))
    problems += _check_guided(plan, where) if plan.kind == "guided" else _check_mission(plan, where)
    if not problems and not is_bounded(plan):
        problems.append(Problem(where, f"more than {MAX_LEGS} legs or jumps", "a mission whose jumps come to an end"))
    return problems


def _check_numbers(plan: FlightPlan, where: str) -> Iterator[Problem]:
    if not (math.isfinite(plan.cruise_mps) and plan.cruise_mps > 0.0):
        yield Problem(f"{where}.cruise_mps", f"{plan.cruise_mps!r}", "a speed above 0 m/s")
    if not all(map(math.isfinite, plan.home_enu_m)):
        yield Problem(f"{where}: home", f"{tuple(plan.home_enu_m)}", "three finite numbers of metres")
    elif plan.home_enu_m.up_m < 0.0:
        yield Problem(f"{where}: home", f"{plan.home_enu_m.up_m:g} m below the ground", "a home at 0 m up or above")


def _check_guided(plan: FlightPlan, where: str) -> Iterator[Problem]:
    targets = plan.targets_enu_m
    if not 1 <= len(targets) <= MAX_TARGETS:
        yield Problem(where, f"{len(targets)} targets", f"1 to {MAX_TARGETS}")
    if not (math.isfinite(plan.acceptance_m) and plan.acceptance_m > 0.0):
        yield Problem(f"{where}.acceptance_m", f"{plan.acceptance_m!r}", "a radius above 0 m")
    for number, target in enumerate(targets, start=1):
        at = f"{where}: point {number}"
        if not all(map(math.isfinite, target)):
            yield Problem(at, f"{tuple(target)}", "three finite numbers of metres")
            continue
        yield from _check_height(at, target, plan)
        if number == 1 and target.up_m <= plan.home_enu_m.up_m:
            yield Problem(
                at, f"{target.up_m - plan.home_enu_m.up_m:g} m above home", "a height to take off to, above 0"
            )


def _check_mission(plan: FlightPlan, where: str) -> Iterator[Problem]:
    items = plan.items
    if not 1 <= len(items) <= MAX_ITEMS:
        yield Problem(where, f"{len(items)} mission items", f"1 to {MAX_ITEMS}")
        return
    navigating = [item for item in items if is_navigation(item.command)]
    waited = [item for item in navigating if item.command != mav.MAV_CMD_NAV_DELAY]  # AP_Mission::is_takeoff_next
    if not waited or waited[0].command not in TAKEOFFS:
        first = f"command {waited[0].command}" if waited else "none"
        yield Problem(
            f"{where}: first navigation command", first, "22 (NAV_TAKEOFF), without which AUTO refuses to start"
        )
    here = plan.home_enu_m
    for seq, item in enumerate(items, start=1):
        at = f"{where}: item {seq} (command {item.command})"
        yield from _check_params(at, item)
        if item.command in (mav.MAV_CMD_DO_JUMP, mav.MAV_CMD_DO_JUMP_TAG):
            problems = [*_check_jump(at, item, len(items))]
            yield from problems
            if not problems and item.param2 == FOR_EVER and math.isfinite(item.param1) and never_leaves(items, seq):
                expected = "a navigation command between the target of the jump and the jump"
                yield Problem(at, "jumps for ever to itself", expected, "Autopilots end the mission there.")
        elif item.command in LOCATED:
            fault = _check_place(at, item)
            if fault is not None:
                yield fault
                continue
            if item.command in TAKEOFFS:
                here = here._replace(up_m=climb_top_m(plan, item, here))
            elif is_navigation(item.command):
                here = place(plan, item, here)
            if item.command not in LANDINGS:
                yield from _check_height(at, here, plan)


def _check_params(at: str, item: MissionItem) -> Iterator[Problem]:
    for name in ("param1", "param2", "param3", "param4"):
        value = getattr(item, name)
        if math.isinf(value) or (math.isnan(value) and item.command not in LOCATED):
            yield Problem(f"{at} {name}", f"{value}", "a finite number")


def _check_jump(at: str, item: MissionItem, count: int) -> Iterator[Problem]:
    tagged = item.command == mav.MAV_CMD_DO_JUMP_TAG
    if not tagged and math.isfinite(item.param1) and not 1 <= item.param1 <= count:
        yield Problem(f"{at} param1", f"{item.param1:g}", f"an item from 1 to {count}")
    if math.isfinite(item.param2) and item.param2 < 0.0 and item.param2 != FOR_EVER:
        yield Problem(f"{at} param2", f"{item.param2:g}", f"a number of repeats, or {FOR_EVER} for ever")


def _check_place(at: str, item: MissionItem) -> Problem | None:
    if item.frame not in GLOBAL_FRAMES:
        return Problem(at, f"frame {item.frame}", "a global frame: 0, 3, 5, 6, 10 or 11")
    if not (abs(item.x) <= 90.0 and abs(item.y) <= 180.0):  # also catches NaN
        return Problem(at, f"latitude {item.x}, longitude {item.y}", "degrees within ±90 and ±180")
    if not abs(item.z) < MAX_ALT_M:
        return Problem(at, f"altitude {item.z}", f"metres within ±{MAX_ALT_M:g}")
    return None


def _check_height(at: str, point: Point, plan: FlightPlan) -> Iterator[Problem]:
    if point.up_m < 0.0:
        yield Problem(at, f"{-point.up_m:.1f} m below the ground", "a point above it")
    away_m = elementary_python.hypot(point.east_m - plan.home_enu_m.east_m, point.north_m - plan.home_enu_m.north_m)
    if away_m > MAX_RADIUS_M:
        hint = "Re-anchor the mission to the aircraft's home."
        yield Problem(at, f"{away_m / 1000.0:.0f} km from home", f"at most {MAX_RADIUS_M / 1000.0:.0f} km", hint)
