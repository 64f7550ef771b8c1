"""DO and CONDITION commands of a mission, which run beside the navigation command that follows them.

After AP_Mission.cpp (`advance_current_do_cmd`) and ArduCopter/mode_auto.cpp: the commands between two navigation
commands run one after another while the second of these is flown. A CONDITION command delays those behind it; all that
are still pending are dropped when the next navigation command starts. Each one completed is reported with
MISSION_ITEM_REACHED.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_MS, NS_PER_S, from_seconds
from skyrange.vehicle.builtin import facing, fence, home, places
from skyrange.vehicle.builtin.fleet import Craft, Fleet, Slot, Timer
from skyrange.vehicle.builtin.layout import Control
from skyrange.vehicle.builtin.mission_fittings import FENCE_ENABLE, FITTINGS, TOLD
from skyrange.vehicle.builtin.mission_kinds import (
    LAND_START,
    NAMES,
    NEAR,
    PARACHUTE,
    ROI,
    ROI_LOCATION,
    ROI_NONE,
    SET_HOME,
    SPEED,
    WAIT,
    YAW,
)
from skyrange.vehicle.builtin.sequence import next_do

_CHECK_NS = 20 * NS_PER_MS
_SPEED_MIN_MPS = 0.1  # AC_WPNav.cpp WPNAV_WP_SPEED_MIN_CMS
_SPEED_MAX_MPS = 100.0  # faster than any multirotor: keeps an absurd request finite
_WAIT_MAX_S = 86_400.0 * 365.0


def start(fleet: Fleet, craft: Craft, seq: int) -> None:
    """Run one DO command, or start one CONDITION command."""
    slot = craft.mission[seq]
    command = slot.command
    announce(fleet, craft, seq)
    if command in (LAND_START, PARACHUTE):
        craft.in_landing = True
    if command == SPEED and slot.param2 > 0.0:
        change_speed(fleet, craft, int(slot.param1), slot.param2)
    elif command == SET_HOME:
        _set_home(fleet, craft, slot)
    elif command in (ROI, ROI_LOCATION, ROI_NONE):
        look_at(fleet, craft, slot.frame, slot.x, slot.y, slot.z)
    elif command == FENCE_ENABLE:
        fence.command(fleet, craft, int(slot.param1), 0)
    elif command == WAIT:
        craft.condition = (command, float(fleet.now + from_seconds(min(max(slot.param1, 0.0), _WAIT_MAX_S))))
    elif command == NEAR:
        craft.condition = (command, max(slot.param1, 0.0))
    elif command == YAW:
        facing.turn(fleet, craft, slot.param1, slot.param2, int(slot.param3), slot.param4 > 0.0)
        craft.condition = (command, 0.0)


def announce(fleet: Fleet, craft: Craft, seq: int) -> None:
    """Send the text of an item that starts (AP_Mission::start_command)."""
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, f"Mission: {seq} {NAMES[craft.mission[seq].command]}")


def done(fleet: Fleet, craft: Craft, seq: int) -> None:
    """Report one completed command, unless it is for a device that is not fitted."""
    command = craft.mission[seq].command
    if command not in FITTINGS or command in TOLD:
        craft.untold = 0
        fleet.send(craft, dialect.MAVLink_mission_item_reached_message(seq))


def drop(fleet: Fleet, craft: Craft) -> None:
    """Drop the pending commands."""
    craft.do_next = 0
    craft.condition = (0, 0.0)
    fleet.timer(craft, Timer.CONDITION)


def run(fleet: Fleet, craft: Craft, seq: int) -> None:
    """Run the commands from `seq` on, up to a navigation command or a condition that is not met yet.

    A jump back to one of them ends the run: ArduCopter would repeat them until the next navigation command.
    """
    place = next_do(craft, seq)
    seen: set[int] = set()
    while place is not None and place not in seen:
        seen.add(place)
        start(fleet, craft, place)
        if craft.condition[0] and not _condition_met(fleet, craft):
            craft.do_next = place
            fleet.timer(craft, Timer.CONDITION, fleet.now + _CHECK_NS)
            return
        craft.condition = (0, 0.0)
        done(fleet, craft, place)
        place = next_do(craft, place + 1)
    craft.do_next = 0


def look(fleet: Fleet, craft: Craft) -> None:
    """Check the condition again when the timer expires, and continue if it is met."""
    if craft.do_next == 0 or craft.flown is None:
        return
    if not _condition_met(fleet, craft):
        fleet.timer(craft, Timer.CONDITION, fleet.now + _CHECK_NS)
        return
    seq = craft.do_next
    drop(fleet, craft)
    if seq < len(craft.mission):
        done(fleet, craft, seq)
        run(fleet, craft, seq + 1)


def _condition_met(fleet: Fleet, craft: Craft) -> bool:
    kind, value = craft.condition
    if kind == WAIT:
        return fleet.now > value
    if kind == NEAR:
        return distance_m(fleet, craft) < value
    return kind != YAW or facing.turned(fleet, craft)


def distance_m(fleet: Fleet, craft: Craft) -> float:
    """Return the horizontal distance to the present destination (ModeAuto::wp_distance_m); 0 without one."""
    if not craft.paused and fleet.control(craft) not in (Control.LEG, Control.POSITION, Control.CIRCLE):
        return 0.0
    here, goal = fleet.position(craft), fleet.flight["target_pos"][craft.row].tolist()
    return math.hypot(goal[0] - here[0], goal[1] - here[1])


def change_speed(fleet: Fleet, craft: Craft, kind: int, speed_mps: float) -> bool:
    """Set the horizontal (0, 1), climb (2) or descent (3) speed until the mode changes; `False` for other kinds."""
    name = {0: "speed_xy", 1: "speed_xy", 2: "speed_up", 3: "speed_down"}.get(kind)
    if name is None:
        return False
    if speed_mps >= _SPEED_MIN_MPS:
        fleet.flight[name][craft.row] = min(speed_mps, _SPEED_MAX_MPS)
        fleet.flight["replan"][craft.row] = 1
    return True


def look_at(fleet: Fleet, craft: Craft, frame: int, lat_e7: int, lon_e7: int, alt_m: float) -> None:
    """Set a region of interest, or clear it where all values are zero (AutoYaw::set_roi)."""
    if lat_e7 == 0 and lon_e7 == 0 and alt_m == 0.0:
        facing.look_at(fleet, craft, None)
    else:
        facing.look_at(fleet, craft, places.enu(fleet, craft, frame, lat_e7, lon_e7, alt_m))


def _set_home(fleet: Fleet, craft: Craft, slot: Slot) -> None:
    here = slot.param1 == 1.0 or (slot.x == 0 and slot.y == 0 and slot.z == 0.0)
    place = None if here else places.enu(fleet, craft, slot.frame, slot.x, slot.y, slot.z)
    home.set_home(fleet, craft, fleet.position(craft) if place is None else place, slot.causes, lock=False)


def clock_wait_s(fleet: Fleet, hour: float, minute: float, second: float) -> float:
    """Return seconds until a time of day in UTC; a part of -1 matches any value (AP_RTC::get_time_utc)."""
    today_s = fleet.epoch.utc_us(fleet.now) / 1e6 % 86_400.0
    now = (int(today_s // 3600), int(today_s // 60 % 60), int(today_s % 60))
    asked = (int(hour), int(minute), int(second))
    if all(part == -1 for part in asked):
        return 0.0
    period = 86_400 if asked[0] != -1 else (3_600 if asked[1] != -1 else 60)
    then = [ask if ask != -1 else part for ask, part in zip(asked, now, strict=True)]
    return ((then[0] * 3600 + then[1] * 60 + then[2]) - int(today_s)) % period


WAIT_MAX_NS: Final = int(_WAIT_MAX_S) * NS_PER_S
