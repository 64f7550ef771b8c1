"""Attitude control: shaped targets with feed-forward, angle and rate controllers, and the motor mixer.

After libraries/AC_AttitudeControl/AC_AttitudeControl.cpp (`input_thrust_vector_heading_rad`,
`input_thrust_vector_rate_heading_rads`, `attitude_controller_run_quat`, `update_ang_vel_target_from_att_error`), AC_PID
and libraries/AP_Motors/AP_MotorsMatrix.cpp (`output_armed_stabilizing`). Targets are shaped when position control runs;
in between they turn at their rates. As in ArduCopter, a rotation is split into a tilt and a turn about the thrust axis.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.control.gains import GRAVITY_MPS2
from skyrange.vehicle.builtin.control.shaping import clamp, sqrt_controller

_TILT_ERROR_RAD = math.radians(30.0)  # AC_ATTITUDE_THRUST_ERROR_ANGLE_RAD
_TILT_NEAR2 = math.sin(0.5 * _TILT_ERROR_RAD) ** 2
_TILT_FAR2 = math.sin(_TILT_ERROR_RAD) ** 2
_SERIES_LIMIT = 1e-3  # squared sine up to which three terms of a series are exact to 1e-9
_YAW_HEADROOM = 0.2  # MOT_YAW_HEADROOM's 200 of 1000


@compiled
def _double_arcsine(s2: float) -> float:
    """2·asin(s)/s as a series of s², exact to 1e-9 for squares up to 0.04."""
    if s2 < _SERIES_LIMIT:
        return 2.0 + s2 * (1.0 / 3.0 + s2 * (3.0 / 20.0))
    return 2.0 + s2 * (
        1.0 / 3.0 + s2 * (3.0 / 20.0 + s2 * (15.0 / 168.0 + s2 * (105.0 / 1728.0 + s2 * 945.0 / 21120.0)))
    )


@compiled
def angle_of_half_sine2(s2: float) -> float:
    """Return an angle from the squared sine of its half."""
    s2 = clamp(s2, 0.0, 1.0)
    s = math.sqrt(s2)
    return s * _double_arcsine(s2) if s2 < 0.04 else 2.0 * math.asin(s)


@compiled
def _angle_over_sine(s: float, c: float) -> float:
    """2·atan2(s, c) / s for the sine s ≥ 0 and cosine c of half an angle."""
    return 2.0 * math.atan2(s, c) / s if s > 0.0 else 2.0


@compiled
def relative_rotation(
    aw: float, ax: float, ay: float, az: float, bw: float, bx: float, by: float, bz: float
) -> tuple[float, float, float, float]:
    """Return the rotation from attitude a to attitude b in the frame of a: conj(a) times b, with w at least 0."""
    w = aw * bw + ax * bx + ay * by + az * bz
    x = aw * bx - ax * bw - ay * bz + az * by
    y = aw * by + ax * bz - ay * bw - az * bx
    z = aw * bz - ax * by + ay * bx - az * bw
    if w < 0.0:
        return -w, -x, -y, -z
    return w, x, y, z


@compiled
def thrust_heading_rotation_angles(w: float, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return a rotation as (roll, pitch, yaw errors in rad, squared sine of half the tilt): tilt first, then turn.

    Small tilts and turns use series that are exact to 1e-9: asin(s)/(s·√(1-s²)) and 1/√(1-s²).
    """
    s2 = x * x + y * y
    if s2 < _SERIES_LIMIT:
        ratio = 2.0 + s2 * (4.0 / 3.0 + s2 * (16.0 / 15.0))
        scale = 1.0 + s2 * (0.5 + s2 * 0.375)
    elif s2 < 0.04:
        ratio = 256.0 / 315.0 + s2 * (512.0 / 693.0 + s2 * 2048.0 / 3003.0)
        ratio = 2.0 + s2 * (4.0 / 3.0 + s2 * (16.0 / 15.0 + s2 * (32.0 / 35.0 + s2 * ratio)))
        scale = 1.0 + s2 * (0.5 + s2 * (0.375 + s2 * (0.3125 + s2 * (35.0 / 128.0 + s2 * (63.0 / 256.0)))))
    else:
        level = math.sqrt(w * w + z * z)
        if level < 1e-9:  # upside down: every axis is equally short
            return math.pi, 0.0, 0.0, 1.0
        scale = 1.0 / level
        ratio = scale * _angle_over_sine(math.sqrt(s2), level)
    tz = z * scale
    z2 = tz * tz
    near = z2 < 0.04 and w > 0.0
    yaw = tz * (_double_arcsine(z2) if near else _angle_over_sine(abs(tz), w * scale))
    return (x * w - y * z) * ratio, (y * w + x * z) * ratio, yaw, s2


@compiled
def cos_tilt(e: Any) -> float:
    """Return the cosine of the lean angle: the share of the thrust that points up."""
    return float(1.0 - 2.0 * (e.quat[1] * e.quat[1] + e.quat[2] * e.quat[2]))


@compiled
def reset_target_and_rate(e: Any, f: Any) -> None:
    """Set the attitude target to the estimated attitude, at rest (`reset_target_and_rate`)."""
    for part in range(4):
        f.att_target[part] = e.quat[part]
    for axis in range(3):
        f.att_target_rate[axis] = 0.0


@compiled
def reset_target(e: Any, f: Any) -> None:
    """Set the attitude target to the estimated attitude and keep its rates (`input_rate_bf_roll_pitch_yaw_rads`)."""
    for part in range(4):
        f.att_target[part] = e.quat[part]


@compiled
def input_quaternion(f: Any, g: Any, dt_s: float) -> None:
    """Shape the attitude target towards `guided_quat`, which turns at `guided_ang_vel` (`input_quaternion`)."""
    _rotate_by_rates(f.guided_quat, f.guided_ang_vel, dt_s)
    q = f.guided_quat
    shape_target(f, g, q[0], q[1], q[2], q[3], False, f.guided_ang_vel[2], dt_s)


@compiled
def inertial_frame_reset(f: Any, yaw: float) -> None:
    """Turn the attitude target about the vertical (`inertial_frame_reset`)."""
    s = math.sin(0.5 * yaw)
    c = math.cos(0.5 * yaw)
    w = f.att_target[0]
    x = f.att_target[1]
    y = f.att_target[2]
    z = f.att_target[3]
    f.att_target[0] = c * w - s * z
    f.att_target[1] = c * x - s * y
    f.att_target[2] = c * y + s * x
    f.att_target[3] = c * z + s * w


@compiled
def _input_shaping_ang_vel(rate: float, wanted: float, accel: float, dt_s: float) -> float:
    """Move a rate towards another within an angular acceleration (`input_shaping_ang_vel`)."""
    return rate + clamp(wanted - rate, -accel * dt_s, accel * dt_s)


@compiled
def input_thrust_vector(
    f: Any, g: Any, acc_e: float, acc_n: float, turning: bool, yaw: float, yaw_rate: float, dt_s: float
) -> None:
    """Shape the attitude target towards a thrust direction and a heading (or, with `turning`, a yaw rate alone).

    The thrust shall point along the requested acceleration, m/s² (east, north), on top of gravity.
    """
    length = math.sqrt(acc_e * acc_e + acc_n * acc_n + GRAVITY_MPS2 * GRAVITY_MPS2)
    # half-angle form of the shortest rotation from straight up to the thrust direction
    cosine = GRAVITY_MPS2 / length
    f.tilt_cos = cosine
    half = math.sqrt(0.5 * (1.0 + cosine))
    x = -acc_n / length / (2.0 * half)
    y = acc_e / length / (2.0 * half)
    w = half
    z = 0.0
    if not turning:
        c = math.cos(0.5 * yaw)
        s = math.sin(0.5 * yaw)
        z = w * s
        w = w * c
        x, y = x * c + y * s, y * c - x * s
    shape_target(f, g, w, x, y, z, turning, yaw_rate, dt_s)


@compiled
def shape_target(
    f: Any, g: Any, w: float, x: float, y: float, z: float, turning: bool, yaw_rate: float, dt_s: float
) -> None:
    """Shape the attitude target towards an attitude; with `turning`, its heading follows the yaw rate alone."""
    ew, ex, ey, ez = relative_rotation(f.att_target[0], f.att_target[1], f.att_target[2], f.att_target[3], w, x, y, z)
    roll, pitch, turn, _ = thrust_heading_rotation_angles(ew, ex, ey, ez)
    accel = g.accel_max[0]
    f.att_target_rate[0] = _input_shaping_ang_vel(
        f.att_target_rate[0], sqrt_controller(roll, g.input_p, accel, dt_s), accel, dt_s
    )
    accel = g.accel_max[1]
    f.att_target_rate[1] = _input_shaping_ang_vel(
        f.att_target_rate[1], sqrt_controller(pitch, g.input_p, accel, dt_s), accel, dt_s
    )
    accel = g.accel_max[2]
    if turning:
        f.att_target_rate[2] = _input_shaping_ang_vel(f.att_target_rate[2], yaw_rate, accel, dt_s)
    else:
        wanted = clamp(yaw_rate, -g.slew_yaw, g.slew_yaw) + sqrt_controller(turn, g.input_p, accel, dt_s)
        f.att_target_rate[2] = _input_shaping_ang_vel(
            f.att_target_rate[2], clamp(wanted, -g.slew_yaw, g.slew_yaw), accel, dt_s
        )


@compiled
def _rotate_by_rates(q: Any, rate: Any, dt_s: float) -> None:
    """Turn an attitude by its body rates for one step."""
    x = 0.5 * dt_s * rate[0]
    y = 0.5 * dt_s * rate[1]
    z = 0.5 * dt_s * rate[2]
    square = x * x + y * y + z * z
    sine = 1.0 - square * (1.0 / 6.0 - square / 120.0)
    c = 1.0 - square * (0.5 - square / 24.0)
    x *= sine
    y *= sine
    z *= sine
    qw = q[0]
    qx = q[1]
    qy = q[2]
    qz = q[3]
    w = qw * c - qx * x - qy * y - qz * z
    i = qw * x + qx * c + qy * z - qz * y
    j = qw * y - qx * z + qy * c + qz * x
    k = qw * z + qx * y - qy * x + qz * c
    scale = 1.5 - 0.5 * (w * w + i * i + j * j + k * k)  # one Newton step: only rounding errors are left
    q[0] = w * scale
    q[1] = i * scale
    q[2] = j * scale
    q[3] = k * scale


@compiled
def update_attitude_target(f: Any, dt_s: float) -> None:
    """Turn the attitude target by its rates for one step (`update_attitude_target`)."""
    _rotate_by_rates(f.att_target, f.att_target_rate, dt_s)


@compiled
def _angle_to_rate(error: float, p: float, linear: float, accel: float) -> float:
    """Return the rate that corrects an angle error: linear up to `linear`, a square root beyond."""
    if error > linear:
        return math.sqrt(2.0 * accel * (error - 0.5 * linear))
    if error < -linear:
        return -math.sqrt(2.0 * accel * (-error - 0.5 * linear))
    return error * p


@compiled
def run_angle_controller(e: Any, f: Any, g: Any) -> tuple[float, float, float]:
    """Return body rates, rad/s (forward, left, up), that bring the attitude to its target and follow its rates."""
    w, x, y, z = relative_rotation(
        e.quat[0], e.quat[1], e.quat[2], e.quat[3], f.att_target[0], f.att_target[1], f.att_target[2], f.att_target[3]
    )
    roll, pitch, yaw, tilted = thrust_heading_rotation_angles(w, x, y, z)
    f.tilt_half2 = tilted
    if abs(yaw) > g.yaw_error_max:  # limit the lead of the target over a yaw that cannot follow
        held = clamp(yaw, -g.yaw_error_max, g.yaw_error_max)
        s = math.sin(0.5 * (held - yaw))
        c = math.cos(0.5 * (held - yaw))
        aw = f.att_target[0]
        ax = f.att_target[1]
        ay = f.att_target[2]
        az = f.att_target[3]
        f.att_target[0] = aw * c - az * s
        f.att_target[1] = ax * c + ay * s
        f.att_target[2] = ay * c - ax * s
        f.att_target[3] = az * c + aw * s
        w, x, y, z = w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s
        yaw = held
    roll_rate = _angle_to_rate(roll, g.angle_p[0], g.angle_linear[0], g.angle_accel[0])
    pitch_rate = _angle_to_rate(pitch, g.angle_p[1], g.angle_linear[1], g.angle_accel[1])
    yaw_rate = _angle_to_rate(yaw, g.angle_p[2], g.angle_linear[2], g.angle_accel[2])
    # the target's rates in the body frame
    a = f.att_target_rate[0]
    b = f.att_target_rate[1]
    c = f.att_target_rate[2]
    u = 2.0 * (y * c - z * b)
    v = 2.0 * (z * a - x * c)
    t = 2.0 * (x * b - y * a)
    a, b, c = a + w * u + (y * t - z * v), b + w * v + (z * u - x * t), c + w * t + (x * v - y * u)
    if tilted > _TILT_FAR2:
        yaw_rate = e.rate[2]
    elif tilted > _TILT_NEAR2:
        forward = 2.0 - 2.0 * math.asin(math.sqrt(tilted)) / _TILT_ERROR_RAD
        roll_rate += a * forward
        pitch_rate += b * forward
        yaw_rate = e.rate[2] * (1.0 - forward) + (yaw_rate + c) * forward
    else:
        roll_rate += a
        pitch_rate += b
        yaw_rate += c
    return roll_rate, pitch_rate, yaw_rate


@compiled
def run_rate_controller(
    e: Any, f: Any, g: Any, roll_rate: float, pitch_rate: float, yaw_rate: float
) -> tuple[float, float, float]:
    """Return roll, pitch and yaw demands, -1…1 each, from the errors of the body rates (AC_PID::update_all)."""
    f.target_rate[0] += (roll_rate - f.target_rate[0]) * g.target_alpha[0]
    f.target_rate[1] += (pitch_rate - f.target_rate[1]) * g.target_alpha[1]
    f.target_rate[2] += (yaw_rate - f.target_rate[2]) * g.target_alpha[2]
    for axis in range(3):
        last = f.rate_err[axis]
        error = last + (f.target_rate[axis] - e.rate[axis] - last) * g.error_alpha[axis]
        f.rate_err[axis] = error
        f.rate_i[axis] = clamp(
            f.rate_i[axis] + g.rate_i[axis] * error * f.spool_state, -g.rate_imax[axis], g.rate_imax[axis]
        )
        if axis < 2:
            f.rate_d[axis] += (error - last - f.rate_d[axis]) * g.d_alpha[axis]
    roll = g.rate_p[0] * f.rate_err[0] + f.rate_i[0] + g.rate_d[0] * f.rate_d[0]
    pitch = g.rate_p[1] * f.rate_err[1] + f.rate_i[1] + g.rate_d[1] * f.rate_d[1]
    yaw = g.rate_p[2] * f.rate_err[2] + f.rate_i[2]
    return clamp(roll, -1.0, 1.0), clamp(pitch, -1.0, 1.0), clamp(yaw, -1.0, 1.0)


@compiled
def _thrust_to_actuator(g: Any, thrust: float) -> float:
    """Return the actuator command for a thrust 0…1: the inverse thrust curve, from MOT_SPIN_MIN to MOT_SPIN_MAX.

    `Thrust_Linearization::thrust_to_actuator`, without the compensation of the battery's voltage, which is off by
    default.
    """
    thrust = clamp(thrust, 0.0, 1.0)
    if g.expo > 1e-6:
        thrust = math.sqrt(g.expo_a + g.expo_b * thrust) - g.expo_c
    elif g.expo < -1e-6:
        thrust = -math.sqrt(g.expo_a + g.expo_b * thrust) - g.expo_c
    command: float = g.spin_min + g.spin_range * thrust
    return command


@compiled
def _yaw_allowed(part: float, factor: float, best: float, yaw: float) -> float:
    """Return how much yaw a motor, whose yaw factor is ±½, allows on top of its part in roll and pitch."""
    # up to full thrust where yaw adds to it, else down to none; without a branch that noise would make unpredictable
    return 1.0 + math.copysign(1.0, yaw * factor) * (1.0 - 2.0 * (best + part))


@compiled
def _fit_to_range(throttle: float, average: float, low: float, high: float) -> tuple[float, float, bool]:
    """Return (offset added to every motor, scale of the demands, whether thrust was reduced)."""
    scale = 1.0
    if high - low > 1.0:
        scale = 1.0 / (high - low)
    if average + low < 0.0:
        scale = min(scale, -average / low)
    high *= scale
    low *= scale
    more = throttle + low
    full = throttle >= 1.0
    if scale < 1.0:
        full = full or more > 0.0
        more = 0.0
    elif more < 0.0:
        more = 0.0
    elif more > 1.0 + low - high:
        more = 1.0 + low - high
        full = True
    return more - low, scale, full


@compiled
def mix_motors(
    g: Any, throttle: float, average: float, roll: float, pitch: float, yaw: float
) -> tuple[bool, float, float, float, float]:
    """Return whether thrust was reduced, and the commands of four motors for a thrust 0…1 and three demands.

    Roll and pitch have priority, then some yaw, then thrust, which may be raised up to `average` for them. Positive
    roll lowers the right side, positive pitch lowers the nose, positive yaw turns left.
    """
    throttle = clamp(throttle, 0.0, 1.0)
    average = clamp(average, throttle, 1.0)
    a = roll * g.roll_factor[0] + pitch * g.pitch_factor[0]
    b = roll * g.roll_factor[1] + pitch * g.pitch_factor[1]
    c = roll * g.roll_factor[2] + pitch * g.pitch_factor[2]
    d = roll * g.roll_factor[3] + pitch * g.pitch_factor[3]
    best = min(0.5, average)
    span = 0.5 * (abs(roll) + abs(pitch) + abs(yaw))
    base = throttle
    scale = 1.0
    full = False
    near = span > min(best, throttle) or throttle + span >= 1.0  # else far from every limit: nothing is reduced
    if near:
        allowed = min(_yaw_allowed(a, g.yaw_factor[0], best, yaw), _yaw_allowed(b, g.yaw_factor[1], best, yaw))
        allowed = min(
            allowed, min(_yaw_allowed(c, g.yaw_factor[2], best, yaw), _yaw_allowed(d, g.yaw_factor[3], best, yaw))
        )
        allowed = max(min(allowed, 1.0), _YAW_HEADROOM)
        yaw = clamp(yaw, -allowed, allowed)
    a += yaw * g.yaw_factor[0]
    b += yaw * g.yaw_factor[1]
    c += yaw * g.yaw_factor[2]
    d += yaw * g.yaw_factor[3]
    if near:
        base, scale, full = _fit_to_range(throttle, average, min(min(a, b), min(c, d)), max(max(a, b), max(c, d)))
    return (
        full,
        _thrust_to_actuator(g, base + scale * a),
        _thrust_to_actuator(g, base + scale * b),
        _thrust_to_actuator(g, base + scale * c),
        _thrust_to_actuator(g, base + scale * d),
    )
