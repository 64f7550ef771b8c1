"""Home position: how it is set and reported (ArduCopter/commands.cpp `Copter::set_home`, AP_AHRS::set_home)."""

from __future__ import annotations

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle
from skyrange.vehicle.builtin.telemetry.table import build_message


def send_home(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> None:
    """Send HOME_POSITION and GPS_GLOBAL_ORIGIN, as at every change of home."""
    for number in (mav.MAVLINK_MSG_ID_HOME_POSITION, mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN):
        message = build_message(fleet, vehicle, number)
        if message is not None:
            fleet.send(vehicle, message, causes)


def set_home(fleet: Fleet, vehicle: Vehicle, place: tuple[float, float, float], causes: Causes, lock: bool) -> None:
    """Move home to a place (ENU metres) at once, for the fence too; with `lock`, the next arming does not move it."""
    fleet.assign_home(vehicle, place)
    vehicle.home_locked = vehicle.home_locked or lock
    fleet.note("event.home", vehicle, {"east_m": place[0], "north_m": place[1], "up_m": place[2]}, causes)
    send_home(fleet, vehicle, causes)
