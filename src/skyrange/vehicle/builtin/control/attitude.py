"""Attitude control: shaped targets with feed-forward, and the angles and rates of an error of attitude.

After libraries/AC_AttitudeControl/AC_AttitudeControl.cpp (`input_thrust_vector_heading_rad`,
`input_thrust_vector_rate_heading_rads`, `attitude_controller_run_quat`, `update_ang_vel_target_from_att_error`).
Targets are shaped when position control runs; in between they turn at their rates. As in ArduCopter, a rotation is
split into a tilt and a turn about the thrust axis.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core import elementary, elementary_python
from skyrange.core.compiled import compiled, inlined
from skyrange.vehicle.builtin.control.gains import GRAVITY_MPS2
from skyrange.vehicle.builtin.control.shaping import clamp, sqrt_controller

_TILT_ERROR_RAD = math.radians(30.0)  # AC_ATTITUDE_THRUST_ERROR_ANGLE_RAD
TILT_NEAR2 = elementary_python.square(elementary_python.sin(0.5 * _TILT_ERROR_RAD))
"""Squared sine of half the thrust angle error up to which the target's rates are fed forward as they are."""
TILT_FAR2 = elementary_python.square(elementary_python.sin(_TILT_ERROR_RAD))
"""The same from which they are not fed forward at all."""
_SERIES_LIMIT = 1e-3  # squared sine up to which three terms of a series are exact to 1e-9
_SMALL = 0.04  # squared sine up to which series are used


@inlined
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
    return s * _double_arcsine(s2) if s2 < 0.04 else 2.0 * elementary.asin(s)


@compiled
def _angle_over_sine(s: float, c: float) -> float:
    """2·atan2(s, c) / s for the sine s ≥ 0 and cosine c of half an angle."""
    return 2.0 * elementary.atan2(s, c) / s if s > 0.0 else 2.0


@inlined
def relative_rotation(  # noqa: PLR0917
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


@inlined
def _series_of_tilt(s2: float) -> tuple[float, float]:
    """Return asin(s)/(s·√(1-s²))·2 and 1/√(1-s²) of a squared sine below 0.04, exact to 1e-9."""
    few_ratio = 2.0 + s2 * (4.0 / 3.0 + s2 * (16.0 / 15.0))
    few_scale = 1.0 + s2 * (0.5 + s2 * 0.375)
    ratio = 256.0 / 315.0 + s2 * (512.0 / 693.0 + s2 * 2048.0 / 3003.0)
    ratio = 2.0 + s2 * (4.0 / 3.0 + s2 * (16.0 / 15.0 + s2 * (32.0 / 35.0 + s2 * ratio)))
    scale = 1.0 + s2 * (0.5 + s2 * (0.375 + s2 * (0.3125 + s2 * (35.0 / 128.0 + s2 * (63.0 / 256.0)))))
    few = s2 < _SERIES_LIMIT
    return few_ratio if few else ratio, few_scale if few else scale


@inlined
def small_rotation_angles(w: float, x: float, y: float, z: float) -> tuple[float, float, float, float, bool]:
    """Return `thrust_heading_rotation_angles` of a small rotation, and whether it is small; no branch, no function."""
    s2 = x * x + y * y
    ratio, scale = _series_of_tilt(s2)
    tz = z * scale
    z2 = tz * tz
    yaw = tz * _double_arcsine(z2)
    return (x * w - y * z) * ratio, (y * w + x * z) * ratio, yaw, s2, (s2 < _SMALL) & (z2 < _SMALL) & (w > 0.0)


@compiled
def thrust_heading_rotation_angles(w: float, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return a rotation as (roll, pitch, yaw errors in rad, squared sine of half the tilt): tilt first, then turn.

    Small tilts and turns use series that are exact to 1e-9: asin(s)/(s·√(1-s²)) and 1/√(1-s²).
    """
    s2 = x * x + y * y
    if s2 < _SMALL:
        ratio, scale = _series_of_tilt(s2)
    else:
        level = math.sqrt(w * w + z * z)
        if level < 1e-9:  # upside down: every axis is equally short
            return math.pi, 0.0, 0.0, 1.0
        scale = 1.0 / level
        ratio = scale * _angle_over_sine(math.sqrt(s2), level)
    tz = z * scale
    z2 = tz * tz
    near = z2 < _SMALL and w > 0.0
    yaw = tz * (_double_arcsine(z2) if near else _angle_over_sine(abs(tz), w * scale))
    return (x * w - y * z) * ratio, (y * w + x * z) * ratio, yaw, s2


@inlined
def cos_tilt(x: float, y: float) -> float:
    """Return the cosine of the lean angle, by an attitude's x and y: the share of the thrust that points up."""
    return 1.0 - 2.0 * (x * x + y * y)


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
    q = f.guided_quat
    rate = f.guided_ang_vel
    q[0], q[1], q[2], q[3] = rotate_by_rates(q[0], q[1], q[2], q[3], rate[0], rate[1], rate[2], dt_s)
    shape_target(f, g, q[0], q[1], q[2], q[3], turning=False, yaw_rate=rate[2], dt_s=dt_s)


@compiled
def inertial_frame_reset(f: Any, yaw: float) -> None:
    """Turn the attitude target about the vertical (`inertial_frame_reset`)."""
    s = elementary.sin(0.5 * yaw)
    c = elementary.cos(0.5 * yaw)
    w = f.att_target[0]
    x = f.att_target[1]
    y = f.att_target[2]
    z = f.att_target[3]
    f.att_target[0] = c * w - s * z
    f.att_target[1] = c * x - s * y
    f.att_target[2] = c * y + s * x
    f.att_target[3] = c * z + s * w


@inlined
def input_shaping_ang_vel(rate: float, wanted: float, accel: float, dt_s: float) -> float:
    """Move a rate towards another within an angular acceleration (`input_shaping_ang_vel`)."""
    return rate + clamp(wanted - rate, -accel * dt_s, accel * dt_s)


@inlined
def thrust_attitude(acc_e: float, acc_n: float) -> tuple[float, float, float, float]:
    """Return (w, x, y) of the shortest rotation from straight up to a thrust direction, and the cosine of its angle.

    The thrust points along an acceleration, m/s² (east, north), on top of gravity.
    """
    length = math.sqrt(acc_e * acc_e + acc_n * acc_n + GRAVITY_MPS2 * GRAVITY_MPS2)
    cosine = GRAVITY_MPS2 / length
    half = math.sqrt(max(0.5 * (1.0 + cosine), 0.0))
    return half, -acc_n / length / (2.0 * half), acc_e / length / (2.0 * half), cosine


@inlined
def turn_to_heading(w: float, x: float, y: float, cosine: float, sine: float) -> tuple[float, float, float, float]:
    """Return the attitude of a tilt after a turn about the vertical, of which cosine and sine of the half are given."""
    return w * cosine, x * cosine + y * sine, y * cosine - x * sine, w * sine


@compiled
def input_thrust_vector(  # noqa: PLR0917
    f: Any,
    g: Any,
    acc_e: float,
    acc_n: float,
    turning: bool,  # noqa: FBT001
    yaw: float,
    yaw_rate: float,
    dt_s: float,
) -> None:
    """Shape the attitude target towards a thrust direction and a heading (or, with `turning`, a yaw rate alone).

    The thrust shall point along the requested acceleration, m/s² (east, north), on top of gravity.
    """
    w, x, y, f.tilt_cos = thrust_attitude(acc_e, acc_n)
    z = 0.0
    if not turning:
        w, x, y, z = turn_to_heading(w, x, y, elementary.cos(0.5 * yaw), elementary.sin(0.5 * yaw))
    shape_target(f, g, w, x, y, z, turning, yaw_rate, dt_s)


@inlined
def shape_yaw_rate(  # noqa: PLR0917
    rate: float,
    turn: float,
    p: float,
    accel: float,
    slew: float,
    turning: bool,  # noqa: FBT001
    yaw_rate: float,
    dt_s: float,
) -> float:
    """Return the yaw rate of the target towards a heading that is `turn` away, or with `turning` towards a yaw rate."""
    wanted = clamp(yaw_rate, -slew, slew) + sqrt_controller(turn, p, accel, dt_s)
    return input_shaping_ang_vel(rate, yaw_rate if turning else clamp(wanted, -slew, slew), accel, dt_s)


@compiled
def shape_target(  # noqa: PLR0917
    f: Any,
    g: Any,
    w: float,
    x: float,
    y: float,
    z: float,
    turning: bool,  # noqa: FBT001
    yaw_rate: float,
    dt_s: float,
) -> None:
    """Shape the attitude target towards an attitude; with `turning`, its heading follows the yaw rate alone."""
    ew, ex, ey, ez = relative_rotation(f.att_target[0], f.att_target[1], f.att_target[2], f.att_target[3], w, x, y, z)
    roll, pitch, turn, _ = thrust_heading_rotation_angles(ew, ex, ey, ez)
    for axis in range(2):
        accel = g.accel_max[axis]
        wanted = sqrt_controller(roll if axis == 0 else pitch, g.input_p, accel, dt_s)
        f.att_target_rate[axis] = input_shaping_ang_vel(f.att_target_rate[axis], wanted, accel, dt_s)
    f.att_target_rate[2] = shape_yaw_rate(
        f.att_target_rate[2], turn, g.input_p, g.accel_max[2], g.slew_yaw, turning, yaw_rate, dt_s
    )


@inlined
def rotate_by_rates(  # noqa: PLR0917
    qw: float, qx: float, qy: float, qz: float, rate_x: float, rate_y: float, rate_z: float, dt_s: float
) -> tuple[float, float, float, float]:
    """Return an attitude turned by body rates for one step."""
    x = 0.5 * dt_s * rate_x
    y = 0.5 * dt_s * rate_y
    z = 0.5 * dt_s * rate_z
    square = x * x + y * y + z * z
    sine = 1.0 - square * (1.0 / 6.0 - square / 120.0)
    c = 1.0 - square * (0.5 - square / 24.0)
    x *= sine
    y *= sine
    z *= sine
    w = qw * c - qx * x - qy * y - qz * z
    i = qw * x + qx * c + qy * z - qz * y
    j = qw * y - qx * z + qy * c + qz * x
    k = qw * z + qx * y - qy * x + qz * c
    scale = 1.5 - 0.5 * (w * w + i * i + j * j + k * k)  # one Newton step: only rounding errors are left
    return w * scale, i * scale, j * scale, k * scale


@inlined
def angle_to_rate(error: float, p: float, linear: float, accel: float) -> float:
    """Return the rate that corrects an angle error: linear up to `linear`, a square root beyond."""
    size = abs(error)
    root = math.sqrt(max(2.0 * accel * (size - 0.5 * linear), 0.0))
    return math.copysign(root, error) if size > linear else error * p


@compiled
def feed_forward_share(tilt: float) -> float:
    """Return how much of the target's rates is fed forward for a squared sine of half the thrust angle error, 0 … 1."""
    if tilt <= TILT_NEAR2:
        return 1.0
    return 2.0 - 2.0 * elementary.asin(math.sqrt(tilt)) / _TILT_ERROR_RAD if tilt <= TILT_FAR2 else 0.0
