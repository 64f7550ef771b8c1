"""How does an aircraft follow its reference? ArduCopter's cascade, from position down to the motors.

Gains, limits and structure are those of libraries/AC_AttitudeControl (AC_PosControl.cpp `update_NE_controller`,
`update_U_controller`; AC_AttitudeControl.cpp `attitude_controller_run_quat`; AC_AttitudeControl_Multi.cpp) and
libraries/AP_Motors (AP_MotorsMatrix.cpp `output_armed_stabilizing`), at 400 Hz. One record per aircraft in,
commands out; no row touches another.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import kernel
from skyrange.vehicle.builtin.shaping import clamp, limit_xy, sqrt_controller, sqrt_controller_xy, wrap_pi

GRAVITY_MPS2 = 9.80665
"""ArduPilot's GRAVITY_MSS (libraries/AP_Math/definitions.h)."""
_CDEG = math.pi / 18_000.0
_LEAN_COS_MIN = 0.5  # the angle boost's limit (AC_AttitudeControl_Multi::get_throttle_boosted)
_YAW_HEADROOM = 0.2  # of full thrust: MOT_YAW_HEADROOM's 200 µs of 1000


@kernel
def _low_pass(state: float, value: float, hz: float, dt_s: float) -> float:
    """One step of ArduPilot's first-order filter (libraries/Filter/LowPassFilter.cpp)."""
    rc = 1.0 / (2.0 * math.pi * hz)
    return state + (value - state) * dt_s / (dt_s + rc)


@kernel
def horizontal(e: Any, f: Any, p: Any, dt_s: float) -> tuple[float, float]:
    """The horizontal acceleration to ask for, m/s² (east, north), within the lean limit.

    Position error by a square-root controller to velocity, velocity error by a PID, plus the
    reference's own velocity and acceleration.
    """
    want_e, want_n = sqrt_controller_xy(
        f.ref_pos[0] - e.pos[0], f.ref_pos[1] - e.pos[1], p.PSC_POSXY_P, f.accel_xy, dt_s
    )
    want_e, want_n = limit_xy(want_e, want_n, max(f.speed_xy, 1.0))
    error_e = want_e + f.ref_vel[0] - e.vel[0]
    error_n = want_n + f.ref_vel[1] - e.vel[1]
    last_e = f.vel_err[0]
    last_n = f.vel_err[1]
    f.vel_err[0] = _low_pass(last_e, error_e, p.PSC_VELXY_FLTE, dt_s)
    f.vel_err[1] = _low_pass(last_n, error_n, p.PSC_VELXY_FLTE, dt_s)
    f.vel_d[0] = _low_pass(f.vel_d[0], (f.vel_err[0] - last_e) / dt_s, p.PSC_VELXY_FLTD, dt_s)
    f.vel_d[1] = _low_pass(f.vel_d[1], (f.vel_err[1] - last_n) / dt_s, p.PSC_VELXY_FLTD, dt_s)
    ask_e = p.PSC_VELXY_P * f.vel_err[0] + f.vel_i[0] + p.PSC_VELXY_D * f.vel_d[0] + f.ref_acc[0]
    ask_n = p.PSC_VELXY_P * f.vel_err[1] + f.vel_i[1] + p.PSC_VELXY_D * f.vel_d[1] + f.ref_acc[1]
    most = GRAVITY_MPS2 * math.tan(p.ANGLE_MAX * _CDEG)
    got_e, got_n = limit_xy(ask_e, ask_n, most)
    cut = got_e != ask_e or got_n != ask_n
    # at the limit the integral may shrink but not grow
    if not (cut and f.vel_err[0] * ask_e + f.vel_err[1] * ask_n > 0.0):
        f.vel_i[0], f.vel_i[1] = limit_xy(
            f.vel_i[0] + p.PSC_VELXY_I * f.vel_err[0] * dt_s,
            f.vel_i[1] + p.PSC_VELXY_I * f.vel_err[1] * dt_s,
            p.PSC_VELXY_IMAX * 0.01,
        )
    return got_e, got_n


@kernel
def vertical(e: Any, f: Any, p: Any, dt_s: float) -> float:
    """The vertical thrust to ask for, 0…1 of full thrust, before the lean is made up for."""
    climb = sqrt_controller(f.ref_pos[2] - e.pos[2], p.PSC_POSZ_P, f.accel_z, dt_s)
    climb = clamp(climb, -max(f.speed_down, 0.5), max(f.speed_up, 0.5)) + f.ref_vel[2]
    f.climb_err = _low_pass(f.climb_err, climb - e.vel[2], p.PSC_VELZ_FLTE, dt_s)
    ask = p.PSC_VELZ_P * f.climb_err + f.ref_acc[2]
    f.accel_err = _low_pass(f.accel_err, ask - e.accel[2], p.PSC_ACCZ_FLTE, dt_s)
    # PSC_ACCZ gains are per cm/s² and in 1/1000 of full throttle: 0.1 per m/s²
    proportional = 0.1 * p.PSC_ACCZ_P * f.accel_err
    throttle = p.MOT_THST_HOVER + proportional + f.throttle_i
    stuck = (throttle <= 0.0 and f.accel_err < 0.0) or (throttle >= 1.0 and f.accel_err > 0.0)
    if not stuck:
        most = 0.001 * p.PSC_ACCZ_IMAX
        f.throttle_i = clamp(f.throttle_i + 0.1 * p.PSC_ACCZ_I * f.accel_err * dt_s, -most, most)
    return clamp(p.MOT_THST_HOVER + proportional + f.throttle_i, 0.0, 1.0)


@kernel
def attitude_rates(e: Any, f: Any, p: Any, acc_e: float, acc_n: float, dt_s: float) -> tuple[float, float, float]:
    """Body rates to ask for, rad/s (forward, left, up): thrust towards the wanted acceleration, nose to `ref_yaw`."""
    length = math.sqrt(acc_e * acc_e + acc_n * acc_n + GRAVITY_MPS2 * GRAVITY_MPS2)
    want_e = acc_e / length
    want_n = acc_n / length
    want_u = GRAVITY_MPS2 / length
    w = e.quat[0]
    x = e.quat[1]
    y = e.quat[2]
    z = e.quat[3]
    # the wanted thrust direction seen from the body: columns of the body-to-local rotation
    forward = (1 - 2 * (y * y + z * z)) * want_e + 2 * (x * y + w * z) * want_n + 2 * (x * z - w * y) * want_u
    left = 2 * (x * y - w * z) * want_e + (1 - 2 * (x * x + z * z)) * want_n + 2 * (y * z + w * x) * want_u
    up = 2 * (x * z + w * y) * want_e + 2 * (y * z - w * x) * want_n + (1 - 2 * (x * x + y * y)) * want_u
    across = math.sqrt(forward * forward + left * left)
    angle = math.atan2(across, up)
    f.tilt_target = math.acos(clamp(want_u, -1.0, 1.0))
    f.tilt_error = angle
    scale = angle / across if across > 1e-9 else 1.0
    roll_error = -left * scale
    pitch_error = forward * scale
    roll_rate = sqrt_controller(roll_error, p.ATC_ANG_RLL_P, 0.5 * p.ATC_ACCEL_R_MAX * _CDEG, dt_s)
    pitch_rate = sqrt_controller(pitch_error, p.ATC_ANG_PIT_P, 0.5 * p.ATC_ACCEL_P_MAX * _CDEG, dt_s)
    yaw_error = clamp(wrap_pi(f.ref_yaw - e.yaw), -0.25 * math.pi, 0.25 * math.pi)
    yaw_rate = sqrt_controller(yaw_error, p.ATC_ANG_YAW_P, 0.5 * p.ATC_ACCEL_Y_MAX * _CDEG, dt_s)
    return roll_rate, pitch_rate, (yaw_rate + f.ref_yaw_rate) * max(up, 0.0)


@kernel
def rate_torques(
    e: Any, f: Any, p: Any, roll_rate: float, pitch_rate: float, yaw_rate: float, dt_s: float
) -> tuple[float, float, float]:
    """Roll, pitch and yaw efforts, -1…1 each, from the error of the body rates."""
    error = roll_rate - e.rate[0]
    f.rate_d[0] = _low_pass(f.rate_d[0], (f.rate_last[0] - e.rate[0]) / dt_s, p.ATC_RAT_RLL_FLTD, dt_s)
    f.rate_i[0] = clamp(f.rate_i[0] + p.ATC_RAT_RLL_I * error * dt_s * f.spool, -p.ATC_RAT_RLL_IMAX, p.ATC_RAT_RLL_IMAX)
    roll = clamp(p.ATC_RAT_RLL_P * error + f.rate_i[0] + p.ATC_RAT_RLL_D * f.rate_d[0], -1.0, 1.0)
    error = pitch_rate - e.rate[1]
    f.rate_d[1] = _low_pass(f.rate_d[1], (f.rate_last[1] - e.rate[1]) / dt_s, p.ATC_RAT_PIT_FLTD, dt_s)
    f.rate_i[1] = clamp(f.rate_i[1] + p.ATC_RAT_PIT_I * error * dt_s * f.spool, -p.ATC_RAT_PIT_IMAX, p.ATC_RAT_PIT_IMAX)
    pitch = clamp(p.ATC_RAT_PIT_P * error + f.rate_i[1] + p.ATC_RAT_PIT_D * f.rate_d[1], -1.0, 1.0)
    f.yaw_err = _low_pass(f.yaw_err, yaw_rate - e.rate[2], p.ATC_RAT_YAW_FLTE, dt_s)
    f.rate_i[2] = clamp(
        f.rate_i[2] + p.ATC_RAT_YAW_I * f.yaw_err * dt_s * f.spool, -p.ATC_RAT_YAW_IMAX, p.ATC_RAT_YAW_IMAX
    )
    yaw = clamp(p.ATC_RAT_YAW_P * f.yaw_err + f.rate_i[2], -1.0, 1.0)
    for axis in range(3):
        f.rate_last[axis] = e.rate[axis]
    return roll, pitch, yaw


@kernel
def _command(thrust: float, expo: float, least: float) -> float:
    """The actuator command for a share of full thrust: the inverse of (1 - expo)·c + expo·c²."""
    share = clamp(thrust, 0.0, 1.0)
    if abs(expo) < 1e-6:
        return max(share, least)
    return max((math.sqrt((1.0 - expo) ** 2 + 4.0 * expo * share) - (1.0 - expo)) / (2.0 * expo), least)


@kernel
def mix(p: Any, out: Any, throttle: float, roll: float, pitch: float, yaw: float) -> None:
    """Commands of four motors (QUAD X order) for a thrust and three efforts.

    Roll and pitch come first, then throttle, then yaw, which always keeps some headroom; where all do not
    fit, thrust is moved by at most what keeps attitude, as in AP_MotorsMatrix. Positive roll lowers
    the right side, positive pitch lowers the nose, positive yaw turns left.
    """
    expo = p.MOT_THST_EXPO
    least = p.MOT_SPIN_MIN
    front_right = 0.5 * (-roll - pitch)
    rear_left = 0.5 * (roll + pitch)
    front_left = 0.5 * (roll - pitch)
    rear_right = 0.5 * (-roll + pitch)
    high = max(max(front_right, rear_left), max(front_left, rear_right))
    low = min(min(front_right, rear_left), min(front_left, rear_right))
    if high - low > 1.0:
        shrink = 1.0 / (high - low)
        front_right *= shrink
        rear_left *= shrink
        front_left *= shrink
        rear_right *= shrink
        high *= shrink
        low *= shrink
    # enough thrust to turn on, no more than the throttle asks for where it is more
    base = clamp(throttle, min(-low, 0.5), 1.0 - min(high, 0.5)) if throttle > 0.0 else 0.0
    room = max(min(1.0 - base - high, base + low), _YAW_HEADROOM * 0.5)
    turn = clamp(0.5 * yaw, -room, room)
    # counter-clockwise rotors (1, 2) push the body clockwise: less of them turns left
    out[0] = _command(base + front_right - turn, expo, least)
    out[1] = _command(base + rear_left - turn, expo, least)
    out[2] = _command(base + front_left + turn, expo, least)
    out[3] = _command(base + rear_right + turn, expo, least)


@kernel
def relax(f: Any) -> None:
    """Forget what the controllers have gathered: on the ground their errors mean nothing."""
    for axis in range(2):
        f.vel_err[axis] = 0.0
        f.vel_d[axis] = 0.0
        f.vel_i[axis] = 0.0
        f.rate_d[axis] = 0.0
    for axis in range(3):
        f.rate_i[axis] = 0.0
    f.climb_err = 0.0
    f.accel_err = 0.0
    f.yaw_err = 0.0


@kernel
def fly(e: Any, f: Any, p: Any, out: Any, dt_s: float) -> None:
    """Follow the reference for one step: writes four commands and `throttle`."""
    acc_e, acc_n = (0.0, 0.0) if f.blind == 1 else horizontal(e, f, p, dt_s)
    f.throttle = vertical(e, f, p, dt_s)
    roll_rate, pitch_rate, yaw_rate = attitude_rates(e, f, p, acc_e, acc_n, dt_s)
    roll, pitch, yaw = rate_torques(e, f, p, roll_rate, pitch_rate, yaw_rate, dt_s)
    lean = max(math.cos(e.roll) * math.cos(e.pitch), _LEAN_COS_MIN)
    mix(p, out, min(f.throttle / lean, 1.0), roll, pitch, yaw)


@kernel
def stand(e: Any, f: Any, p: Any, out: Any, throttle: float, dt_s: float) -> None:
    """Stay level at a given throttle on the ground, before lift-off."""
    f.throttle = throttle
    roll_rate, pitch_rate, yaw_rate = attitude_rates(e, f, p, 0.0, 0.0, dt_s)
    roll, pitch, yaw = rate_torques(e, f, p, roll_rate, pitch_rate, yaw_rate, dt_s)
    for axis in range(3):
        f.rate_i[axis] = 0.0
    mix(p, out, throttle, roll, pitch, yaw)
