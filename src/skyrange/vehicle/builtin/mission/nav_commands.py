"""Navigation commands of a mission: how each one starts, and what completes it.

After ArduCopter/mode_auto.cpp (`do_…`, `verify_…`, `set_next_wp`, `loc_from_cmd`).
"""

from __future__ import annotations

import math

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.core import elementary, elementary_python
from skyrange.core.time import NS_PER_MS, from_seconds
from skyrange.vehicle.builtin import locations, loop
from skyrange.vehicle.builtin.arming.arming import start_takeoff
from skyrange.vehicle.builtin.fleet import Fleet, MissionItem, SubMode, Timer, Vehicle
from skyrange.vehicle.builtin.flight_modes import guided, rtl
from skyrange.vehicle.builtin.guidance import auto_yaw, wpnav
from skyrange.vehicle.builtin.layout import AutoYawMode, ControlMode, FlightEvent
from skyrange.vehicle.builtin.mission import do_commands
from skyrange.vehicle.builtin.mission.command_ids import (
    LANDINGS,
    NAV_ATTITUDE_TIME,
    NAV_DELAY,
    NAV_LOITER_TIME,
    NAV_LOITER_TO_ALT,
    NAV_LOITER_TURNS,
    NAV_LOITER_UNLIM,
    NAV_RETURN_TO_LAUNCH,
    NAV_SPLINE_WAYPOINT,
    NAV_WAYPOINT,
    TAKEOFFS,
)
from skyrange.vehicle.builtin.modes import GUIDED_COMMANDS, NAV_GUIDED_ENABLE

_WITHOUT_STOP = frozenset((NAV_WAYPOINT, NAV_LOITER_UNLIM, NAV_LOITER_TIME))
"""Commands that a leg continues to without a stop (set_next_wp)."""
_CHECK_NS = 20 * NS_PER_MS
_NEAR_EDGE_M = 3.0  # circle_movetoedge_start
_INSIDE_M = 5.0
_MIN_LEAN_RAD = math.radians(10.0)  # nav_attitude_time_run
_TAKEOFF_COMPLETE = int(FlightEvent.TAKEOFF_COMPLETE)

Vector = tuple[float, float, float]


def location_of(fleet: Fleet, vehicle: Vehicle, item: MissionItem, default: Vector) -> Vector:
    """Return a command's place, ENU metres; latitude and longitude both 0, or altitude 0, mean those of `default`."""
    east, north, up = default
    if item.x != 0 or item.y != 0:
        east, north = fleet.origin.enu_of(item.x * 1e-7, item.y * 1e-7)
    if item.z != 0.0:
        up = item.z + locations.altitude_datum_m(fleet, vehicle, item.frame)
    return east, north, up


def _is_terrain_alt(item: MissionItem) -> bool:
    return item.frame in locations.TERRAIN_FRAMES


def _default_location(fleet: Fleet, vehicle: Vehicle) -> Vector:
    """Return the place that a command without one means: the destination reached, or the present position.

    Both are Locations, of whole centimetres and 1e-7 degrees, so a leg to them is often not of no length.
    """
    row = vehicle.row
    if fleet.control(vehicle) == ControlMode.LEG and fleet.legs["reached_destination"][row]:
        east, north, up = fleet.legs["destination"][row].tolist()
        return locations.rounded_destination(fleet, vehicle, (east, north, up))
    return locations.truncated(fleet, vehicle, fleet.position(vehicle))


def start_command(
    fleet: Fleet, vehicle: Vehicle, item: MissionItem, after: MissionItem | None, then: MissionItem | None
) -> bool:
    """Start a command; `False` where it is complete at once. `after` and `then` are the navigation commands behind it.

    On the ground only a take-off moves the aircraft, and only once `auto_armed`; other commands wait.
    """
    command = item.command
    landed = fleet.landed(vehicle)
    vehicle.target_causes = item.causes or vehicle.mode_causes
    if command in TAKEOFFS:
        here = fleet.position(vehicle)
        up = max(location_of(fleet, vehicle, item, here)[2], here[2] + (1.0 if landed else 0.0))
        if not landed or vehicle.auto_armed:
            start_takeoff(fleet, vehicle, up)
        return True
    if command == NAV_DELAY:
        _do_nav_delay(fleet, vehicle, item)
        return True
    if command in GUIDED_COMMANDS:
        return _do_guided(fleet, vehicle, item)
    if command == NAV_ATTITUDE_TIME:
        _do_nav_attitude_time(fleet, vehicle, item)
        return True
    if landed:  # these are complete at once, as in ArduPilot's verify_land and RTL::run
        return command != NAV_RETURN_TO_LAUNCH and command not in LANDINGS
    if command in (NAV_WAYPOINT, NAV_LOITER_UNLIM, NAV_LOITER_TIME, NAV_LOITER_TO_ALT):
        goal = location_of(fleet, vehicle, item, _default_location(fleet, vehicle))
        _set_wp_destination(fleet, vehicle, goal)
        auto_yaw.keep_roi_or_default(fleet, vehicle)
        if command == NAV_WAYPOINT:
            _set_next_wp(fleet, vehicle, item, goal, after, then)
        elif command == NAV_LOITER_TO_ALT:
            for name, parameter in (("speed_up", "WPNAV_SPEED_UP"), ("speed_down", "WPNAV_SPEED_DN")):
                fleet.flight[name][vehicle.row] = fleet.param(vehicle, parameter) * 0.01
            fleet.set_timer(vehicle, Timer.HOLD, fleet.now + _CHECK_NS)
    elif command == NAV_SPLINE_WAYPOINT:
        _do_spline_wp(fleet, vehicle, item, after, then)
    elif command == NAV_LOITER_TURNS:
        _do_circle(fleet, vehicle, item)
    elif command == NAV_RETURN_TO_LAUNCH:
        rtl.start(fleet, vehicle)
    elif item.x == 0 and item.y == 0:
        _start_landing(fleet, vehicle, item)
    else:
        vehicle.submode = SubMode.TRANSIT
        east, north = fleet.origin.enu_of(item.x * 1e-7, item.y * 1e-7)
        up = locations.truncated(fleet, vehicle, fleet.position(vehicle))[2]
        _set_wp_destination(fleet, vehicle, (east, north, up))
        auto_yaw.keep_roi_or_default(fleet, vehicle)
    return True


def _set_wp_destination(fleet: Fleet, vehicle: Vehicle, goal: Vector) -> None:
    """Fly to a point, after a take-off from the point where that ends (ModeAuto::wp_start)."""
    row, flight = vehicle.row, fleet.flight
    anew = fleet.control(vehicle) != ControlMode.LEG
    if anew:
        climbed = fleet.control(vehicle) == ControlMode.TAKEOFF and int(flight["flags"][row]) & _TAKEOFF_COMPLETE
        top = (*flight["ref_pos"][row, :2].tolist(), float(flight["target_pos"][row, 2]))
        fleet.set_default_limits(vehicle)
        do_commands.restore_speeds(fleet, vehicle)
        if climbed:
            wpnav.begin_at(fleet.estimate, flight, fleet.legs, fleet.settings, row, locations.as_array(top))
            anew = False
    wpnav.start_leg(fleet.estimate, flight, fleet.legs, fleet.settings, row, locations.as_array(goal), anew)
    vehicle.submode = SubMode.TRANSIT if vehicle.submode == SubMode.TRANSIT else SubMode.NONE


def _reset_climb_speeds(fleet: Fleet, vehicle: Vehicle) -> None:
    """Before a leg that starts anew by itself, set all speeds but the horizontal to their defaults (AC_WPNav)."""
    if fleet.control(vehicle) != ControlMode.LEG:
        speed_xy = float(fleet.flight["speed_xy"][vehicle.row])
        fleet.set_default_limits(vehicle)
        fleet.flight["speed_xy"][vehicle.row] = speed_xy


def _set_next_wp(
    fleet: Fleet, vehicle: Vehicle, item: MissionItem, goal: Vector, after: MissionItem | None, then: MissionItem | None
) -> None:
    """Continue to the next command without a stop, unless a wait or another datum lies between (set_next_wp)."""
    if item.param1 > 0.0 or after is None:
        return
    if after.command in _WITHOUT_STOP and _is_terrain_alt(after) == _is_terrain_alt(item):
        place = location_of(fleet, vehicle, after, goal)
        wpnav.queue_leg(fleet.flight, fleet.legs, fleet.settings, vehicle.row, locations.as_array(place))
    elif after.command == NAV_SPLINE_WAYPOINT and _is_terrain_alt(after) == _is_terrain_alt(item):
        place, beyond, curved = _spline_points(fleet, vehicle, after, goal, then)
        wpnav.queue_spline(
            fleet.flight, fleet.legs, vehicle.row, locations.as_array(place), locations.as_array(beyond), curved
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
    _reset_climb_speeds(fleet, vehicle)
    wpnav.start_spline(
        fleet.estimate, fleet.flight, fleet.legs, fleet.settings, vehicle.row,
        locations.as_array(goal), locations.as_array(beyond), curved,
    )  # fmt: skip
    _set_next_wp(fleet, vehicle, item, goal, after, then)
    auto_yaw.keep_roi_or_default(fleet, vehicle)


def _do_circle(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> None:
    """Fly to the edge of the circle, then around it (do_circle, circle_movetoedge_start)."""
    row, flight = vehicle.row, fleet.flight
    here = fleet.position(vehicle)
    centre = location_of(fleet, vehicle, item, locations.truncated(fleet, vehicle, here))
    _reset_climb_speeds(fleet, vehicle)
    radius = abs(item.param3) or fleet.param(vehicle, "CIRCLE_RADIUS") * 0.01
    rate = math.radians(abs(fleet.param(vehicle, "CIRCLE_RATE")))
    flight["centre"][row] = centre
    flight["circle_radius"][row] = radius
    flight["circle_rate"][row] = -rate if item.param3 < 0.0 else rate
    stop = wpnav.stopping_point_of(fleet.estimate, flight, fleet.settings, row)
    away = elementary_python.distance(stop, centre)
    if away > 1e-6:
        east, north = (c + (s - c) / away * radius for c, s in zip(centre[:2], stop[:2], strict=True))
    else:
        yaw = float(fleet.estimate["yaw"][row])
        east, north = centre[0] - radius * elementary.cos(yaw), centre[1] - radius * elementary.sin(yaw)
    if away <= _NEAR_EDGE_M:  # ArduPilot uses the distance to the centre here, not to the edge
        _start_circle(fleet, vehicle)
        return
    vehicle.submode = SubMode.TRANSIT
    edge = locations.as_array((east, north, centre[2]))
    anew = fleet.control(vehicle) != ControlMode.LEG
    wpnav.start_leg(fleet.estimate, flight, fleet.legs, fleet.settings, row, edge, anew)
    if auto_yaw.mode(fleet, vehicle) != AutoYawMode.ROI:
        off = elementary.hypot(here[0] - centre[0], here[1] - centre[1])
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
        flight["circle_angle"][row] = elementary.atan2(north - centre[1], east - centre[0])
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
        else do_commands.seconds_until_utc(fleet, vehicle, item.param2, item.param3, item.param4)
    )
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, f"Delaying {int(wait_s)} sec")
    fleet.set_timer(vehicle, Timer.HOLD, fleet.now + min(from_seconds(min(wait_s, 1e8)), do_commands.MAX_WAIT_NS))


def _start_landing(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> None:
    """Descend; an item with a place counts the height from its altitude (ModeAuto::get_alt_above_ground_cm)."""
    vehicle.submode = SubMode.LAND
    loop.init_reference(fleet.estimate, fleet.flight, vehicle.row)
    fleet.set_default_limits(vehicle)
    auto_yaw.set_mode(fleet, vehicle, AutoYawMode.HOLD)
    fleet.set_control(vehicle, ControlMode.LAND)
    if item.x != 0 or item.y != 0:
        ground = float(fleet.estimate["pos"][vehicle.row, 2] - fleet.estimate["height"][vehicle.row])
        above = item.z + locations.altitude_datum_m(fleet, vehicle, item.frame) - ground
        fleet.flight["land_datum"][vehicle.row] = above


def _do_guided(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> bool:
    """Hold, and obey the targets of GUIDED until a limit or the time is reached (nav_guided_start, do_nav_script_time).

    There is no script here: NAV_SCRIPT_TIME ends by its time alone, as in an ArduCopter without its script.
    """
    if item.command == NAV_GUIDED_ENABLE and item.param1 == 0.0:
        return False
    here = fleet.position(vehicle)
    vehicle.guided_start = (here[0], here[1], fleet.now)
    if not fleet.landed(vehicle):
        guided.hold_velocity(fleet, vehicle)
    if item.command == NAV_GUIDED_ENABLE:
        fleet.set_timer(vehicle, Timer.HOLD, fleet.now + _CHECK_NS)
    elif item.param2 > 0.0:
        fleet.set_timer(vehicle, Timer.HOLD, fleet.now + from_seconds(item.param2))
    return True


def _guided_limit_reached(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether a limit of DO_GUIDED_LIMITS is exceeded (ModeGuided::limit_check)."""
    seconds, lowest, highest, away = vehicle.guided_limits
    east, north, since = vehicle.guided_start
    here = fleet.position(vehicle)
    return (
        (seconds > 0.0 and fleet.now - since >= from_seconds(seconds))
        or (lowest != 0.0 and here[2] < lowest)
        or (highest != 0.0 and here[2] > highest)
        or (away > 0.0 and elementary.hypot(here[0] - east, here[1] - north) > away)
    )


def _do_nav_attitude_time(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> None:
    """Keep an attitude and a climb rate for a time (do_nav_attitude_time, nav_attitude_time_run)."""
    row, flight = vehicle.row, fleet.flight
    fleet.set_timer(vehicle, Timer.HOLD, fleet.now + from_seconds(item.param1))
    if fleet.landed(vehicle):
        return
    roll, pitch, yaw = math.radians(item.param2), math.radians(item.param3), math.radians(item.param4)
    lean, most = (
        elementary.hypot(roll, pitch),
        max(_MIN_LEAN_RAD, math.radians(fleet.param(vehicle, "ANGLE_MAX") * 0.01)),
    )
    if lean > most:
        roll, pitch = roll * most / lean, pitch * most / lean
    fleet.set_control(vehicle, ControlMode.ATTITUDE)
    flight["guided_quat"][row] = guided.frd_ned_to_flu_enu(*guided.quaternion_of_euler(roll, pitch, yaw))
    flight["guided_ang_vel"][row] = 0.0
    flight["rates_only"][row] = 0
    climb_mps = min(max(float(item.x), -float(flight["speed_down"][row])), float(flight["speed_up"][row]))
    flight["guided_climb_rate"][row] = climb_mps


def verify_event(fleet: Fleet, vehicle: Vehicle, item: MissionItem, flag: FlightEvent) -> bool:
    """Process an event of the loop while a command is flown; whether it completes the command."""
    command = item.command
    if flag is FlightEvent.TAKEOFF_COMPLETE:
        return command in TAKEOFFS
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
    elif command in LANDINGS:
        _start_landing(fleet, vehicle, item)
    elif command == NAV_RETURN_TO_LAUNCH:
        rtl.on_destination_reached(fleet, vehicle)
        return vehicle.submode == SubMode.FINAL_DESCENT
    return False


def verify_timer(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> bool:
    """Process the expiry of the command's timer; whether it completes the command."""
    row, flight = vehicle.row, fleet.flight
    if item.command == NAV_RETURN_TO_LAUNCH and not fleet.landed(vehicle):
        rtl.on_timer(fleet, vehicle)
        return False
    if item.command == NAV_GUIDED_ENABLE and item.param1 > 0.0 and not _guided_limit_reached(fleet, vehicle):
        fleet.set_timer(vehicle, Timer.HOLD, fleet.now + _CHECK_NS)
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
    """Climb or descend in place, at speeds that a command since the start of the item may have set."""
    row, flight = vehicle.row, fleet.flight
    up = item.z + locations.altitude_datum_m(fleet, vehicle, item.frame)
    fleet.set_default_level_limits(vehicle)
    flight["flags"][row] &= ~np.int64(FlightEvent.ALTITUDE_REACHED)
    flight["handled_flags"][row] &= ~np.int64(FlightEvent.ALTITUDE_REACHED)
    fleet.set_control(vehicle, ControlMode.LOITER_TO_ALT)
    flight["target_pos"][row, 2] = up
