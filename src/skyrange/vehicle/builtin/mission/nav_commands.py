"""Navigation commands of a mission: how each one starts, and what completes it.

After ArduCopter/mode_auto.cpp (`do_…`, `verify_…`, `set_next_wp`, `loc_from_cmd`).
"""

from __future__ import annotations

import math

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_MS, from_seconds
from skyrange.vehicle.builtin import do_items, facing, loop, places, returning, wpnav
from skyrange.vehicle.builtin.arming import take_off
from skyrange.vehicle.builtin.fleet import Craft, Fleet, Slot, Stage, Timer
from skyrange.vehicle.builtin.layout import Control, Flag, Heading
from skyrange.vehicle.builtin.mission_kinds import (
    DELAY,
    LAND,
    RTL,
    SPLINE,
    TAKEOFF,
    TIME,
    TO_ALT,
    TURNS,
    UNLIM,
    WAYPOINT,
)

_WITHOUT_STOP = frozenset((WAYPOINT, UNLIM, TIME))
"""Commands that a leg continues to without a stop (set_next_wp)."""
_CHECK_NS = 20 * NS_PER_MS
_NEAR_EDGE_M = 3.0  # circle_movetoedge_start
_INSIDE_M = 5.0

Vector = tuple[float, float, float]


def goal_of(fleet: Fleet, craft: Craft, slot: Slot, default: Vector) -> Vector:
    """Return a command's place, ENU metres; latitude and longitude both 0, or altitude 0, mean those of `default`."""
    east, north, up = default
    if slot.x != 0 or slot.y != 0:
        east, north = fleet.origin.enu_of(slot.x * 1e-7, slot.y * 1e-7)
    if slot.z != 0.0:
        up = slot.z + places.datum_m(fleet, craft, slot.frame)
    return east, north, up


def _is_terrain_alt(slot: Slot) -> bool:
    return slot.frame in places.TERRAIN_FRAMES


def _default_location(fleet: Fleet, craft: Craft) -> Vector:
    """Return the place that a command without one means: the destination reached, or the present position."""
    row = craft.row
    if fleet.control(craft) == Control.LEG and fleet.legs["reached"][row]:
        east, north, up = fleet.legs["goal"][row].tolist()
        return east, north, up
    return fleet.position(craft)


def begin(fleet: Fleet, craft: Craft, slot: Slot, after: Slot | None, then: Slot | None) -> bool:
    """Start a command; `False` where it is complete at once. `after` and `then` are the navigation commands behind it.

    On the ground only a take-off moves the aircraft, and only once `auto_armed`; other commands wait.
    """
    command = slot.command
    landed = fleet.landed(craft)
    craft.target_causes = slot.causes or craft.mode_causes
    if command == TAKEOFF:
        here = fleet.position(craft)
        up = max(goal_of(fleet, craft, slot, here)[2], here[2] + (1.0 if landed else 0.0))
        if not landed or craft.ready:
            take_off(fleet, craft, up)
        return True
    if command == DELAY:
        _do_nav_delay(fleet, craft, slot)
        return True
    if landed:  # these are complete at once, as in ArduPilot's verify_land and RTL::run
        return command not in (RTL, LAND)
    if command in (WAYPOINT, UNLIM, TIME, TO_ALT):
        goal = goal_of(fleet, craft, slot, _default_location(fleet, craft))
        _set_wp_destination(fleet, craft, goal)
        facing.keep_or_default(fleet, craft)
        if command == WAYPOINT:
            _set_next_wp(fleet, craft, slot, goal, after, then)
        elif command == TO_ALT:
            fleet.timer(craft, Timer.HOLD, fleet.now + _CHECK_NS)
    elif command == SPLINE:
        _do_spline_wp(fleet, craft, slot, after, then)
    elif command == TURNS:
        _do_circle(fleet, craft, slot)
    elif command == RTL:
        returning.start(fleet, craft)
    elif slot.x == 0 and slot.y == 0:
        _start_landing(fleet, craft)
    else:
        craft.stage = Stage.TRANSIT
        east, north = fleet.origin.enu_of(slot.x * 1e-7, slot.y * 1e-7)
        _set_wp_destination(fleet, craft, (east, north, fleet.position(craft)[2]))
        facing.keep_or_default(fleet, craft)
    return True


def _set_wp_destination(fleet: Fleet, craft: Craft, goal: Vector) -> None:
    anew = fleet.control(craft) != Control.LEG
    wpnav.fly_to(fleet.estimate, fleet.flight, fleet.legs, fleet.settings, craft.row, places.array(goal), anew)
    craft.stage = Stage.TRANSIT if craft.stage == Stage.TRANSIT else Stage.NONE


def _set_next_wp(fleet: Fleet, craft: Craft, slot: Slot, goal: Vector, after: Slot | None, then: Slot | None) -> None:
    """Continue to the next command without a stop, unless a wait or another datum lies between (set_next_wp)."""
    if slot.param1 > 0.0 or after is None:
        return
    if after.command in _WITHOUT_STOP and _is_terrain_alt(after) == _is_terrain_alt(slot):
        place = goal_of(fleet, craft, after, goal)
        wpnav.fly_on_to(fleet.flight, fleet.legs, fleet.settings, craft.row, places.array(place))
    elif after.command == SPLINE and _is_terrain_alt(after) == _is_terrain_alt(slot):
        place, beyond, curved = _spline_points(fleet, craft, after, goal, then)
        wpnav.curve_on(fleet.flight, fleet.legs, craft.row, places.array(place), places.array(beyond), curved)


def _spline_points(
    fleet: Fleet, craft: Craft, slot: Slot, default: Vector, after: Slot | None
) -> tuple[Vector, Vector, bool]:
    """Return (destination, the point that follows, whether on a curve) of a spline command (get_spline_from_cmd)."""
    goal = goal_of(fleet, craft, slot, default)
    if slot.param1 == 0.0 and after is not None and _is_terrain_alt(after) == _is_terrain_alt(slot):
        return goal, goal_of(fleet, craft, after, goal), after.command == SPLINE
    return goal, goal, False


def _do_spline_wp(fleet: Fleet, craft: Craft, slot: Slot, after: Slot | None, then: Slot | None) -> None:
    goal, beyond, curved = _spline_points(fleet, craft, slot, _default_location(fleet, craft), after)
    wpnav.curve(
        fleet.estimate, fleet.flight, fleet.legs, fleet.settings, craft.row,
        places.array(goal), places.array(beyond), curved,
    )  # fmt: skip
    _set_next_wp(fleet, craft, slot, goal, after, then)
    facing.keep_or_default(fleet, craft)


def _do_circle(fleet: Fleet, craft: Craft, slot: Slot) -> None:
    """Fly to the edge of the circle, then around it (do_circle, circle_movetoedge_start)."""
    row, flight = craft.row, fleet.flight
    here = fleet.position(craft)
    centre = goal_of(fleet, craft, slot, here)
    radius = abs(slot.param3) or fleet.param(craft, "CIRCLE_RADIUS") * 0.01
    rate = math.radians(abs(fleet.param(craft, "CIRCLE_RATE")))
    flight["centre"][row] = centre
    flight["circle_radius"][row] = radius
    flight["circle_rate"][row] = -rate if slot.param3 < 0.0 else rate
    stop = wpnav.rest_at(fleet.estimate, flight, fleet.settings, row)
    away = math.dist(stop, centre)
    if away > 1e-6:
        east, north = (c + (s - c) / away * radius for c, s in zip(centre[:2], stop[:2], strict=True))
    else:
        yaw = float(fleet.estimate["yaw"][row])
        east, north = centre[0] - radius * math.cos(yaw), centre[1] - radius * math.sin(yaw)
    if away <= _NEAR_EDGE_M:  # ArduPilot uses the distance to the centre here, not to the edge
        _start_circle(fleet, craft)
        return
    craft.stage = Stage.TRANSIT
    _set_wp_destination(fleet, craft, (east, north, centre[2]))
    if facing.kind(fleet, craft) != Heading.ROI:
        off = math.hypot(here[0] - centre[0], here[1] - centre[1])
        if off > radius and off > _INSIDE_M:
            facing.default(fleet, craft)
        else:
            facing.set_kind(fleet, craft, Heading.HOLD)


def _start_circle(fleet: Fleet, craft: Craft) -> None:
    row, flight = craft.row, fleet.flight
    craft.stage = Stage.NONE
    east, north, up = wpnav.rest_at(fleet.estimate, flight, fleet.settings, row)
    flight["ref_pos"][row] = (east, north, up)
    flight["ref_vel"][row] = flight["ref_acc"][row] = 0.0
    centre = flight["centre"][row]
    if flight["circle_radius"][row] > 0.0:
        flight["circle_angle"][row] = math.atan2(north - centre[1], east - centre[0])
    else:
        flight["circle_angle"][row] = fleet.estimate["yaw"][row]
    flight["circle_speed"][row] = flight["circle_total"][row] = 0.0
    craft.circles = -1
    if facing.kind(fleet, craft) != Heading.ROI:
        along = int(fleet.param(craft, "CIRCLE_OPTIONS")) & 2
        facing.set_kind(fleet, craft, Heading.NEXT if along else Heading.CIRCLE)
    fleet.fly(craft, Control.CIRCLE)
    flight["target_pos"][row] = (east, north, up)
    fleet.timer(craft, Timer.HOLD, fleet.now + _CHECK_NS)


def _do_nav_delay(fleet: Fleet, craft: Craft, slot: Slot) -> None:
    """Wait in place, in the air or on the ground: for some seconds, or until a time of day (do_nav_delay)."""
    wait_s = slot.param1 if slot.param1 > 0.0 else do_items.clock_wait_s(fleet, slot.param2, slot.param3, slot.param4)
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, f"Delaying {int(wait_s)} sec")
    fleet.timer(craft, Timer.HOLD, fleet.now + min(from_seconds(min(wait_s, 1e8)), do_items.WAIT_MAX_NS))


def _start_landing(fleet: Fleet, craft: Craft) -> None:
    craft.stage = Stage.LAND
    loop.hold(fleet.estimate, fleet.flight, craft.row)
    facing.set_kind(fleet, craft, Heading.HOLD)
    fleet.fly(craft, Control.LAND)


def on_flag(fleet: Fleet, craft: Craft, slot: Slot, flag: Flag) -> bool:
    """Process an event of the loop while a command is flown; whether it completes the command."""
    command = slot.command
    if flag is Flag.CLIMBED:
        return bool(command == TAKEOFF)
    if flag is Flag.LEVELLED:
        return bool(command == TO_ALT)
    if flag is not Flag.ARRIVED:
        return False
    if command in (WAYPOINT, SPLINE, TIME):
        if slot.param1 > 0.0:
            fleet.timer(craft, Timer.HOLD, fleet.now + from_seconds(slot.param1))
            return False
        return True
    if command == TURNS:
        _start_circle(fleet, craft)
    elif command == LAND:
        _start_landing(fleet, craft)
    elif command == RTL:
        returning.arrived(fleet, craft)
        return craft.stage == Stage.DESCEND
    return False


def waited(fleet: Fleet, craft: Craft, slot: Slot) -> bool:
    """Process the expiry of the command's timer; whether it completes the command."""
    row, flight = craft.row, fleet.flight
    if slot.command == RTL:
        returning.waited(fleet, craft)
        return False
    if slot.command == TURNS:
        flown = abs(float(flight["circle_total"][row])) / (2.0 * math.pi)
        if int(flown) != craft.circles:
            craft.circles = int(flown)
            words = f"Mission: starting circle {craft.circles + 1}/{int(slot.param1)}"
            fleet.text(craft, dialect.MAV_SEVERITY_INFO, words)
        if flown >= slot.param1:
            return True
        fleet.timer(craft, Timer.HOLD, fleet.now + _CHECK_NS)
        return False
    if slot.command == TO_ALT:
        if fleet.control(craft) == Control.LEG:
            if do_items.distance_m(fleet, craft) < fleet.param(craft, "WPNAV_RADIUS") * 0.01:
                _start_loiter_to_alt(fleet, craft, slot)
            else:
                fleet.timer(craft, Timer.HOLD, fleet.now + _CHECK_NS)
        return False
    return True


def _start_loiter_to_alt(fleet: Fleet, craft: Craft, slot: Slot) -> None:
    row, flight = craft.row, fleet.flight
    up = slot.z + places.datum_m(fleet, craft, slot.frame)
    flight["flags"][row] &= ~np.int64(Flag.LEVELLED)
    flight["seen"][row] &= ~np.int64(Flag.LEVELLED)
    fleet.fly(craft, Control.ALTITUDE)
    flight["target_pos"][row, 2] = up
