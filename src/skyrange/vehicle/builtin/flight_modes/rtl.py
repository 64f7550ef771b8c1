"""RTL: climb, return, loiter, then descend and land.

After ArduCopter/mode_rtl.cpp (`build_path`, `compute_return_target`, `run`): the return altitude is RTL_ALT above
home, lowered by the cone near home and to the fence, never below the present height. The destination may be a rally
point. Used by the mode and by the mission command.
"""

from __future__ import annotations

import math

from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin import facing, fence, loop, places, rally, wpnav
from skyrange.vehicle.builtin.fleet import Craft, Fleet, Stage, Timer
from skyrange.vehicle.builtin.layout import Control, Heading

_ALT_MIN_M = 0.3  # config.h RTL_ALT_MIN
_CHECK_NS = 20 * NS_PER_MS
_MIN_CONE_SLOPE = 0.5  # config.h RTL_MIN_CONE_SLOPE


def start(fleet: Fleet, craft: Craft) -> None:
    """Start the return of a flying aircraft with the climb from its stopping point."""
    fleet.limits(craft)
    craft.return_to = rally.return_point(fleet, craft)
    speed = fleet.param(craft, "RTL_SPEED") * 0.01
    if speed > 0.0:
        fleet.flight["speed_xy"][craft.row] = speed
    craft.stage = Stage.CLIMB
    facing.set_kind(fleet, craft, Heading.HOLD)
    east, north, up = wpnav.rest_at(fleet.estimate, fleet.flight, fleet.settings, craft.row)
    height = _return_altitude(fleet, craft, east, north, up)
    _start_leg(fleet, craft, (east, north, height), True)
    # it turns home before the climb has stopped (climb_start)
    home = places.array((craft.return_to[0], craft.return_to[1], height))
    wpnav.fly_on_to(fleet.flight, fleet.legs, fleet.settings, craft.row, home)


def _start_leg(fleet: Fleet, craft: Craft, goal: tuple[float, float, float], anew: bool) -> None:
    wpnav.fly_to(fleet.estimate, fleet.flight, fleet.legs, fleet.settings, craft.row, places.array(goal), anew)


def _return_altitude(fleet: Fleet, craft: Craft, east: float, north: float, up: float) -> float:
    """Return the altitude of the return, m above the origin."""
    home_up = craft.home[2]
    to_east, to_north, to_up = craft.return_to
    now = up - home_up
    least = max(_ALT_MIN_M, now + fleet.param(craft, "RTL_CLIMB_MIN") * 0.01)
    height = max(fleet.param(craft, "RTL_ALT") * 0.01, least, to_up - home_up, 0.0)
    slope = fleet.param(craft, "RTL_CONE_SLOPE")
    if slope >= _MIN_CONE_SLOPE:
        height = min(height, max(math.hypot(east - to_east, north - to_north) * slope, least))
    return home_up + max(min(height, fence.safe_alt_m(fleet, craft)), now)


def arrived(fleet: Fleet, craft: Craft) -> None:
    """Continue with the next sub-mode when a leg is complete."""
    if craft.stage == Stage.CLIMB:
        craft.stage = Stage.RETURN
        up = float(fleet.flight["target_pos"][craft.row, 2])
        facing.default(fleet, craft, returning=True)
        _start_leg(fleet, craft, (craft.return_to[0], craft.return_to[1], up), False)
    elif craft.stage == Stage.RETURN:
        craft.stage = Stage.LOITER
        facing.as_armed(fleet, craft)
        fleet.timer(craft, Timer.HOLD, fleet.now + int(fleet.param(craft, "RTL_LOIT_TIME")) * NS_PER_MS)


def waited(fleet: Fleet, craft: Craft) -> None:
    """End the loiter once the nose is at the yaw of arming: land, or descend to RTL_ALT_FINAL and stay."""
    if not facing.is_as_armed(fleet, craft):
        fleet.timer(craft, Timer.HOLD, fleet.now + _CHECK_NS)
        return
    final = fleet.param(craft, "RTL_ALT_FINAL") * 0.01
    facing.set_kind(fleet, craft, Heading.HOLD)
    if final <= 0.0:
        craft.stage = Stage.LAND
        fleet.limits(craft)
        loop.hold(fleet.estimate, fleet.flight, craft.row)
        fleet.fly(craft, Control.LAND)
        return
    craft.stage = Stage.DESCEND
    _start_leg(fleet, craft, (craft.return_to[0], craft.return_to[1], craft.home[2] + final), False)
