"""Failsafe actions: ArduCopter/events.cpp `do_failsafe_action` and what it calls.

There is no SmartRTL here, as on a vehicle whose path memory is off: its actions report so and take the fallback.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.arming import disarm
from skyrange.vehicle.builtin.fleet import Craft, Fleet
from skyrange.vehicle.builtin.layout import Control
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.switching import set_mode

_LAND_DELAY_S = 4.0  # config.h LAND_WITH_DELAY_MS
_WARNING = dialect.MAV_SEVERITY_WARNING


class Action(IntEnum):
    """Copter::FailsafeAction: the values of BATT_FS_…_ACT and FS_DR_ENABLE."""

    NONE = 0
    LAND = 1
    RTL = 2
    SMART_RTL = 3
    SMART_RTL_LAND = 4
    TERMINATE = 5
    DO_LAND_START = 6
    BRAKE_LAND = 7


class Option(IntFlag):
    """FS_OPTIONS (Copter::FailsafeOption), without those for radio control and a gripper."""

    GCS_CONTINUE_IF_AUTO = 2
    CONTINUE_IF_LANDING = 8
    GCS_CONTINUE_IF_PILOT_CONTROL = 16


def option(fleet: Fleet, craft: Craft, bit: Option) -> bool:
    """Whether FS_OPTIONS has a bit."""
    return bool(int(fleet.param(craft, "FS_OPTIONS")) & bit)


def announce(fleet: Fleet, craft: Craft, kind: str, action: str = "") -> None:
    """Report a failsafe, with the action where it is not the parameter's (`announce_failsafe`)."""
    fleet.text(craft, _WARNING, f"{kind} Failsafe - {action}" if action else f"{kind} Failsafe")


def should_disarm(fleet: Fleet, craft: Craft) -> bool:
    """Whether it stands on the ground, so that a failsafe only stops the motors (`should_disarm_on_failsafe`)."""
    if craft.mode == Mode.AUTO:
        return not craft.ready and fleet.landed(craft)
    return fleet.landed(craft)


def is_landing(fleet: Fleet, craft: Craft) -> bool:
    """Whether it descends to land: in LAND, or at the end of RTL or of a mission."""
    return craft.mode == Mode.LAND or (craft.mode in (Mode.RTL, Mode.AUTO) and fleet.control(craft) == Control.LAND)


def act(fleet: Fleet, craft: Craft, action: int, reason: str) -> None:
    """Execute an action; `reason` is ArduCopter's ModeReason in lower case."""
    if action == Action.LAND:
        land(fleet, craft, reason)
    elif action == Action.RTL:
        _set_mode_rtl_or_land(fleet, craft, reason)
    elif action == Action.SMART_RTL:
        fleet.text(craft, _WARNING, "SmartRTL Unavailable, Trying RTL Mode")
        _set_mode_rtl_or_land(fleet, craft, reason)
    elif action == Action.SMART_RTL_LAND:
        fleet.text(craft, _WARNING, "SmartRTL Unavailable, Using Land Mode")
        land(fleet, craft, reason)
    elif action == Action.TERMINATE:
        disarm(fleet, craft, "failsafe_action_terminate", ())
    elif action == Action.DO_LAND_START:  # set_mode_auto_do_land_start_or_RTL
        if not set_mode(fleet, craft, Mode.AUTO_RTL, reason, ()):
            fleet.text(craft, _WARNING, "Trying RTL Mode")
            _set_mode_rtl_or_land(fleet, craft, reason)
    elif action == Action.BRAKE_LAND and not set_mode(fleet, craft, Mode.BRAKE, reason, ()):
        fleet.text(craft, _WARNING, "Trying Land Mode")
        land(fleet, craft, reason)


def _set_mode_rtl_or_land(fleet: Fleet, craft: Craft, reason: str) -> None:
    """RTL, or LAND where RTL is refused (`set_mode_RTL_or_land_with_pause`)."""
    if not set_mode(fleet, craft, Mode.RTL, reason, ()):
        land(fleet, craft, reason)


def land(fleet: Fleet, craft: Craft, reason: str) -> None:
    """LAND, its descent delayed by 4 s (`set_mode_land_with_pause`); a landing in progress continues."""
    begins = craft.mode != Mode.LAND
    if set_mode(fleet, craft, Mode.LAND, reason, ()) and begins:
        fleet.flight["pause_s"][craft.row] = _LAND_DELAY_S
