"""Crash check: FS_CRASH_CHECK.

After ArduCopter/crash_check.cpp `crash_check`. The loop measures the two seconds (`loop.run_loop`,
FlightEvent.CRASH); this module decides whether it is a crash.
"""

from __future__ import annotations

import math

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.layout import FlightEvent

_ANGLE_MIN_DEG = 15.0  # CRASH_CHECK_ANGLE_MIN_DEG
_ANGLE_ERROR_DEG = 30.0  # CRASH_CHECK_ANGLE_DEVIATION_DEG
_ACCEL_MAX = 3.0  # CRASH_CHECK_ACCEL_MAX


def check_crash(fleet: Fleet, vehicle: Vehicle) -> None:
    """After two seconds far from the target attitude, disarm, unless the check is off or the lean is small."""
    row, flight, estimate = vehicle.row, fleet.flight, fleet.estimate
    level = math.cos(float(estimate["roll"][row])) * math.cos(float(estimate["pitch"][row]))
    lean_deg = math.degrees(math.acos(min(max(level, -1.0), 1.0)))
    if fleet.param(vehicle, "FS_CRASH_CHECK") == 0 or lean_deg <= _ANGLE_MIN_DEG:
        flight["crash_s"][row] = 0.0
        flight["flags"][row] &= ~FlightEvent.CRASH
        flight["handled_flags"][row] &= ~FlightEvent.CRASH
        return
    error_deg = math.degrees(float(flight["tilt_error"][row]))
    accel = float(np.sqrt((flight["land_accel"][row] ** 2).sum()))
    why = f"AngErr={error_deg:.0f}>{_ANGLE_ERROR_DEG:.0f}, Accel={accel:.1f}<{_ACCEL_MAX:.1f}"
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_EMERGENCY, f"Crash: Disarming: {why}")
    disarm(fleet, vehicle, "crash", ())
    fleet.checks["crashed"][row] = 1
