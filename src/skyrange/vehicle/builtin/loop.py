"""Main loop: one pass of guidance, control and landing detection for every aircraft.

The compiled function `run_loop` passes over all rows after the estimator has updated each aircraft's state. It controls
attitude and thrust in each pass; guidance, position control and the landing detector run every `gains.SLOW_LOOP_S`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from skyrange.contracts.components import Floats, Ints
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin import pilot
from skyrange.vehicle.builtin.control import (
    attitude,
    motor_control,
    position,
)
from skyrange.vehicle.builtin.control.gains import SLOW_LOOP_S
from skyrange.vehicle.builtin.control.motor_control import (
    COMING_DOWN,
    FOLLOWS_CLIMB,
    HELD,
    LANES,
    ON_GROUND,
    RATES_ONLY,
)
from skyrange.vehicle.builtin.control.position import relax_controllers, update_u_controller
from skyrange.vehicle.builtin.guidance.reference import update_reference
from skyrange.vehicle.builtin.guidance.yaw_target import update_yaw_target
from skyrange.vehicle.builtin.layout import AutoYawMode, ControlMode, FlightEvent, Records

_OFF = int(ControlMode.OFF)
_IDLE = int(ControlMode.IDLE)
_TAKEOFF = int(ControlMode.TAKEOFF)
_LAND = int(ControlMode.LAND)
_ATTITUDE = int(ControlMode.ATTITUDE)
_STABILIZE = int(ControlMode.STABILIZE)
_ALT_HOLD = int(ControlMode.ALT_HOLD)
_LOITER = int(ControlMode.LOITER)
_HOLD = int(AutoYawMode.HOLD)
_LIFT_OFF = int(FlightEvent.LIFT_OFF)
_LAND_COMPLETE = int(FlightEvent.LAND_COMPLETE)
_CRASH = int(FlightEvent.CRASH)
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
_KEEP = -1.0  # instead of a command: the motors keep theirs
_CHUNK = 64  # rows that are processed together: their records stay in the cache
_EARLY_S = 1e-9  # rounding error of a sum of steps


@compiled
def reset_reference(e: Any, f: Any) -> None:
    """Set the reference and the attitude target to the aircraft's estimated state."""
    for axis in range(3):
        f.ref_pos[axis] = e.pos[axis]
        f.ref_vel[axis] = e.vel[axis]
        f.ref_acc[axis] = 0.0
    f.predicted_lean[0] = e.roll
    f.predicted_lean[1] = e.pitch
    f.predicted_lean_rate[0] = 0.0
    f.predicted_lean_rate[1] = 0.0
    attitude.reset_target_and_rate(e, f)


@compiled
def _spool(e: Any, f: Any, p: Any, dt_s: float) -> float:
    """Spool the motors up from ground idle (AP_MotorsMulticopter::output_logic); their command, `_KEEP` once up.

    Like the other functions for one row it is passed records and no arrays: a compiled function that is passed an array
    counts a reference to it, which takes as long as the rest.
    """
    reset_reference(e, f)
    relax_controllers(f)
    if f.spool_state >= 1.0:
        return _KEEP
    f.spool_state = min(f.spool_state + dt_s / p.MOT_SPOOL_TIME, 1.0)
    f.throttle = 0.0
    command: float = f.spool_state * p.MOT_SPIN_MIN
    return command


@compiled
def _idle_motors(f: Any, p: Any, dt_s: float) -> float:
    """Move towards ground idle, MOT_SPIN_ARM, no faster than motors spool up; returns the command of all motors."""
    step = dt_s / p.MOT_SPOOL_TIME
    armed = min(p.MOT_SPIN_ARM / p.MOT_SPIN_MIN, 1.0) if p.MOT_SPIN_MIN > 0.0 else 0.0
    f.spool_state = min(max(armed, f.spool_state - step), f.spool_state + step)
    command: float = f.spool_state * p.MOT_SPIN_MIN
    return command


@compiled
def _leave_ground(f: Any) -> None:
    f.landed = 0
    f.land_s = 0.0
    f.flags |= _LIFT_OFF
    f.since_slow_s = 1e9


@compiled
def _run_takeoff(e: Any, f: Any, p: Any, dt_s: float) -> tuple[int, float]:
    """Spool up, then raise the throttle until the aircraft moves (takeoff.cpp); returns as `_prepare_row`."""
    command = _spool(e, f, p, dt_s)
    if command != _KEEP:
        return 0, command
    level = math.sqrt(e.quat[0] * e.quat[0] + e.quat[3] * e.quat[3])
    if level > 0.0:  # upright, as it stands
        f.att_target[0] = e.quat[0] / level
        f.att_target[1] = 0.0
        f.att_target[2] = 0.0
        f.att_target[3] = e.quat[3] / level
    f.throttle = min(f.throttle + dt_s / p.TKOFF_SLEW_TIME, 1.0)
    for axis in range(3):
        f.att_target_rate[axis] = 0.0
    if f.throttle >= 0.9 or e.accel[2] >= 0.5 * f.accel_z or e.vel[2] >= 0.1 * f.speed_up:
        f.throttle_i = f.throttle - p.MOT_THST_HOVER
        _leave_ground(f)
    return HELD | ON_GROUND, _KEEP


@compiled
def _wait_for_pilot(e: Any, f: Any, p: Any, dt_s: float) -> tuple[int, float]:
    """Keep the motors idle on the ground in a pilot's mode until the throttle is raised; returns as `_prepare_row`."""
    if f.control == _STABILIZE:
        if not pilot.update_throttle_zero(f, dt_s):
            command = _spool(e, f, p, dt_s)
            if command == _KEEP:
                _leave_ground(f)
            return 0, command
    else:
        climbing = pilot.desired_climb_rate(f, p) > 0.0
        pilot.update_throttle_zero(f, dt_s)
        if climbing:
            todo, command = _run_takeoff(e, f, p, dt_s)
            return todo, command
    f.throttle = 0.0
    reset_reference(e, f)
    return 0, _idle_motors(f, p, dt_s)


@compiled
def _soften_for_landing(e: Any, f: Any, dt_s: float) -> None:
    """Release the lean that opposes wind and position error (AC_PosControl `soften_for_landing_NE`).

    ArduCopter does so only once its landing criteria have been met, and only stops the integral. In a wind that takes
    more lean than these criteria allow, it would stand with turning motors for ever.
    """
    part = dt_s / (dt_s + _RELAX_TC_S)
    for axis in range(2):
        f.ref_pos[axis] += (e.pos[axis] - f.ref_pos[axis]) * part
        f.vel_i[axis] -= f.vel_i[axis] * part


@compiled
def _update_detectors(e: Any, f: Any, dt_s: float) -> None:
    """Update the landing and crash detectors.

    Landed: minimum throttle, at rest and level for a second. Crashed: two seconds far from the target attitude.
    """
    f.tilt_target = attitude.angle_of_half_sine2(0.5 - 0.5 * f.tilt_cos)
    f.tilt_error = attitude.angle_of_half_sine2(f.tilt_half2)
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


@compiled
def _controls_position(control: int) -> bool:
    """Whether a control mode follows a position or a velocity, not the pilot's lean angles nor an attitude."""
    return control not in (_STABILIZE, _ALT_HOLD, _ATTITUDE)


@compiled
def _run_attitude_modes(e: Any, f: Any, p: Any, g: Any, dt_s: float) -> None:
    """Run the slow part of control in the modes that do not control a position."""
    control = f.control
    if control != _STABILIZE:
        update_u_controller(e, f, g, dt_s)
    most = p.ANGLE_MAX * _CDEG
    for axis in range(2):  # no position is held; holding one again starts from here
        f.ref_pos[axis] = e.pos[axis]
        f.ref_vel[axis] = e.vel[axis]
    if control in (_STABILIZE, _ALT_HOLD):
        forward, left = pilot.desired_lean_accel(e, f, most, most)
        acc_e, acc_n = pilot.heading_to_local(e, forward, left)
        yaw_rate = pilot.desired_yaw_rate(f, p)
        attitude.input_thrust_vector(f, g, acc_e, acc_n, turning=True, yaw=0.0, yaw_rate=yaw_rate, dt_s=dt_s)
        return
    if f.rates_only == 1:
        for axis in range(3):
            f.att_target_rate[axis] = f.guided_ang_vel[axis]
        return
    q = f.guided_quat
    f.tilt_cos = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])
    attitude.input_quaternion(f, g, dt_s)


@compiled
def _request_position_control(e: Any, f: Any, p: Any, dt_s: float) -> tuple[float, bool, float, float]:
    """Return what position control is asked for, the arguments of `position.load_lane` from the speed on."""
    if f.control == _LOITER:
        return pilot.MAX_LOITER_CORRECTION_MPS, True, 0.0, pilot.desired_yaw_rate(f, p)
    turning, yaw, yaw_rate = update_yaw_target(e, f, dt_s)
    if f.sticks[2] != 0.0:  # the yaw stick overrides the yaw mode (AutoYaw::get_heading)
        f.auto_yaw_mode = _HOLD
        turning = True
        yaw_rate = pilot.desired_yaw_rate(f, p)
    return max(f.speed_xy, 1.0), turning, yaw, yaw_rate


@compiled
def _run_on_ground(e: Any, f: Any, p: Any, dt_s: float) -> tuple[int, float]:
    """Run one pass of an aircraft that has landed; returns as `_prepare_row`."""
    if f.control == _TAKEOFF or (f.control == _ATTITUDE and f.guided_climb_rate > 0.0):
        todo, command = _run_takeoff(e, f, p, dt_s)
        return todo, command
    if f.control >= _STABILIZE:
        todo, command = _wait_for_pilot(e, f, p, dt_s)
        return todo, command
    f.control = _IDLE
    return 0, _KEEP


@compiled
def _prepare_flight(e: Any, f: Any, p: Any, control: int, dt_s: float) -> tuple[int, float]:
    """Prepare attitude control of a flying aircraft, whose mode was `control`; returns as `_prepare_row`."""
    if control != _STABILIZE:
        if control == _ATTITUDE and f.rates_only == 1:
            attitude.reset_target(e, f)
            return HELD | FOLLOWS_CLIMB | RATES_ONLY, _KEEP
        down = control == _LAND and e.height < _LAND_HEIGHT_M
        return HELD | FOLLOWS_CLIMB | (COMING_DOWN if down else 0), _KEEP
    if not pilot.update_throttle_zero(f, dt_s):
        f.throttle = pilot.desired_throttle(f, p)
        return HELD, _KEEP
    f.throttle = 0.0
    f.rate_i[0] = 0.0
    f.rate_i[1] = 0.0
    f.rate_i[2] = 0.0
    attitude.reset_target_and_rate(e, f)
    return 0, p.MOT_SPIN_ARM


@compiled
def _prepare_row(e: Any, f: Any, p: Any, w: Any, g: Any, dt_s: float) -> tuple[int, float, float]:
    """Run what has branches for one aircraft: modes, guidance, take-off.

    Returns what is left for attitude control, a sum of bits; if nothing is, the command of all motors, `_KEEP` if they
    keep theirs; and the step of slow control, 0 if it was not due.
    """
    control = f.control
    if control == _OFF:
        return 0, 0.0, 0.0
    if f.arming_delay_s > 0.0:
        f.arming_delay_s -= dt_s
        f.spool_state = 0.0
        return 0, 0.0, 0.0
    f.since_slow_s += dt_s
    if control == _IDLE:
        return 0, _idle_motors(f, p, dt_s), 0.0
    if f.landed == 1:
        todo, command = _run_on_ground(e, f, p, dt_s)
        return todo, command, 0.0
    f.spool_state = 1.0
    slow_s = 0.0
    if f.since_slow_s >= SLOW_LOOP_S - _EARLY_S:
        slow_s = f.since_slow_s if f.since_slow_s < 2.0 * SLOW_LOOP_S else max(SLOW_LOOP_S, dt_s)
        f.since_slow_s = 0.0
        update_reference(e, f, w, p, slow_s)
        if not _controls_position(control):
            _run_attitude_modes(e, f, p, g, slow_s)
    todo, command = _prepare_flight(e, f, p, control, dt_s)
    return todo, command, slow_s


@compiled
def run_loop(  # noqa: PLR0917
    estimate: Records,
    flight: Records,
    legs: Records,
    set_index: Ints,
    tuned: Records,
    settings: Records,
    out: Floats,
    dt_s: float,
) -> int:
    """Run one pass for every row and write `out`, (n, motors) commands 0…1; return how many rows raised a new event.

    `set_index` (n,) is the row of `tuned` and `settings` that holds each aircraft's gains and parameters.
    """
    flagged = 0
    count = flight.shape[0]
    before = np.zeros(_CHUNK, dtype=np.int64)
    todo = np.zeros(_CHUNK, dtype=np.int64)
    slow_s = np.zeros(_CHUNK)
    rows = np.zeros(LANES, dtype=np.int64)
    lanes = np.zeros(position.COLUMNS)
    position_set = np.full(LANES, -1)  # the set of gains in each lane
    motors = np.zeros(motor_control.COLUMNS)
    motor_set = np.full(LANES, -1)
    for first in range(0, count, _CHUNK):
        size = min(_CHUNK, count - first)
        used = 0
        for k in range(size):
            i = first + k
            f: Any = flight[i]
            number = set_index[i]
            before[k] = f.flags
            control = f.control
            e: Any = estimate[i]
            todo[k], command, slow_s[k] = _prepare_row(e, f, settings[number], legs[i], tuned[number], dt_s)
            if todo[k] == 0 and command != _KEEP:
                for motor in range(out.shape[1]):
                    out[i, motor] = command
            if slow_s[k] > 0.0 and _controls_position(control):
                speed, turning, yaw, yaw_rate = _request_position_control(e, f, settings[number], slow_s[k])
                level = f.land_nogps == 1  # drifting with the wind
                position.load_lane(lanes, used, e, f, speed, level, turning, yaw, yaw_rate, slow_s[k])
                rows[used] = i
                if position_set[used] != number:
                    position_set[used] = number
                    position.load_gains(lanes, used, tuned[number])
                used += 1
            if used == LANES or (k == size - 1 and used > 0):
                position.run_position_control(lanes, used)
                for lane in range(used):
                    position.store_lane(lanes, lane, flight[rows[lane]])
                used = 0
        for k in range(size):
            i = first + k
            number = set_index[i]
            if todo[k] != 0:
                rows[used] = i
                if motor_set[used] != number:
                    motor_set[used] = number
                    motor_control.load_gains(motors, used, tuned[number])
                motor_control.load_lane(motors, used, estimate[i], flight[i], todo[k])
                used += 1
            if used == LANES or (k == size - 1 and used > 0):
                motor_control.run_controllers(motors, used, dt_s)
                for lane in range(used):
                    motor_control.store_lane(motors, lane, flight[rows[lane]], out, rows[lane])
                used = 0
        for k in range(size):
            row: Any = flight[first + k]
            if slow_s[k] > 0.0:
                _update_detectors(estimate[first + k], row, slow_s[k])
            if row.flags & ~before[k]:
                flagged += 1
    return flagged


@compiled
def reset_controllers(flight: Records, row: int) -> None:
    """Reset one row's controllers before take-off."""
    f: Any = flight[row]
    relax_controllers(f)
    f.throttle_i = 0.0
    f.land_s = 0.0
    f.crash_s = 0.0


@compiled
def init_reference(estimate: Records, flight: Records, row: int) -> None:
    """Set one row's reference to its estimated state (AC_PosControl::init_NE_controller, init_U_controller)."""
    e: Any = estimate[row]
    f: Any = flight[row]
    for axis in range(3):
        f.ref_pos[axis] = e.pos[axis]
        f.ref_vel[axis] = e.vel[axis]
        f.ref_acc[axis] = 0.0
    f.limited_accel[0] = 0.0
    f.limited_accel[1] = 0.0
    f.since_slow_s = 1e9


@compiled
def init_loiter(estimate: Records, flight: Records, row: int) -> None:
    """Start LOITER for one row."""
    pilot.init_loiter_target(estimate[row], flight[row])
