"""Crash check and thrust loss check, as in ArduCopter/crash_check.cpp.

`crash_check`: the loop measures the two seconds (`loop.run_loop`,
FlightEvent.CRASH); this module decides whether it is a crash.

Thrust loss check: full thrust, level, in control, and still descending for a second. After ArduCopter/crash_check.cpp
`thrust_loss_check` and AP_MotorsMatrix.cpp `check_for_failed_motor`, at 10 Hz. ArduCopter also boosts the other motors
then; here it is only reported.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.contracts.components import Floats
from skyrange.core import elementary, elementwise
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.failsafes.actions import Alarm
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.layout import FlightEvent

_ANGLE_MIN_DEG = 15.0  # CRASH_CHECK_ANGLE_MIN_DEG
_ANGLE_ERROR_DEG = 30.0  # CRASH_CHECK_ANGLE_DEVIATION_DEG
_ACCEL_MAX = 3.0  # CRASH_CHECK_ACCEL_MAX


def check_crash(fleet: Fleet, vehicle: Vehicle) -> None:
    """After two seconds far from the target attitude, disarm, unless the check is off or the lean is small."""
    row, flight, estimate = vehicle.row, fleet.flight, fleet.estimate
    level = elementary.cos(float(estimate["roll"][row])) * elementary.cos(float(estimate["pitch"][row]))
    lean_deg = math.degrees(elementary.acos(min(max(level, -1.0), 1.0)))
    if fleet.param(vehicle, "FS_CRASH_CHECK") == 0 or lean_deg <= _ANGLE_MIN_DEG:
        flight["crash_s"][row] = 0.0
        flight["flags"][row] &= ~FlightEvent.CRASH
        flight["handled_flags"][row] &= ~FlightEvent.CRASH
        return
    error_deg = math.degrees(float(flight["tilt_error"][row]))
    accel = float(elementwise.length(flight["land_accel"][row]))
    why = f"AngErr={error_deg:.0f}>{_ANGLE_ERROR_DEG:.0f}, Accel={accel:.1f}<{_ACCEL_MAX:.1f}"
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_EMERGENCY, f"Crash: Disarming: {why}")
    disarm(fleet, vehicle, "crash", ())
    fleet.checks["crashed"][row] = 1


_LOST = int(Alarm.THRUST_LOST)
_TRIGGER_NS = NS_PER_S  # THRUST_LOSS_CHECK_TRIGGER_SEC
_TILT_RAD = math.radians(15.0)  # THRUST_LOSS_CHECK_ANGLE_DEVIATION_CD
_THROTTLE = 0.9  # THRUST_LOSS_CHECK_MINIMUM_THROTTLE
_ERROR_RAD = math.radians(30.0)  # CRASH_CHECK_ANGLE_DEVIATION_DEG
_OPTION = 1  # FLIGHT_OPTIONS bit 0: DISABLE_THRUST_LOSS_CHECK


@compiled
def check_thrust_loss(e: Any, f: Any, p: Any, w: Any, now_ns: int) -> int:
    """Check one aircraft: an alarm once the condition has held for a second, and after each further second."""
    failing = (
        f.armed == 1
        and f.landed == 0
        and int(p.FLIGHT_OPTIONS) & _OPTION == 0
        and f.throttle >= _THROTTLE
        and e.vel[2] < 0.0
        and f.tilt_target <= _TILT_RAD
        and f.tilt_error < _ERROR_RAD
    )
    if not failing:
        w.thrust_ns = 0
        return 0
    if w.thrust_ns == 0:
        w.thrust_ns = now_ns
    elif now_ns - w.thrust_ns >= _TRIGGER_NS:
        w.thrust_ns = 0
        return _LOST
    return 0


def on_thrust_loss(fleet: Fleet, vehicle: Vehicle, actuators: Floats) -> None:
    """Report it, with the number of the motor with the highest output (`check_for_failed_motor`)."""
    motor = int(np.argmax(actuators[vehicle.row])) + 1
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_EMERGENCY, f"Potential Thrust Loss ({motor})")
