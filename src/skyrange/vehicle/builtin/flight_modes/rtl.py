"""RTL: climb, return, loiter, then descend and land.

After ArduCopter/mode_rtl.cpp (`build_path`, `compute_return_target`, `run`): the return altitude is RTL_ALT above
home, lowered by the cone near home and to the fence, never below the present height. The destination may be a rally
point. Used by the mode and by the mission command.
"""

from __future__ import annotations

from skyrange.core import elementary
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin import fence, locations, loop
from skyrange.vehicle.builtin.fleet import Fleet, SubMode, Timer, Vehicle
from skyrange.vehicle.builtin.guidance import auto_yaw, wpnav
from skyrange.vehicle.builtin.layout import AutoYawMode, ControlMode

_ALT_MIN_M = 0.3  # config.h RTL_ALT_MIN
_CHECK_NS = 20 * NS_PER_MS
_MIN_CONE_SLOPE = 0.5  # config.h RTL_MIN_CONE_SLOPE


def start(fleet: Fleet, vehicle: Vehicle) -> None:
    """Start the return of a flying aircraft with the climb from its stopping point."""
    fleet.set_default_limits(vehicle)
    vehicle.return_target = locations.best_rally_or_home(fleet, vehicle)
    speed = fleet.param(vehicle, "RTL_SPEED") * 0.01
    if speed > 0.0:
        fleet.flight["speed_xy"][vehicle.row] = speed
    vehicle.submode = SubMode.INITIAL_CLIMB
    auto_yaw.set_mode(fleet, vehicle, AutoYawMode.HOLD)
    # as a Location, so a return that begins above home has legs of a centimetre, which take a second each (build_path)
    east, north, _ = locations.truncated(
        fleet, vehicle, wpnav.stopping_point_of(fleet.estimate, fleet.flight, fleet.settings, vehicle.row)
    )
    height = _return_altitude(fleet, vehicle, east, north)
    _start_leg(fleet, vehicle, (east, north, height), anew=True)
    # it turns home before the climb has stopped (climb_start)
    home = locations.as_array((*locations.truncated(fleet, vehicle, vehicle.return_target)[:2], height))
    wpnav.queue_leg(fleet.flight, fleet.legs, fleet.settings, vehicle.row, home)


def _start_leg(fleet: Fleet, vehicle: Vehicle, goal: tuple[float, float, float], *, anew: bool) -> None:
    wpnav.start_leg(
        fleet.estimate, fleet.flight, fleet.legs, fleet.settings, vehicle.row, locations.as_array(goal), anew
    )


def _return_altitude(fleet: Fleet, vehicle: Vehicle, east: float, north: float) -> float:
    """Return the altitude of the return, m above the origin (compute_return_target, in whole centimetres)."""
    home_up = vehicle.home[2]
    to_east, to_north, to_up = vehicle.return_target
    now = int((fleet.position(vehicle)[2] - home_up) * 100.0) * 0.01
    least = max(_ALT_MIN_M, now + fleet.param(vehicle, "RTL_CLIMB_MIN") * 0.01)
    height = max(fleet.param(vehicle, "RTL_ALT") * 0.01, least, to_up - home_up, 0.0)
    slope = fleet.param(vehicle, "RTL_CONE_SLOPE")
    if slope >= _MIN_CONE_SLOPE:
        height = min(height, max(elementary.hypot(east - to_east, north - to_north) * slope, least))
    return home_up + max(min(height, fence.safe_alt_max_m(fleet, vehicle)), now)


def on_destination_reached(fleet: Fleet, vehicle: Vehicle) -> None:
    """Continue with the next sub-mode when a leg is complete."""
    if vehicle.submode == SubMode.INITIAL_CLIMB:
        vehicle.submode = SubMode.RETURN_HOME
        up = float(fleet.flight["target_pos"][vehicle.row, 2])
        auto_yaw.set_mode_to_default(fleet, vehicle, returning=True)
        _start_leg(fleet, vehicle, (*locations.truncated(fleet, vehicle, vehicle.return_target)[:2], up), anew=False)
    elif vehicle.submode == SubMode.RETURN_HOME:
        vehicle.submode = SubMode.LOITER_AT_HOME
        auto_yaw.set_to_armed_yaw(fleet, vehicle)
        fleet.set_timer(vehicle, Timer.HOLD, fleet.now + int(fleet.param(vehicle, "RTL_LOIT_TIME")) * NS_PER_MS)


def on_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """End the loiter once the nose is at the yaw of arming: land, or descend to RTL_ALT_FINAL and stay."""
    if not auto_yaw.reached_armed_yaw(fleet, vehicle):
        fleet.set_timer(vehicle, Timer.HOLD, fleet.now + _CHECK_NS)
        return
    final = fleet.param(vehicle, "RTL_ALT_FINAL") * 0.01
    auto_yaw.set_mode(fleet, vehicle, AutoYawMode.HOLD)
    if final <= 0.0:
        vehicle.submode = SubMode.LAND
        fleet.set_default_limits(vehicle)
        loop.init_reference(fleet.estimate, fleet.flight, vehicle.row)
        fleet.set_control(vehicle, ControlMode.LAND)
        return
    vehicle.submode = SubMode.FINAL_DESCENT
    _start_leg(
        fleet, vehicle, (vehicle.return_target[0], vehicle.return_target[1], vehicle.home[2] + final), anew=False
    )
