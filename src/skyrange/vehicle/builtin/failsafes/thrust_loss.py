"""Thrust loss check: full thrust, level, in control, and still descending for a second.

After ArduCopter/crash_check.cpp `thrust_loss_check` and AP_MotorsMatrix.cpp `check_for_failed_motor`, at 10 Hz.
ArduCopter also boosts the other motors then; here it is only reported.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.contracts.components import Floats
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin.failsafes.alarms import Alarm
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle

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
