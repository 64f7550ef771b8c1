"""Main loop: one pass of guidance, control and landing detection for every aircraft.

The compiled function `run_loop` passes over all rows after the estimator has updated each aircraft's state. It controls
attitude and thrust in each pass; guidance, position control and the landing detector run every `gains.SLOW_LOOP_S`.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.agent.contracts import Floats, Ints
from skyrange.core.compiled import kernel
from skyrange.vehicle.builtin import attitude, sticks
from skyrange.vehicle.builtin.control import climb, horizontal, lift, relax, turn_motors
from skyrange.vehicle.builtin.gains import SLOW_S
from skyrange.vehicle.builtin.guidance import guide
from skyrange.vehicle.builtin.heading import turn as turn_nose
from skyrange.vehicle.builtin.layout import Control, Flag, Heading, Records

_OFF = int(Control.OFF)
_IDLE = int(Control.IDLE)
_TAKEOFF = int(Control.TAKEOFF)
_LAND = int(Control.LAND)
_ATTITUDE = int(Control.ATTITUDE)
_STABILIZE = int(Control.STABILIZE)
_ALT_HOLD = int(Control.ALT_HOLD)
_LOITER = int(Control.LOITER)
_HOLD = int(Heading.HOLD)
_LIFT_OFF = int(Flag.LIFTED)
_LAND_COMPLETE = int(Flag.LANDED)
_CRASH = int(Flag.CRASHED)
_CDEG = math.pi / 18_000.0
# land_detector.cpp and config.h (LAND_DETECTOR_*, LAND_CHECK_*)
_LAND_S = 1.0
_LAND_ACCEL_MPS2 = 1.0
_LAND_CLIMB_MPS = 1.0
_LAND_HEIGHT_M = 2.0
_LAND_TILT_RAD = math.radians(15.0)
_LAND_TILT_ERROR_RAD = math.radians(30.0)
_LAND_FILTER_S = 1.0 / (2.0 * math.pi * 1.0)  # LAND_DETECTOR_ACCEL_LPF_CUTOFF, 1 Hz
_RELAX_TC_S = 0.16  # AC_PosControl.cpp POSCONTROL_RELAX_TC
# crash_check.cpp (CRASH_CHECK_*)
_CRASH_S = 2.0
_CRASH_ACCEL_MPS2 = 3.0
_CRASH_SPEED_MPS = 10.0
_EARLY_S = 1e-9  # rounding error of a sum of steps


@kernel
def take_reference(e: Any, f: Any) -> None:
    """Set the reference and the attitude target to the aircraft's estimated state."""
    for axis in range(3):
        f.ref_pos[axis] = e.pos[axis]
        f.ref_vel[axis] = e.vel[axis]
        f.ref_acc[axis] = 0.0
    f.lean[0] = e.roll
    f.lean[1] = e.pitch
    f.lean_rate[0] = 0.0
    f.lean_rate[1] = 0.0
    attitude.start(e, f)


@kernel
def _spool(e: Any, f: Any, p: Any, out: Any, i: int, dt_s: float) -> bool:
    """Spool the motors up from ground idle (AP_MotorsMulticopter::output_logic); whether they have spooled up."""
    take_reference(e, f)
    relax(f)
    if f.spool >= 1.0:
        return True
    f.spool = min(f.spool + dt_s / p.MOT_SPOOL_TIME, 1.0)
    f.throttle = 0.0
    _set_all_motors(out, i, f.spool * p.MOT_SPIN_MIN)
    return False


@kernel
def _set_all_motors(out: Any, i: int, command: float) -> None:
    for motor in range(out.shape[1]):
        out[i, motor] = command


@kernel
def _idle_motors(f: Any, p: Any, out: Any, i: int, dt_s: float) -> None:
    """Move towards ground idle, MOT_SPIN_ARM, no faster than motors spool up."""
    step = dt_s / p.MOT_SPOOL_TIME
    armed = min(p.MOT_SPIN_ARM / p.MOT_SPIN_MIN, 1.0) if p.MOT_SPIN_MIN > 0.0 else 0.0
    f.spool = min(max(armed, f.spool - step), f.spool + step)
    _set_all_motors(out, i, f.spool * p.MOT_SPIN_MIN)


@kernel
def _hold_level(e: Any, f: Any, g: Any, out: Any, i: int, throttle: float) -> None:
    """Hold level at a given throttle on the ground, before lift-off."""
    f.throttle = throttle
    f.att_rate[0] = 0.0
    f.att_rate[1] = 0.0
    f.att_rate[2] = 0.0
    out[i, 0], out[i, 1], out[i, 2], out[i, 3] = turn_motors(e, f, g, False, False)
    for axis in range(3):
        f.rate_i[axis] = 0.0


@kernel
def _leave_ground(f: Any) -> None:
    f.landed = 0
    f.land_s = 0.0
    f.flags |= _LIFT_OFF
    f.slow_s = 1e9


@kernel
def _run_takeoff(e: Any, f: Any, p: Any, g: Any, out: Any, i: int, dt_s: float) -> None:
    """Spool up, then raise the throttle until the aircraft moves (takeoff.cpp)."""
    if not _spool(e, f, p, out, i, dt_s):
        return
    level = math.sqrt(e.quat[0] * e.quat[0] + e.quat[3] * e.quat[3])
    if level > 0.0:  # upright, as it stands
        f.att[0] = e.quat[0] / level
        f.att[1] = 0.0
        f.att[2] = 0.0
        f.att[3] = e.quat[3] / level
    _hold_level(e, f, g, out, i, min(f.throttle + dt_s / p.TKOFF_SLEW_TIME, 1.0))
    if f.throttle >= 0.9 or e.accel[2] >= 0.5 * f.accel_z or e.vel[2] >= 0.1 * f.speed_up:
        f.throttle_i = f.throttle - p.MOT_THST_HOVER
        _leave_ground(f)


@kernel
def _wait_for_pilot(e: Any, f: Any, p: Any, g: Any, out: Any, i: int, dt_s: float) -> None:
    """Keep the motors idle on the ground in a pilot's mode until the throttle is raised."""
    if f.control == _STABILIZE:
        if sticks.throttle_zero(f, dt_s):
            f.throttle = 0.0
            take_reference(e, f)
            _idle_motors(f, p, out, i, dt_s)
        elif _spool(e, f, p, out, i, dt_s):
            _leave_ground(f)
    elif sticks.climb_rate(f, p) > 0.0:
        sticks.throttle_zero(f, dt_s)
        _run_takeoff(e, f, p, g, out, i, dt_s)
    else:
        sticks.throttle_zero(f, dt_s)
        f.throttle = 0.0
        take_reference(e, f)
        _idle_motors(f, p, out, i, dt_s)


@kernel
def _soften_for_landing(e: Any, f: Any, dt_s: float) -> None:
    """Release the lean that opposes wind and position error (AC_PosControl `soften_for_landing_NE`).

    ArduCopter does so only once its landing criteria have been met, and only stops the integral. In a wind that takes
    more lean than these criteria allow, it would stand with turning motors for ever.
    """
    part = dt_s / (dt_s + _RELAX_TC_S)
    for axis in range(2):
        f.ref_pos[axis] += (e.pos[axis] - f.ref_pos[axis]) * part
        f.vel_i[axis] -= f.vel_i[axis] * part


@kernel
def _update_detectors(e: Any, f: Any, dt_s: float) -> None:
    """Update the landing and crash detectors.

    Landed: minimum throttle, at rest and level for a second. Crashed: two seconds far from the target attitude.
    """
    f.tilt_target = attitude.whole_angle(0.5 - 0.5 * f.tilt_cos)
    f.tilt_error = attitude.whole_angle(f.tilt_half2)
    part = dt_s / (dt_s + _LAND_FILTER_S)
    size = 0.0
    for axis in range(3):
        f.land_accel[axis] += (e.accel[axis] - f.land_accel[axis]) * part
        size += f.land_accel[axis] * f.land_accel[axis]
    pressed = (  # without thrust and acceleration, only the ground can carry it
        f.throttle <= 0.0
        and size <= _LAND_ACCEL_MPS2 * _LAND_ACCEL_MPS2
        and abs(e.vel[2]) < _LAND_CLIMB_MPS
        and e.height < _LAND_HEIGHT_M
    )
    if pressed:
        _soften_for_landing(e, f, dt_s)
    still = pressed and f.tilt_target < _LAND_TILT_RAD and f.tilt_error < _LAND_TILT_ERROR_RAD
    thrown = (
        f.tilt_error > _LAND_TILT_ERROR_RAD
        and size < _CRASH_ACCEL_MPS2 * _CRASH_ACCEL_MPS2
        and e.vel[0] * e.vel[0] + e.vel[1] * e.vel[1] + e.vel[2] * e.vel[2] < _CRASH_SPEED_MPS * _CRASH_SPEED_MPS
    )
    f.crash_s = f.crash_s + dt_s if thrown else 0.0
    if f.crash_s >= _CRASH_S:
        f.flags |= _CRASH
    f.land_s = f.land_s + dt_s if still else 0.0
    if f.land_s >= _LAND_S:
        f.landed = 1
        if f.control < _STABILIZE:
            f.control = _IDLE
        f.throttle = 0.0
        f.flags |= _LAND_COMPLETE


@kernel
def _run_slow_control(e: Any, f: Any, w: Any, p: Any, g: Any, dt_s: float) -> None:
    """Run the slow part of control: reference, position and height controllers, and the attitude that they request."""
    control = f.control
    guide(e, f, w, p, dt_s)
    if control != _STABILIZE:
        climb(e, f, g, dt_s)
    most = p.ANGLE_MAX * _CDEG
    if control in (_STABILIZE, _ALT_HOLD):
        forward, left = sticks.lean(e, f, most, most)
        acc_e, acc_n = sticks.to_local(e, forward, left)
        attitude.aim(f, g, acc_e, acc_n, True, 0.0, sticks.yaw_rate(f, p), dt_s)
        for axis in range(2):  # no position is held; holding one again starts from here
            f.ref_pos[axis] = e.pos[axis]
            f.ref_vel[axis] = e.vel[axis]
        return
    if control == _ATTITUDE:
        for axis in range(2):
            f.ref_pos[axis] = e.pos[axis]
            f.ref_vel[axis] = e.vel[axis]
        if f.rates_only == 1:
            for axis in range(3):
                f.att_rate[axis] = f.want_rate[axis]
            return
        q = f.want_quat
        f.tilt_cos = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])
        attitude.follow(f, g, dt_s)
        return
    correction = sticks.CORRECTION_MPS if control == _LOITER else max(f.speed_xy, 1.0)
    if f.blind == 1:  # level, drifting with the wind
        acc_e, acc_n = 0.0, 0.0
    else:
        acc_e, acc_n = horizontal(e, f, g, correction, dt_s)
    if control == _LOITER:
        attitude.aim(f, g, acc_e, acc_n, True, 0.0, sticks.yaw_rate(f, p), dt_s)
        return
    turning, yaw, yaw_rate = turn_nose(e, f, dt_s)
    if f.sticks[2] != 0.0:  # the yaw stick overrides the yaw mode (AutoYaw::get_heading)
        f.heading = _HOLD
        turning = True
        yaw_rate = sticks.yaw_rate(f, p)
    attitude.aim(f, g, acc_e, acc_n, turning, yaw, yaw_rate, dt_s)


@kernel
def turn(
    estimate: Records,
    flight: Records,
    legs: Records,
    which: Ints,
    tuned: Records,
    settings: Records,
    out: Floats,
    dt_s: float,
) -> int:
    """Run one pass for every row and write `out`, (n, motors) commands 0…1; return how many rows raised a new event.

    `which` (n,) is the row of `tuned` and `settings` that holds each aircraft's gains and parameters.
    """
    flagged = 0
    for i in range(flight.shape[0]):
        f: Any = flight[i]
        control = f.control
        before = f.flags
        if control == _OFF:
            for motor in range(out.shape[1]):
                out[i, motor] = 0.0
            continue
        e: Any = estimate[i]
        g: Any = tuned[which[i]]
        f.slow_s += dt_s
        if control == _IDLE:
            _idle_motors(f, settings[which[i]], out, i, dt_s)
        elif f.landed == 1:
            if control == _TAKEOFF or (control == _ATTITUDE and f.want_climb > 0.0):
                _run_takeoff(e, f, settings[which[i]], g, out, i, dt_s)
            elif control >= _STABILIZE:
                _wait_for_pilot(e, f, settings[which[i]], g, out, i, dt_s)
            else:
                f.control = _IDLE
        else:
            f.spool = 1.0
            slow = f.slow_s >= SLOW_S - _EARLY_S
            if slow:
                slow_s = f.slow_s if f.slow_s < 2.0 * SLOW_S else max(SLOW_S, dt_s)
                f.slow_s = 0.0
                _run_slow_control(e, f, legs[i], settings[which[i]], g, slow_s)
            if control != _STABILIZE:
                f.throttle = lift(e, f, g)
                if f.rates_only == 0 or control != _ATTITUDE:
                    attitude.advance(f, dt_s)
                else:
                    attitude.start_at(e, f)
                down = control == _LAND and e.height < _LAND_HEIGHT_M
                rates_only = control == _ATTITUDE and f.rates_only == 1
                out[i, 0], out[i, 1], out[i, 2], out[i, 3] = turn_motors(e, f, g, down, rates_only)
            elif sticks.throttle_zero(f, dt_s):
                f.throttle = 0.0
                f.rate_i[0] = 0.0
                f.rate_i[1] = 0.0
                f.rate_i[2] = 0.0
                attitude.start(e, f)
                _set_all_motors(out, i, settings[which[i]].MOT_SPIN_ARM)
            else:
                f.throttle = sticks.throttle(f, settings[which[i]])
                attitude.advance(f, dt_s)
                out[i, 0], out[i, 1], out[i, 2], out[i, 3] = turn_motors(e, f, g, False, False)
            if slow:
                _update_detectors(e, f, slow_s)
        if f.flags & ~before:
            flagged += 1
    return flagged


@kernel
def rest(flight: Records, row: int) -> None:
    """Reset one row's controllers before take-off."""
    f: Any = flight[row]
    relax(f)
    f.throttle_i = 0.0
    f.land_s = 0.0
    f.crash_s = 0.0


@kernel
def hold(estimate: Records, flight: Records, row: int) -> None:
    """Set one row's reference to its estimated state (AC_PosControl::init_NE_controller, init_U_controller)."""
    e: Any = estimate[row]
    f: Any = flight[row]
    for axis in range(3):
        f.ref_pos[axis] = e.pos[axis]
        f.ref_vel[axis] = e.vel[axis]
        f.ref_acc[axis] = 0.0
    f.limit[0] = 0.0
    f.limit[1] = 0.0
    f.slow_s = 1e9


@kernel
def loiter(estimate: Records, flight: Records, row: int) -> None:
    """Start LOITER for one row."""
    sticks.begin_loiter(estimate[row], flight[row])
