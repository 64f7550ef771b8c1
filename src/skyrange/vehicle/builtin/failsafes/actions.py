"""Alarms of the failsafe checks, and failsafe actions (ArduCopter/events.cpp `do_failsafe_action`).

There is no SmartRTL here, as on a vehicle whose path memory is off: its actions report so and take the fallback.

Alarms of the failsafe checks: bits, in the order in which they are acted upon. The order is that of ArduCopter's
scheduler table (Copter.cpp): fence, battery, ground station and dead reckoning, estimator, GNSS.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.layout import ControlMode
from skyrange.vehicle.builtin.mode_change import set_mode
from skyrange.vehicle.builtin.modes import Mode


class Alarm(IntFlag):
    """New findings of a check; `CHECK_STATE.alarms`."""

    FENCE_CHANGED = 1 << 0
    """The minimum altitude was enabled automatically, or types were disabled for a landing."""
    FENCE_BREACHED = 1 << 1
    FENCE_CLEARED = 1 << 2
    BATTERY = 1 << 3
    """A worse level; see `BATTERY_STATE.pending_level`."""
    GCS_LOST = 1 << 4
    GCS_RECOVERED = 1 << 5
    DEAD_RECKONING_STARTED = 1 << 6
    DEAD_RECKONING_STOPPED = 1 << 7
    DEAD_RECKONING_TIMEOUT = 1 << 8
    """Dead reckoning for longer than FS_DR_TIMEOUT."""
    DEAD_RECKONING_FAILSAFE = 1 << 9
    ESTIMATOR_BAD = 1 << 10
    ESTIMATOR_GOOD = 1 << 11
    GLITCH_STARTED = 1 << 12
    GLITCH_STOPPED = 1 << 13
    THRUST_LOST = 1 << 14


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


def has_option(fleet: Fleet, vehicle: Vehicle, bit: Option) -> bool:
    """Whether FS_OPTIONS has a bit."""
    return bool(int(fleet.param(vehicle, "FS_OPTIONS")) & bit)


def announce_failsafe(fleet: Fleet, vehicle: Vehicle, kind: str, action: str = "") -> None:
    """Report a failsafe, with the action where it is not the parameter's (`announce_failsafe`)."""
    fleet.send_text(vehicle, _WARNING, f"{kind} Failsafe - {action}" if action else f"{kind} Failsafe")


def should_disarm(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether it stands on the ground, so that a failsafe only stops the motors (`should_disarm_on_failsafe`)."""
    if fleet.flight["arming_delay_s"][vehicle.row] > 0.0:
        return True
    if vehicle.mode == Mode.AUTO:
        return not vehicle.auto_armed and fleet.landed(vehicle)
    return fleet.landed(vehicle)


def is_landing(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether it descends to land: in LAND, or at the end of RTL or of a mission."""
    return vehicle.mode == Mode.LAND or (
        vehicle.mode in (Mode.RTL, Mode.AUTO) and fleet.control(vehicle) == ControlMode.LAND
    )


def do_failsafe_action(fleet: Fleet, vehicle: Vehicle, action: int, reason: str) -> None:
    """Execute an action; `reason` is ArduCopter's ModeReason in lower case."""
    if action == Action.LAND:
        set_mode_land_with_pause(fleet, vehicle, reason)
    elif action == Action.RTL:
        _set_mode_rtl_or_land(fleet, vehicle, reason)
    elif action == Action.SMART_RTL:
        fleet.send_text(vehicle, _WARNING, "SmartRTL Unavailable, Trying RTL Mode")
        _set_mode_rtl_or_land(fleet, vehicle, reason)
    elif action == Action.SMART_RTL_LAND:
        fleet.send_text(vehicle, _WARNING, "SmartRTL Unavailable, Using Land Mode")
        set_mode_land_with_pause(fleet, vehicle, reason)
    elif action == Action.TERMINATE:
        disarm(fleet, vehicle, "failsafe_action_terminate", ())
    elif action == Action.DO_LAND_START:  # set_mode_auto_do_land_start_or_RTL
        if not set_mode(fleet, vehicle, Mode.AUTO_RTL, reason, ()):
            fleet.send_text(vehicle, _WARNING, "Trying RTL Mode")
            _set_mode_rtl_or_land(fleet, vehicle, reason)
    elif action == Action.BRAKE_LAND and not set_mode(fleet, vehicle, Mode.BRAKE, reason, ()):
        fleet.send_text(vehicle, _WARNING, "Trying Land Mode")
        set_mode_land_with_pause(fleet, vehicle, reason)


def _set_mode_rtl_or_land(fleet: Fleet, vehicle: Vehicle, reason: str) -> None:
    """RTL, or LAND where RTL is refused (`set_mode_RTL_or_land_with_pause`)."""
    if not set_mode(fleet, vehicle, Mode.RTL, reason, ()):
        set_mode_land_with_pause(fleet, vehicle, reason)


def set_mode_land_with_pause(fleet: Fleet, vehicle: Vehicle, reason: str) -> None:
    """LAND, its descent delayed by 4 s (`set_mode_land_with_pause`); a landing in progress continues."""
    begins = vehicle.mode != Mode.LAND
    if set_mode(fleet, vehicle, Mode.LAND, reason, ()) and begins:
        fleet.flight["land_delay_s"][vehicle.row] = _LAND_DELAY_S
