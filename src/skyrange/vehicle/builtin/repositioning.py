"""Where is an aircraft sent by a command? DO_REPOSITION (GCS_MAVLink_Copter.cpp `handle_command_int_do_reposition`)."""

from __future__ import annotations

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin import facing, places, targets
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet
from skyrange.vehicle.builtin.modes import Mode, ModeReason
from skyrange.vehicle.builtin.switching import set_mode


def reposition(
    fleet: Fleet, craft: Craft, frame: int, lat_e7: int, lon_e7: int, alt_m: float, change_mode: bool, causes: Causes
) -> int:
    """DO_REPOSITION: fly to a place in GUIDED; the MAV_RESULT. `change_mode` enters GUIDED where it is not in it.

    Latitude and longitude 0 mean where it is.
    """
    if craft.mode != Mode.GUIDED and not change_mode:
        return int(dialect.MAV_RESULT_DENIED)
    place = places.enu(fleet, craft, frame, lat_e7, lon_e7, alt_m)
    if place is None or not targets.sane(place, targets.FAR_M):
        return int(dialect.MAV_RESULT_DENIED)
    if lat_e7 == 0 and lon_e7 == 0:
        place = (*fleet.position(craft)[:2], place[2])
    if not set_mode(fleet, craft, Mode.GUIDED, ModeReason.GCS_COMMAND, causes):
        return int(dialect.MAV_RESULT_FAILED)
    if fleet.armed(craft) and not fleet.landed(craft):
        craft.target_causes = causes
        targets.go_to(fleet, craft, place)
        facing.default(fleet, craft)
    return int(dialect.MAV_RESULT_ACCEPTED)
