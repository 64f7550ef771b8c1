"""Navigation commands of a mission: how each one starts, and what completes it.

After ArduCopter/mode_auto.cpp (`do_…`, `verify_…`, `set_next_wp`, `loc_from_cmd`).
"""

from __future__ import annotations

import math

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_MS, from_seconds
from skyrange.vehicle.builtin import loop
from skyrange.vehicle.builtin.arming.arming import start_takeoff
from skyrange.vehicle.builtin.fleet import Fleet, MissionItem, SubMode, Timer, Vehicle
from skyrange.vehicle.builtin.flight_modes import rtl
from skyrange.vehicle.builtin.guidance import auto_yaw, wpnav
from skyrange.vehicle.builtin.layout import AutoYawMode, ControlMode, FlightEvent
from skyrange.vehicle.builtin.locations import location
from skyrange.vehicle.builtin.mission import do_commands
from skyrange.vehicle.builtin.mission.command_ids import (
    NAV_DELAY,
    NAV_LAND,
    NAV_LOITER_TIME,
    NAV_LOITER_TO_ALT,
    NAV_LOITER_TURNS,
    NAV_LOITER_UNLIM,
    NAV_RETURN_TO_LAUNCH,
    NAV_SPLINE_WAYPOINT,
    NAV_TAKEOFF,
    NAV_WAYPOINT,
)

_WITHOUT_STOP = frozenset((NAV_WAYPOINT, NAV_LOITER_UNLIM, NAV_LOITER_TIME))
"""Commands that a leg continues to without a stop (set_next_wp)."""
_CHECK_NS = 20 * NS_PER_MS
_NEAR_EDGE_M = 3.0  # circle_movetoedge_start
_INSIDE_M = 5.0

Vector = tuple[float, float, float]


def location_of(fleet: Fleet, vehicle: Vehicle, item: MissionItem, default: Vector) -> Vector:
    """Return a command's place, ENU metres; latitude and longitude both 0, or altitude 0, mean those of `default`."""
    east, north, up = default
    if item.x != 0 or item.y != 0:
        east, north = fleet.origin.enu_of(item.x * 1e-7, item.y * 1e-7)
    if item.z != 0.0:
        up = item.z + location.altitude_datum_m(fleet, vehicle, item.frame)
    return east, north, up


def _is_terrain_alt(item: MissionItem) -> bool:
    return item.frame in location.TERRAIN_FRAMES


def _default_location(fleet: Fleet, vehicle: Vehicle) -> Vector:
    """Return the place that a command without one means: the destination reached, or the present position."""
    row = vehicle.row
    if fleet.control(vehicle) == ControlMode.LEG and fleet.legs["reached_destination"][row]:
        east, north, up = fleet.legs["destination"][row].tolist()
        return east, north, up
    return fleet.position(vehicle)


def start_command(
    fleet: Fleet, vehicle: Vehicle, item: MissionItem, after: MissionItem | None, then: MissionItem | None
) -> bool:
    """Start a command; `False` where it is complete at once. `after` and `then` are the navigation commands behind it.

    On the ground only a take-off moves the aircraft, and only once `auto_armed`; other commands wait.
    """
    command = item.command
    landed = fleet.landed(vehicle)
    vehicle.target_causes = item.causes or vehicle.mode_causes
    if command == NAV_TAKEOFF:
        here = fleet.position(vehicle)
        up = max(location_of(fleet, vehicle, item, here)[2], here[2] + (1.0 if landed else 0.0))
        if not landed or vehicle.auto_armed:
            start_takeoff(fleet, vehicle, up)
        return True
    if command == NAV_DELAY:
        _do_nav_delay(fleet, vehicle, item)
        return True
    if landed:  # these are complete at once, as in ArduPilot's verify_land and RTL::run
        return command not in (NAV_RETURN_TO_LAUNCH, NAV_LAND)
    if command in (NAV_WAYPOINT, NAV_LOITER_UNLIM, NAV_LOITER_TIME, NAV_LOITER_TO_ALT):
        goal = location_of(fleet, vehicle, item, _default_location(fleet, vehicle))
        _set_wp_destination(fleet, vehicle, goal)
        auto_yaw.keep_roi_or_default(fleet, vehicle)
        if command == NAV_WAYPOINT:
            _set_next_wp(fleet, vehicle, item, goal, after, then)
        elif command == NAV_LOITER_TO_ALT:
            fleet.set_timer(vehicle, Timer.HOLD, fleet.now + _CHECK_NS)
    elif command == NAV_SPLINE_WAYPOINT:
        _do_spline_wp(fleet, vehicle, item, after, then)
    elif command == NAV_LOITER_TURNS:
        _do_circle(fleet, vehicle, item)
    elif command == NAV_RETURN_TO_LAUNCH:
        rtl.start(fleet, vehicle)
    elif item.x == 0 and item.y == 0:
        _start_landing(fleet, vehicle)
    else:
        vehicle.submode = SubMode.TRANSIT
        east, north = fleet.origin.enu_of(item.x * 1e-7, item.y * 1e-7)
        _set_wp_destination(fleet, vehicle, (east, north, fleet.position(vehicle)[2]))
        auto_yaw.keep_roi_or_default(fleet, vehicle)
    return True


def _set_wp_destination(fleet: Fleet, vehicle: Vehicle, goal: Vector) -> None:
    anew = fleet.control(vehicle) != ControlMode.LEG
    wpnav.start_leg(
        fleet.estimate, fleet.flight, fleet.legs, fleet.settings, vehicle.row, location.as_array(goal), anew
    )
    vehicle.submode = SubMode.TRANSIT if vehicle.submode == SubMode.TRANSIT else SubMode.NONE


def _set_next_wp(
    fleet: Fleet, vehicle: Vehicle, item: MissionItem, goal: Vector, after: MissionItem | None, then: MissionItem | None
) -> None:
    """Continue to the next command without a stop, unless a wait or another datum lies between (set_next_wp)."""
    if item.param1 > 0.0 or after is None:
        return
    if after.command in _WITHOUT_STOP and _is_terrain_alt(after) == _is_terrain_alt(item):
        place = location_of(fleet, vehicle, after, goal)
        wpnav.queue_leg(fleet.flight, fleet.legs, fleet.settings, vehicle.row, location.as_array(place))
    elif after.command == NAV_SPLINE_WAYPOINT and _is_terrain_alt(after) == _is_terrain_alt(item):
        place, beyond, curved = _spline_points(fleet, vehicle, after, goal, then)
        wpnav.queue_spline(
            fleet.flight, fleet.legs, vehicle.row, location.as_array(place), location.as_array(beyond), curved
        )


def _spline_points(
    fleet: Fleet, vehicle: Vehicle, item: MissionItem, default: Vector, after: MissionItem | None
) -> tuple[Vector, Vector, bool]:
    """Return (destination, the point that follows, whether on a curve) of a spline command (get_spline_from_cmd)."""
    goal = location_of(fleet, vehicle, item, default)
    if item.param1 == 0.0 and after is not None and _is_terrain_alt(after) == _is_terrain_alt(item):
        return goal, location_of(fleet, vehicle, after, goal), after.command == NAV_SPLINE_WAYPOINT
    return goal, goal, False


def _do_spline_wp(
    fleet: Fleet, vehicle: Vehicle, item: MissionItem, after: MissionItem | None, then: MissionItem | None
) -> None:
    goal, beyond, curved = _spline_points(fleet, vehicle, item, _default_location(fleet, vehicle), after)
    wpnav.start_spline(
        fleet.estimate, fleet.flight, fleet.legs, fleet.settings, vehicle.row,
        location.as_array(goal), location.as_array(beyond), curved,
    )  # fmt: skip
    _set_next_wp(fleet, vehicle, item, goal, after, then)
    auto_yaw.keep_roi_or_default(fleet, vehicle)


def _do_circle(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> None:
    """Fly to the edge of the circle, then around it (do_circle, circle_movetoedge_start)."""
    row, flight = vehicle.row, fleet.flight
    here = fleet.position(vehicle)
    centre = location_of(fleet, vehicle, item, here)
    radius = abs(item.param3) or fleet.param(vehicle, "CIRCLE_RADIUS") * 0.01
    rate = math.radians(abs(fleet.param(vehicle, "CIRCLE_RATE")))
    flight["centre"][row] = centre
    flight["circle_radius"][row] = radius
    flight["circle_rate"][row] = -rate if item.param3 < 0.0 else rate
    stop = wpnav.stopping_point_of(fleet.estimate, flight, fleet.settings, row)
    away = math.dist(stop, centre)
    if away > 1e-6:
        east, north = (c + (s - c) / away * radius for c, s in zip(centre[:2], stop[:2], strict=True))
    else:
        yaw = float(fleet.estimate["yaw"][row])
        east, north = centre[0] - radius * math.cos(yaw), centre[1] - radius * math.sin(yaw)
    if away <= _NEAR_EDGE_M:  # ArduPilot uses the distance to the centre here, not to the edge
        _start_circle(fleet, vehicle)
        return
    vehicle.submode = SubMode.TRANSIT
    _set_wp_destination(fleet, vehicle, (east, north, centre[2]))
    if auto_yaw.mode(fleet, vehicle) != AutoYawMode.ROI:
        off = math.hypot(here[0] - centre[0], here[1] - centre[1])
        if off > radius and off > _INSIDE_M:
            auto_yaw.set_mode_to_default(fleet, vehicle)
        else:
            auto_yaw.set_mode(fleet, vehicle, AutoYawMode.HOLD)


def _start_circle(fleet: Fleet, vehicle: Vehicle) -> None:
    row, flight = vehicle.row, fleet.flight
    vehicle.submode = SubMode.NONE
    east, north, up = wpnav.stopping_point_of(fleet.estimate, flight, fleet.settings, row)
    flight["ref_pos"][row] = (east, north, up)
    flight["ref_vel"][row] = flight["ref_acc"][row] = 0.0
    centre = flight["centre"][row]
    if flight["circle_radius"][row] > 0.0:
        flight["circle_angle"][row] = math.atan2(north - centre[1], east - centre[0])
    else:
        flight["circle_angle"][row] = fleet.estimate["yaw"][row]
    flight["circle_ang_vel"][row] = flight["circle_angle_total"][row] = 0.0
    vehicle.circles_completed = -1
    if auto_yaw.mode(fleet, vehicle) != AutoYawMode.ROI:
        along = int(fleet.param(vehicle, "CIRCLE_OPTIONS")) & 2
        auto_yaw.set_mode(fleet, vehicle, AutoYawMode.LOOK_AT_NEXT_WP if along else AutoYawMode.CIRCLE)
    fleet.set_control(vehicle, ControlMode.CIRCLE)
    flight["target_pos"][row] = (east, north, up)
    fleet.set_timer(vehicle, Timer.HOLD, fleet.now + _CHECK_NS)


def _do_nav_delay(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> None:
    """Wait in place, in the air or on the ground: for some seconds, or until a time of day (do_nav_delay)."""
    wait_s = (
        item.param1
        if item.param1 > 0.0
        else do_commands.seconds_until_utc(fleet, item.param2, item.param3, item.param4)
    )
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, f"Delaying {int(wait_s)} sec")
    fleet.set_timer(vehicle, Timer.HOLD, fleet.now + min(from_seconds(min(wait_s, 1e8)), do_commands.MAX_WAIT_NS))


def _start_landing(fleet: Fleet, vehicle: Vehicle) -> None:
    vehicle.submode = SubMode.LAND
    loop.init_reference(fleet.estimate, fleet.flight, vehicle.row)
    auto_yaw.set_mode(fleet, vehicle, AutoYawMode.HOLD)
    fleet.set_control(vehicle, ControlMode.LAND)


def verify_event(fleet: Fleet, vehicle: Vehicle, item: MissionItem, flag: FlightEvent) -> bool:
    """Process an event of the loop while a command is flown; whether it completes the command."""
    command = item.command
    if flag is FlightEvent.TAKEOFF_COMPLETE:
        return bool(command == NAV_TAKEOFF)
    if flag is FlightEvent.ALTITUDE_REACHED:
        return bool(command == NAV_LOITER_TO_ALT)
    if flag is not FlightEvent.DESTINATION_REACHED:
        return False
    if command in (NAV_WAYPOINT, NAV_SPLINE_WAYPOINT, NAV_LOITER_TIME):
        if item.param1 > 0.0:
            fleet.set_timer(vehicle, Timer.HOLD, fleet.now + from_seconds(item.param1))
            return False
        return True
    if command == NAV_LOITER_TURNS:
        _start_circle(fleet, vehicle)
    elif command == NAV_LAND:
        _start_landing(fleet, vehicle)
    elif command == NAV_RETURN_TO_LAUNCH:
        rtl.on_destination_reached(fleet, vehicle)
        return vehicle.submode == SubMode.FINAL_DESCENT
    return False


def verify_timer(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> bool:
    """Process the expiry of the command's timer; whether it completes the command."""
    row, flight = vehicle.row, fleet.flight
    if item.command == NAV_RETURN_TO_LAUNCH:
        rtl.on_timer(fleet, vehicle)
        return False
    if item.command == NAV_LOITER_TURNS:
        flown = abs(float(flight["circle_angle_total"][row])) / (2.0 * math.pi)
        if int(flown) != vehicle.circles_completed:
            vehicle.circles_completed = int(flown)
            text = f"Mission: starting circle {vehicle.circles_completed + 1}/{int(item.param1)}"
            fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, text)
        if flown >= item.param1:
            return True
        fleet.set_timer(vehicle, Timer.HOLD, fleet.now + _CHECK_NS)
        return False
    if item.command == NAV_LOITER_TO_ALT:
        if fleet.control(vehicle) == ControlMode.LEG:
            if do_commands.wp_distance_m(fleet, vehicle) < fleet.param(vehicle, "WPNAV_RADIUS") * 0.01:
                _start_loiter_to_alt(fleet, vehicle, item)
            else:
                fleet.set_timer(vehicle, Timer.HOLD, fleet.now + _CHECK_NS)
        return False
    return True


def _start_loiter_to_alt(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> None:
    row, flight = vehicle.row, fleet.flight
    up = item.z + location.altitude_datum_m(fleet, vehicle, item.frame)
    flight["flags"][row] &= ~np.int64(FlightEvent.ALTITUDE_REACHED)
    flight["handled_flags"][row] &= ~np.int64(FlightEvent.ALTITUDE_REACHED)
    fleet.set_control(vehicle, ControlMode.LOITER_TO_ALT)
    flight["target_pos"][row, 2] = up
