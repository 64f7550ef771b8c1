"""Battery failsafe: low and critical voltage and charge (BATT_…).

After libraries/AP_BattMonitor (AP_BattMonitor_Backend.cpp `check_failsafe_types`, `update_failsafes`;
AP_BattMonitor.cpp `check_failsafes`) and ArduCopter/events.cpp `handle_battery_failsafe`. Read at 10 Hz, as
`update_batt_compass` does.
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.battery_monitor import update_battery
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
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle

LOW: Final = 2
CRITICAL: Final = 3
_BATTERY = int(Alarm.BATTERY)
_LOW = LOW
_CRITICAL = CRITICAL
PRIORITIES: Final = (
    Action.TERMINATE,
    Action.LAND,
    Action.RTL,
    Action.SMART_RTL_LAND,
    Action.SMART_RTL,
    Action.NONE,
)
"""Copter.h `_failsafe_priorities`: earlier is higher; an action that is not listed comes last."""
_LAND_PRIORITY = 1  # Copter.h FAILSAFE_LAND_PRIORITY


@compiled
def _is_low(volts: float, least: float) -> bool:
    """Whether a voltage is known and below a threshold that is set."""
    return volts > 0.0 and least > 0.0 and volts < least


@compiled
def _compared_voltage(p: Any, b: Any) -> float:
    """Return the voltage compared with the thresholds: as measured, or without the sag (BATT_FS_VOLTSRC)."""
    volts: float = b.resting_v if p.BATT_FS_VOLTSRC == 1 else b.voltage
    return volts


@compiled
def _level(p: Any, b: Any, now_ns: int) -> int:
    """Return the failsafe level: a low voltage counts once it has lasted for BATT_LOW_TIMER, a low charge at once."""
    volts = _compared_voltage(p, b)
    left_mah = p.BATT_CAPACITY - b.consumed_mah
    timer_ns = p.BATT_LOW_TIMER * 1e9
    if _is_low(volts, p.BATT_CRT_VOLT):
        if b.critical_ns == 0:
            b.critical_ns = now_ns
        elif timer_ns > 0.0 and now_ns - b.critical_ns > timer_ns:
            return _CRITICAL
    else:
        b.critical_ns = 0
    if p.BATT_CRT_MAH > 0.0 and left_mah < p.BATT_CRT_MAH:
        return _CRITICAL
    if _is_low(volts, p.BATT_LOW_VOLT):
        if b.low_ns == 0:
            b.low_ns = now_ns
        elif timer_ns > 0.0 and now_ns - b.low_ns > timer_ns:
            return _LOW
    else:
        b.low_ns = 0
    if p.BATT_LOW_MAH > 0.0 and left_mah < p.BATT_LOW_MAH:
        return _LOW
    return 0


@compiled
def check_battery(e: Any, f: Any, p: Any, b: Any, now_ns: int, dt_s: float) -> int:
    """Check one aircraft: measure and, while armed, raise an alarm at a level worse than any before."""
    if p.BATT_MONITOR == 0:
        b.remaining_pct = -1
        return 0
    update_battery(e, p, b, dt_s)
    if f.armed == 0:
        return 0
    b.pending_level = _level(p, b, now_ns)
    return _BATTERY if b.pending_level > b.level else 0


def lands_for_battery(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether a battery failsafe lands the aircraft, which no later failsafe may undo."""
    power = fleet.battery[vehicle.row]
    return bool(power["failsafe_triggered"]) and int(power["priority"]) <= _LAND_PRIORITY


def on_battery_failsafe(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report a battery that has become low or critical, and act unless an earlier action has priority."""
    power = fleet.battery
    row = vehicle.row
    level = int(power["pending_level"][row])
    words, name = ("critical", "BATT_FS_CRT_ACT") if level == CRITICAL else ("low", "BATT_FS_LOW_ACT")
    volts, used = float(power["voltage"][row]), float(power["consumed_mah"][row])
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, f"Battery 1 is {words} {volts:.2f}V used {used:.0f} mAh")
    fleet.note("event.battery", vehicle, {"level": words, "voltage_v": volts, "used_mah": used}, vehicle.flight_causes)
    power["failsafe_triggered"][row] = 1
    power["level"][row] = level
    action = int(fleet.param(vehicle, name))
    priority = PRIORITIES.index(Action(action)) if action in PRIORITIES else len(PRIORITIES)
    if priority <= power["priority"][row]:
        _handle_failsafe(fleet, vehicle, action)
        power["priority"][row] = priority


def _handle_failsafe(fleet: Fleet, vehicle: Vehicle, action: int) -> None:
    if should_disarm(fleet, vehicle):
        disarm(fleet, vehicle, "battery_failsafe", ())
        action = Action.NONE
        announce_failsafe(fleet, vehicle, "Battery", "Disarming")
    elif (
        is_landing(fleet, vehicle) and has_option(fleet, vehicle, Option.CONTINUE_IF_LANDING) and action != Action.NONE
    ):
        action = Action.LAND
        announce_failsafe(fleet, vehicle, "Battery", "Continuing Landing")
    else:
        announce_failsafe(fleet, vehicle, "Battery")
    do_failsafe_action(fleet, vehicle, action, "battery_failsafe")
