"""Ground station failsafe: FS_GCS_ENABLE, FS_GCS_TIMEOUT, SYSID_MYGCS.

After ArduCopter/events.cpp `failsafe_gcs_check`, `failsafe_gcs_on_event` and `failsafe_gcs_off_event`, and
GCS_Common.cpp `handle_heartbeat`. Checked at 10 Hz, where ArduCopter's `three_hz_loop` takes up to 0.33 s.
"""

from __future__ import annotations

from typing import Any

from skyrange.codec.mavlink import dialect
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.failsafes.actions import (
    Action,
    Alarm,
    Option,
    announce_failsafe,
    do_failsafe_action,
    has_option,
    is_landing,
    should_disarm,
)
from skyrange.vehicle.builtin.failsafes.battery import lands_for_battery
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle
from skyrange.vehicle.builtin.modes import AUTOPILOT_MODES, Mode

_LOST = int(Alarm.GCS_LOST)
_BACK = int(Alarm.GCS_RECOVERED)

ACTIONS = {
    1: Action.RTL,
    2: Action.RTL,  # formerly "continue the mission in AUTO", which is now in FS_OPTIONS
    3: Action.SMART_RTL,
    4: Action.SMART_RTL_LAND,
    5: Action.LAND,
    6: Action.DO_LAND_START,
    7: Action.BRAKE_LAND,
}
"""FS_GCS_ENABLE → action (defines.h FS_GCS_…)."""


@compiled
def check_ground_station(p: Any, w: Any, now_ns: int) -> int:
    """Check one aircraft and return its alarms: none before the first heartbeat, or with the failsafe disabled."""
    if p.FS_GCS_ENABLE == 0 or w.gcs_heard_ns == 0:
        return 0
    silent_s = (now_ns - w.gcs_heard_ns) * 1e-9
    if silent_s < p.FS_GCS_TIMEOUT:
        if w.gcs_lost == 1:
            w.gcs_lost = 0
            return _BACK
    elif silent_s > p.FS_GCS_TIMEOUT and w.gcs_lost == 0:
        w.gcs_lost = 1
        return _LOST
    return 0


def on_heartbeat(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """HEARTBEAT: one of SYSID_MYGCS counts, from any of its components."""
    if peer[0] == int(fleet.param(vehicle, "SYSID_MYGCS")):
        mark_seen(fleet, vehicle)


def mark_seen(fleet: Fleet, vehicle: Vehicle) -> None:
    """Record that the ground station was heard (`sysid_mygcs_seen`)."""
    fleet.checks["gcs_heard_ns"][vehicle.row] = max(fleet.now, 1)


def on_lost(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report that there was no heartbeat for FS_GCS_TIMEOUT, and act."""
    action = ACTIONS.get(int(fleet.param(vehicle, "FS_GCS_ENABLE")), Action.RTL)
    landing = is_landing(fleet, vehicle)
    if not fleet.armed(vehicle):
        action = Action.NONE
        announce_failsafe(fleet, vehicle, "GCS")
    elif should_disarm(fleet, vehicle):
        disarm(fleet, vehicle, "gcs_failsafe", ())
        action = Action.NONE
        announce_failsafe(fleet, vehicle, "GCS", "Disarming")
    elif landing and lands_for_battery(fleet, vehicle):
        action = Action.LAND
        announce_failsafe(fleet, vehicle, "GCS + Battery", "Continuing Landing")
    elif landing and has_option(fleet, vehicle, Option.CONTINUE_IF_LANDING):
        action = Action.LAND
        announce_failsafe(fleet, vehicle, "GCS", "Continuing Landing")
    elif vehicle.reported_mode == Mode.AUTO and has_option(fleet, vehicle, Option.GCS_CONTINUE_IF_AUTO):
        action = Action.NONE
        announce_failsafe(fleet, vehicle, "GCS", "Continuing Auto Mode")
    elif has_option(fleet, vehicle, Option.GCS_CONTINUE_IF_PILOT_CONTROL) and vehicle.mode not in AUTOPILOT_MODES:
        action = Action.NONE
        announce_failsafe(fleet, vehicle, "GCS", "Continuing Pilot Control")
    else:
        announce_failsafe(fleet, vehicle, "GCS")
    do_failsafe_action(fleet, vehicle, action, "gcs_failsafe")


def on_recovered(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report that heartbeats arrive again (`failsafe_gcs_off_event`); the mode stays."""
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, "GCS Failsafe Cleared")
