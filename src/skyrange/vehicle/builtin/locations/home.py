"""Home position: how it is set and reported (ArduCopter/commands.cpp `Copter::set_home`, AP_AHRS::set_home)."""

from __future__ import annotations

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet
from skyrange.vehicle.builtin.telemetry.table import message


def announce(fleet: Fleet, craft: Craft, causes: Causes) -> None:
    """Send HOME_POSITION and GPS_GLOBAL_ORIGIN, as at every change of home."""
    for number in (mav.MAVLINK_MSG_ID_HOME_POSITION, mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN):
        told = message(fleet, craft, number)
        if told is not None:
            fleet.send(craft, told, causes)


def set_home(fleet: Fleet, craft: Craft, place: tuple[float, float, float], causes: Causes, lock: bool) -> None:
    """Move home to a place (ENU metres) at once, for the fence too; with `lock`, the next arming does not move it."""
    fleet.take_home(craft, place)
    craft.home_locked = craft.home_locked or lock
    fleet.note("event.home", craft, {"east_m": place[0], "north_m": place[1], "up_m": place[2]}, causes)
    announce(fleet, craft, causes)
