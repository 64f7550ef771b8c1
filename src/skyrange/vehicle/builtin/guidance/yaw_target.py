"""Yaw target: the angle and rate that each yaw mode requests, step by step.

After ArduCopter/autoyaw.cpp (`yaw_rad`, `rate_rads`, `set_fixed_yaw_rad`) and AC_PosControl.cpp
`calculate_yaw_and_rate_yaw`. Angles counter-clockwise from east.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.control.shaping import wrap_pi
from skyrange.vehicle.builtin.layout import AutoYawMode, Records

_HOLD = int(AutoYawMode.HOLD)
_LOOK_AT_NEXT_WP = int(AutoYawMode.LOOK_AT_NEXT_WP)
_ROI = int(AutoYawMode.ROI)
_FIXED = int(AutoYawMode.FIXED)
_LOOK_AHEAD = int(AutoYawMode.LOOK_AHEAD)
_ANGLE_RATE = int(AutoYawMode.ANGLE_RATE)
_RATE = int(AutoYawMode.RATE)
_CIRCLE = int(AutoYawMode.CIRCLE)
_LOOK_AHEAD_MPS = 1.0  # YAW_LOOK_AHEAD_MIN_SPEED
_MIN_SPEED_SHARE = 0.05  # of the speed limit: calculate_yaw_and_rate_yaw
FLT_EPSILON: Final = 2.0**-23
"""A smaller rest of a turn is none (`is_zero` of AP_Math.h), and has no sign (`is_positive`, `is_negative`)."""


@compiled
def yaw_of_quat(w: float, x: float, y: float, z: float) -> float:
    """Return the yaw of an attitude quaternion."""
    return elementary.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@compiled
def _attitude_target_yaw(f: Any) -> float:
    yaw: float = yaw_of_quat(f.att_target[0], f.att_target[1], f.att_target[2], f.att_target[3])
    return yaw


@compiled
def _look_along_track(f: Any) -> float:
    """Set the target to the direction of the reference's velocity; return how fast that turns.

    HOLD does so too, and turns to it if FIXED continues a turn after it (the default branch of `yaw_rad`). A reference
    that is too slow leaves the yaw of the attitude target. While that leans sideways, this is not the heading that it
    is shaped from, so it keeps turning until it is.
    """
    vel_e = f.ref_vel[0]
    vel_n = f.ref_vel[1]
    square = vel_e * vel_e + vel_n * vel_n
    least = _MIN_SPEED_SHARE * f.speed_xy
    if square > least * least and square > 0.0:
        f.target_yaw = elementary.atan2(vel_n, vel_e)
        rate: float = (f.ref_acc[1] * vel_e - f.ref_acc[0] * vel_n) / square
        return rate
    f.target_yaw = _attitude_target_yaw(f)
    return 0.0


@compiled
def request_track_yaw(flight: Records, row: int) -> None:
    """Set the target of one row as a pass of HOLD or LOOK_AT_NEXT_WP does."""
    _look_along_track(flight[row])


@compiled
def update_yaw_target(e: Any, f: Any, dt_s: float) -> tuple[bool, float, float]:
    """Return (whether only a rate is requested, yaw, yaw rate) of this step, rad and rad/s."""
    kind = f.auto_yaw_mode
    if kind == _RATE:
        f.target_yaw = _attitude_target_yaw(f)
        return True, 0.0, f.target_yaw_rate
    if kind in (_HOLD, _LOOK_AT_NEXT_WP):
        rate = _look_along_track(f)
        return (True, 0.0, 0.0) if kind == _HOLD else (False, f.target_yaw, rate)
    if kind == _ROI:
        f.target_yaw = _yaw_towards(f, e, f.roi[0], f.roi[1])
    elif kind == _FIXED:
        _turn_fixed_yaw(f, dt_s)
        return False, wrap_pi(f.target_yaw), 0.0
    elif kind == _LOOK_AHEAD:
        if e.vel[0] * e.vel[0] + e.vel[1] * e.vel[1] > _LOOK_AHEAD_MPS * _LOOK_AHEAD_MPS:
            f.target_yaw = elementary.atan2(e.vel[1], e.vel[0])
    elif kind == _ANGLE_RATE:
        f.target_yaw = wrap_pi(f.target_yaw + f.target_yaw_rate * dt_s)
        return False, f.target_yaw, f.target_yaw_rate
    elif kind == _CIRCLE and f.circle_radius > 0.0:
        f.target_yaw = elementary.atan2(f.centre[1] - f.ref_pos[1], f.centre[0] - f.ref_pos[0])
    elif kind == _CIRCLE:
        f.target_yaw = f.circle_angle
    return False, f.target_yaw, 0.0


@compiled
def _turn_fixed_yaw(f: Any, dt_s: float) -> None:
    """One step of a fixed turn, in single precision and without wrapping, as ArduCopter computes it.

    So a heading that was turned to differs from the one requested by the residue that it has there. A command to turn
    there again, with a direction, turns a whole circle or not by the sign of that residue.
    """
    most = np.float32(np.float32(dt_s) * np.float32(f.fixed_yaw_slewrate))
    left = np.float32(-f.fixed_yaw_offset)  # clockwise
    step = min(max(left, -most), most)
    yaw = np.float32(0.5 * math.pi - f.target_yaw)
    f.fixed_yaw_offset = -float(np.float32(left - step))
    f.target_yaw = 0.5 * math.pi - float(np.float32(yaw + step))


@compiled
def _yaw_towards(f: Any, e: Any, east: float, north: float) -> float:
    d_e = east - e.pos[0]
    d_n = north - e.pos[1]
    if d_e * d_e + d_n * d_n < 1e-6:
        kept: float = f.target_yaw
        return kept
    return elementary.atan2(d_n, d_e)


@compiled
def set_fixed_yaw_target(  # noqa: PLR0917
    estimate: Records, flight: Records, settings: Records, row: int,
    angle: float, rate: float, direction: int, relative: bool,  # noqa: FBT001
) -> None:  # fmt: skip
    """Set a fixed turn (`set_fixed_yaw_rad`): to an angle, or by one if `relative`; rad, clockwise from north.

    `direction` 1 turns clockwise, -1 counter-clockwise, 0 the shorter way; `rate` 0 is the maximum rate. The turn to an
    angle is a difference in single precision; if it is less than `FLT_EPSILON`, it has no direction.
    """
    f: Any = flight[row]
    p: Any = settings[row]
    if relative:
        if f.auto_yaw_mode == _HOLD:
            f.target_yaw = estimate[row].yaw
        left = angle if direction >= 0 else -angle
    else:
        yaw = np.float32(0.5 * math.pi - f.target_yaw)
        left = float(np.float32(wrap_pi(float(np.float32(np.float32(angle) - yaw)))))
        if direction < 0 and left >= FLT_EPSILON:
            left -= 2.0 * math.pi
        elif direction > 0 and left <= -FLT_EPSILON:
            left += 2.0 * math.pi
    most = p.ATC_SLEW_YAW * math.pi / 18_000.0
    f.fixed_yaw_offset = -left
    f.fixed_yaw_slewrate = min(rate, most) if rate > 0.0 else most
    f.auto_yaw_mode = _FIXED


@compiled
def reached_fixed_yaw_target(estimate: Records, flight: Records, row: int) -> bool:
    """Whether a fixed turn is complete, to 2° (`reached_fixed_yaw_target`)."""
    f: Any = flight[row]
    if f.auto_yaw_mode != _FIXED:
        return True
    return abs(f.fixed_yaw_offset) < FLT_EPSILON and abs(wrap_pi(f.target_yaw - estimate[row].yaw)) <= math.radians(2.0)
