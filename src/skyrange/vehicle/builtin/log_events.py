"""Entries of the flight log: when an aircraft logs, and what begins a log.

As AP_Logger with LOG_DISARMED 0 and LOG_FILE_DSRMROT 0, their defaults: after a landing no mode and no event is logged,
and the next arming continues the log. Parameters that are set meanwhile are in it too, other than in ArduPilot.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.memory_card import EV_ARMED, EV_DISARMED, REASONS, FlightLog
from skyrange.vehicle.builtin.parameters.table import count_listed

BANNER: Final = ("ArduCopter V4.6.0-dev (skyrange)", "Frame: QUAD/X")
"""The texts that precede a list of parameters and begin a log, as in ArduCopter (`send_banner`)."""


_US_PER_S = 1_000_000


def log_arming(fleet: Fleet, vehicle: Vehicle) -> None:
    """Begin a log, or continue that of this boot."""
    if vehicle.card.log is None and not vehicle.logged:
        _start(fleet, vehicle)
    vehicle.logged = True
    if vehicle.card.log is not None:
        vehicle.card.log.add(fleet.now, "EV", EV_ARMED)


def log_disarming(fleet: Fleet, vehicle: Vehicle) -> None:
    """Log that it was disarmed."""
    if vehicle.card.log is not None:
        vehicle.card.log.add(fleet.now, "EV", EV_DISARMED)


def log_mode(fleet: Fleet, vehicle: Vehicle) -> None:
    """Log its mode, while it is armed."""
    if vehicle.card.log is not None and fleet.armed(vehicle):
        vehicle.card.log.add(fleet.now, "MODE", vehicle.reported_mode, REASONS.get(vehicle.mode_reason, 0))


def end_log(vehicle: Vehicle) -> None:
    """A boot: the next arming begins another log."""
    vehicle.card.log = None
    vehicle.logged = False


def _start(fleet: Fleet, vehicle: Vehicle) -> None:
    row, origin = vehicle.row, fleet.origin
    utc_us = int(fleet.clocks.utc_us(np.array([row]), fleet.now)[0])
    east, north, up = vehicle.home
    lat, lon = origin.geodetic_of(east, north)
    home = round(lat * 1e7), round(lon * 1e7), origin.alt_msl_m + up
    mission = tuple(
        (item.command, item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z, item.frame)
        for item in vehicle.mission
    )
    values = fleet.stored_params[row]
    listed = values[: count_listed(values)].copy()
    log = FlightLog(
        int(fleet.boot_ns[row]), fleet.now, utc_us // _US_PER_S, BANNER, listed, mission,
        ((*vehicle.origin_e7, origin.alt_msl_m), home),
    )  # fmt: skip
    vehicle.card.start_log(log)
    log.add(fleet.now, "MODE", vehicle.reported_mode, REASONS.get(vehicle.mode_reason, 0))
