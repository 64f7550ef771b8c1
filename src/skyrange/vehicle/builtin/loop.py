"""What happens in one turn of the main loop, for every aircraft? Guide, control, detect landing.

One kernel over all rows, `turn`, after the estimator has said where each aircraft believes to be.
"""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from skyrange.agent.contracts import Floats
from skyrange.core.compiled import kernel
from skyrange.vehicle.builtin.control import fly, relax, stand
from skyrange.vehicle.builtin.guidance import begin_leg, face, guide
from skyrange.vehicle.builtin.layout import Control, Flag, Records
from skyrange.vehicle.builtin.shaping import ramp_time

_OFF = int(Control.OFF)
_IDLE = int(Control.IDLE)
_TAKEOFF = int(Control.TAKEOFF)
_LIFTED = int(Flag.LIFTED)
_LANDED = int(Flag.LANDED)
_CRASHED = int(Flag.CRASHED)
# land_detector.cpp and config.h (LAND_DETECTOR_*, LAND_CHECK_*)
_LAND_S = 1.0
_LAND_ACCEL_MPS2 = 1.0
_LAND_CLIMB_MPS = 1.0
_LAND_HEIGHT_M = 2.0
_LAND_TILT_RAD = math.radians(15.0)
_LAND_TILT_ERROR_RAD = math.radians(30.0)
_LAND_FILTER_HZ = 1.0
_RELAX_TC_S = 0.16  # AC_PosControl.cpp POSCONTROL_RELAX_TC
# crash_check.cpp (CRASH_CHECK_*)
_CRASH_S = 2.0
_CRASH_ACCEL_MPS2 = 3.0
_CRASH_SPEED_MPS = 10.0


@kernel
def take_reference(e: Any, f: Any) -> None:
    """Put the reference where the aircraft is, moving as it moves."""
    for axis in range(3):
        f.ref_pos[axis] = e.pos[axis]
        f.ref_vel[axis] = e.vel[axis]
        f.ref_acc[axis] = 0.0
    f.ref_yaw = e.yaw
    f.target_yaw = e.yaw
    f.ref_yaw_rate = 0.0


@kernel
def _rise(e: Any, f: Any, p: Any, out: Any, dt_s: float) -> None:
    """Spool up, then raise the throttle until the aircraft moves (takeoff.cpp)."""
    take_reference(e, f)
    relax(f)
    if f.spool < 1.0:
        f.spool = min(f.spool + dt_s / p.MOT_SPOOL_TIME, 1.0)
        f.throttle = 0.0
        for motor in range(out.shape[0]):
            out[motor] = p.MOT_SPIN_ARM + (p.MOT_SPIN_MIN - p.MOT_SPIN_ARM) * f.spool
        return
    stand(e, f, p, out, min(f.throttle + dt_s / p.TKOFF_SLEW_TIME, 1.0), dt_s)
    if f.throttle >= 0.9 or e.accel[2] >= 0.5 * f.accel_z or e.vel[2] >= 0.1 * f.speed_up:
        f.landed = 0
        f.land_s = 0.0
        f.flags |= _LIFTED
        f.throttle_i = f.throttle - p.MOT_THST_HOVER


@kernel
def _soften(e: Any, f: Any, dt_s: float) -> None:
    """Stop asking for a lean against wind and position error (AC_PosControl `soften_for_landing_NE`).

    ArduCopter waits for its landing criteria to be met once, and only stops the integral: in a wind that takes more
    lean than they allow it would stand with turning motors for ever.
    """
    share = dt_s / (dt_s + _RELAX_TC_S)
    for axis in range(2):
        f.ref_pos[axis] += (e.pos[axis] - f.ref_pos[axis]) * share
        f.vel_i[axis] -= f.vel_i[axis] * share


@kernel
def _touch(e: Any, f: Any, dt_s: float) -> None:
    """Landed: least throttle, still and level for a second. Crashed: two seconds far from the wanted attitude."""
    rc = 1.0 / (2.0 * math.pi * _LAND_FILTER_HZ)
    size = 0.0
    for axis in range(3):
        f.land_accel[axis] += (e.accel[axis] - f.land_accel[axis]) * dt_s / (dt_s + rc)
        size += f.land_accel[axis] * f.land_accel[axis]
    pressed = (  # with no thrust and no acceleration, only the ground can hold it
        f.throttle <= 0.0
        and size <= _LAND_ACCEL_MPS2 * _LAND_ACCEL_MPS2
        and abs(e.vel[2]) < _LAND_CLIMB_MPS
        and e.height < _LAND_HEIGHT_M
    )
    if pressed:
        _soften(e, f, dt_s)
    still = pressed and f.tilt_target < _LAND_TILT_RAD and f.tilt_error < _LAND_TILT_ERROR_RAD
    thrown = (
        f.tilt_error > _LAND_TILT_ERROR_RAD
        and size < _CRASH_ACCEL_MPS2 * _CRASH_ACCEL_MPS2
        and e.vel[0] * e.vel[0] + e.vel[1] * e.vel[1] + e.vel[2] * e.vel[2] < _CRASH_SPEED_MPS * _CRASH_SPEED_MPS
    )
    f.crash_s = f.crash_s + dt_s if thrown else 0.0
    if f.crash_s >= _CRASH_S:
        f.flags |= _CRASHED
    f.land_s = f.land_s + dt_s if still else 0.0
    if f.land_s >= _LAND_S:
        f.landed = 1
        f.control = _IDLE
        f.spool = 0.0
        f.throttle = 0.0
        f.flags |= _LANDED


@kernel
def turn(estimate: Records, flight: Records, settings: Records, actuators: Floats, dt_s: float) -> int:
    """One step for every row: writes (n, 4) commands 0…1; returns how many rows raised a flag newly."""
    flagged = 0
    for i in range(flight.shape[0]):
        e: Any = estimate[i]
        f: Any = flight[i]
        p: Any = settings[i]
        out = actuators[i]
        before = f.flags
        if f.control == _OFF:
            for motor in range(out.shape[0]):
                out[motor] = 0.0
        elif f.control == _IDLE:
            f.spool = 0.0
            for motor in range(out.shape[0]):
                out[motor] = p.MOT_SPIN_ARM
        elif f.landed == 1:
            if f.control == _TAKEOFF:
                _rise(e, f, p, out, dt_s)
            else:
                f.control = _IDLE
        else:
            guide(e, f, p, dt_s)
            fly(e, f, p, out, dt_s)
            _touch(e, f, dt_s)
        if f.flags & ~before:
            flagged += 1
    return flagged


@kernel
def set_leg(
    flight: Records,
    settings: Records,
    row: int,
    goal: NDArray[Any],
    fast: bool,
    corner: bool,
    turn_nose: bool,
) -> None:
    """`guidance.begin_leg` for one row; `turn_nose` faces along it."""
    f: Any = flight[row]
    p: Any = settings[row]
    begin_leg(f, p, goal[0], goal[1], goal[2], fast, corner)
    if turn_nose:
        face(f, p, goal[0] - f.leg.origin[0], goal[1] - f.leg.origin[1])


@kernel
def braking_distance(speed: float, accel: float, jerk: float) -> float:
    """How far a reference moves on while `begin_leg` brakes it off."""
    return 0.5 * speed * ramp_time(speed, 0.0, accel, jerk)


@kernel
def rest(flight: Records, row: int) -> None:
    """Clear one row's controllers before it leaves the ground."""
    f: Any = flight[row]
    relax(f)
    f.throttle_i = 0.0
    f.land_s = 0.0
    f.crash_s = 0.0


@kernel
def face_target(flight: Records, settings: Records, row: int) -> None:
    """Turn one row's nose towards its target, where that is far enough to mean a direction."""
    f: Any = flight[row]
    face(f, settings[row], f.target_pos[0] - f.ref_pos[0], f.target_pos[1] - f.ref_pos[1])
