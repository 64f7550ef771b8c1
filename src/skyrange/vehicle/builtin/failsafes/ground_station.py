"""Ground station failsafe: FS_GCS_ENABLE, FS_GCS_TIMEOUT, SYSID_MYGCS.

After ArduCopter/events.cpp `failsafe_gcs_check`, `failsafe_gcs_on_event` and `failsafe_gcs_off_event`, and
GCS_Common.cpp `handle_heartbeat`. Checked at 10 Hz, where ArduCopter's `three_hz_loop` takes up to 0.33 s.
"""

from __future__ import annotations

from typing import Any

from skyrange.codec.mavlink import dialect
from skyrange.core.compiled import kernel
from skyrange.vehicle.builtin.arming import disarm
from skyrange.vehicle.builtin.failsafes.actions import Action, Option, act, announce, is_landing, option, should_disarm
from skyrange.vehicle.builtin.failsafes.alarms import Alarm
from skyrange.vehicle.builtin.failsafes.battery import lands_for_battery
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet
from skyrange.vehicle.builtin.modes import AUTOPILOT, Mode

_LOST = int(Alarm.STATION_LOST)
_BACK = int(Alarm.STATION_BACK)

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


@kernel
def check_station(p: Any, w: Any, now_ns: int) -> int:
    """Check one aircraft and return its alarms: none before the first heartbeat, or with the failsafe disabled."""
    if p.FS_GCS_ENABLE == 0 or w.station_ns == 0:
        return 0
    silent_s = (now_ns - w.station_ns) * 1e-9
    if silent_s < p.FS_GCS_TIMEOUT:
        if w.station_lost == 1:
            w.station_lost = 0
            return _BACK
    elif silent_s > p.FS_GCS_TIMEOUT and w.station_lost == 0:
        w.station_lost = 1
        return _LOST
    return 0


def on_heartbeat(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """HEARTBEAT: one of SYSID_MYGCS counts, from any of its components."""
    if partner[0] == int(fleet.param(craft, "SYSID_MYGCS")):
        seen(fleet, craft)


def seen(fleet: Fleet, craft: Craft) -> None:
    """Record that the ground station was heard (`sysid_mygcs_seen`)."""
    fleet.watch["station_ns"][craft.row] = max(fleet.now, 1)


def lost(fleet: Fleet, craft: Craft) -> None:
    """Report that there was no heartbeat for FS_GCS_TIMEOUT, and act."""
    action = ACTIONS.get(int(fleet.param(craft, "FS_GCS_ENABLE")), Action.RTL)
    landing = is_landing(fleet, craft)
    if not fleet.armed(craft):
        action = Action.NONE
        announce(fleet, craft, "GCS")
    elif should_disarm(fleet, craft):
        disarm(fleet, craft, "gcs_failsafe", ())
        action = Action.NONE
        announce(fleet, craft, "GCS", "Disarming")
    elif landing and lands_for_battery(fleet, craft):
        action = Action.LAND
        announce(fleet, craft, "GCS + Battery", "Continuing Landing")
    elif landing and option(fleet, craft, Option.CONTINUE_IF_LANDING):
        action = Action.LAND
        announce(fleet, craft, "GCS", "Continuing Landing")
    elif craft.shown_mode == Mode.AUTO and option(fleet, craft, Option.GCS_CONTINUE_IF_AUTO):
        action = Action.NONE
        announce(fleet, craft, "GCS", "Continuing Auto Mode")
    elif option(fleet, craft, Option.GCS_CONTINUE_IF_PILOT_CONTROL) and craft.mode not in AUTOPILOT:
        action = Action.NONE
        announce(fleet, craft, "GCS", "Continuing Pilot Control")
    else:
        announce(fleet, craft, "GCS")
    act(fleet, craft, action, "gcs_failsafe")


def back(fleet: Fleet, craft: Craft) -> None:
    """Report that heartbeats arrive again (`failsafe_gcs_off_event`); the mode stays."""
    fleet.text(craft, dialect.MAV_SEVERITY_WARNING, "GCS Failsafe Cleared")
