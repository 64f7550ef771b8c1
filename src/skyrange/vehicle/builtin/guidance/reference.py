"""Reference of position control: how it moves in each control mode, and the events that this raises.

Legs are in `guidance.wpnav`, sticks in `pilot`. The rest is ArduPilot's input shaping (AC_PosControl
`input_pos_NEU_m`, `input_vel_accel_NE_m`, `input_pos_vel_accel_NE_m`, `input_accel_NE_m`). Take-off is
ArduCopter/takeoff.cpp `_AutoTakeoff::run`, landing mode.cpp `land_run_vertical_control`, the circle
libraries/AC_WPNav/AC_Circle.cpp.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin import pilot
from skyrange.vehicle.builtin.control.shaping import (
    approach_velocity,
    clamp,
    limit_xy,
    shape_vel_accel,
    shape_vel_accel_xy,
    sqrt_controller,
    wrap_pi,
)
from skyrange.vehicle.builtin.guidance import wpnav
from skyrange.vehicle.builtin.guidance.scurve import kinematic_limit
from skyrange.vehicle.builtin.layout import ControlMode, FlightEvent

_TAKEOFF_COMPLETE = int(FlightEvent.TAKEOFF_COMPLETE)
_ALTITUDE_REACHED = int(FlightEvent.ALTITUDE_REACHED)
_LEG = int(ControlMode.LEG)
_POSITION = int(ControlMode.POSITION)
_VELOCITY = int(ControlMode.VELOCITY)
_LAND = int(ControlMode.LAND)
_TAKEOFF = int(ControlMode.TAKEOFF)
_POS_VEL_ACCEL = int(ControlMode.POS_VEL_ACCEL)
_ACCEL = int(ControlMode.ACCEL)
_CIRCLE = int(ControlMode.CIRCLE)
_LOITER_TO_ALT = int(ControlMode.LOITER_TO_ALT)
_ATTITUDE = int(ControlMode.ATTITUDE)
_ALT_HOLD = int(ControlMode.ALT_HOLD)
_LOITER = int(ControlMode.LOITER)
_LEVEL_CM = 5  # loiter_to_alt_run
_TURN_ACCEL_MIN = math.radians(2.0)  # AC_CIRCLE_ANGULAR_ACCEL_MIN


@compiled
def _update_pos_vel_accel_ne(e: Any, f: Any, dt_s: float) -> None:
    """Move the reference horizontally, but not farther away at the lean limit (`update_pos_vel_accel_xy`)."""
    d_e = f.ref_vel[0] * dt_s + 0.5 * f.ref_acc[0] * dt_s * dt_s
    d_n = f.ref_vel[1] * dt_s + 0.5 * f.ref_acc[1] * dt_s * dt_s
    limited = f.limited_accel[0] != 0.0 or f.limited_accel[1] != 0.0
    if not (
        limited
        and d_e * f.limited_accel[0] + d_n * f.limited_accel[1] > 0.0
        and f.pos_err[0] * f.limited_accel[0] + f.pos_err[1] * f.limited_accel[1] > 0.0
    ):
        f.ref_pos[0] += d_e
        f.ref_pos[1] += d_n
    if not (
        limited
        and f.ref_acc[0] * f.limited_accel[0] + f.ref_acc[1] * f.limited_accel[1] > 0.0
        and f.vel_err[0] * f.limited_accel[0] + f.vel_err[1] * f.limited_accel[1] > 0.0
        and f.ref_vel[0] * f.limited_accel[0] + f.ref_vel[1] * f.limited_accel[1] >= 0.0
    ):
        f.ref_vel[0] += f.ref_acc[0] * dt_s
        f.ref_vel[1] += f.ref_acc[1] * dt_s


@compiled
def _update_pos_vel_accel_u(e: Any, f: Any, dt_s: float) -> None:
    """Move the reference vertically, but not farther away at the limits of thrust (`update_pos_vel_accel`)."""
    limit = 1.0 if f.throttle_limited == 1 else (-1.0 if f.throttle <= 0.0 else 0.0)
    d_u = f.ref_vel[2] * dt_s + 0.5 * f.ref_acc[2] * dt_s * dt_s
    if not (d_u * limit > 0.0 and (f.ref_pos[2] - e.pos[2]) * limit > 0.0):
        f.ref_pos[2] += d_u
    d_v = f.ref_acc[2] * dt_s
    if d_v * limit > 0.0 and f.climb_err * limit > 0.0:
        d_v = clamp(d_v, -abs(f.ref_vel[2]), abs(f.ref_vel[2])) if f.ref_vel[2] * limit < 0.0 else 0.0
    f.ref_vel[2] += d_v


@compiled
def _input_vel_accel_ne(  # noqa: PLR0917
    e: Any, f: Any, p: Any, want_e: float, want_n: float, acc_e: float, acc_n: float, dt_s: float
) -> None:
    """Shape the reference's horizontal velocity towards a target (`input_vel_accel_NE_m`)."""
    _update_pos_vel_accel_ne(e, f, dt_s)
    f.ref_acc[0], f.ref_acc[1] = shape_vel_accel_xy(
        want_e, want_n, acc_e, acc_n, f.ref_vel[0], f.ref_vel[1], f.ref_acc[0], f.ref_acc[1],
        f.accel_xy, p.PSC_JERK_XY, dt_s,
    )  # fmt: skip


@compiled
def _input_vel_accel_u(e: Any, f: Any, p: Any, want: float, acc: float, dt_s: float) -> None:
    """Shape the reference's vertical velocity towards a target (`input_vel_accel_U_m`)."""
    _update_pos_vel_accel_u(e, f, dt_s)
    f.ref_acc[2] = shape_vel_accel(want, acc, f.ref_vel[2], f.ref_acc[2], f.accel_z, p.PSC_JERK_Z, dt_s)


@compiled
def _input_pos_vel_accel_ne(e: Any, f: Any, p: Any, dt_s: float) -> None:
    """Shape the reference's horizontal position towards the target's (`input_pos_vel_accel_NE_m`)."""
    d_e = f.target_pos[0] - f.ref_pos[0]
    d_n = f.target_pos[1] - f.ref_pos[1]
    away = math.sqrt(d_e * d_e + d_n * d_n)
    speed = min(approach_velocity(away, f.accel_xy, p.PSC_JERK_XY, dt_s), f.speed_xy)
    scale = speed / away if away > 1e-9 else 0.0
    _input_vel_accel_ne(
        e, f, p, d_e * scale + f.target_vel[0], d_n * scale + f.target_vel[1],
        f.target_acc[0], f.target_acc[1], dt_s,
    )  # fmt: skip


@compiled
def _input_pos_vel_accel_u(e: Any, f: Any, p: Any, dt_s: float) -> None:
    """Shape the reference's height towards the target's (`input_pos_vel_accel_U_m`)."""
    want = approach_velocity(f.target_pos[2] - f.ref_pos[2], f.accel_z, p.PSC_JERK_Z, dt_s)
    _input_vel_accel_u(e, f, p, clamp(want, -f.speed_down, f.speed_up) + f.target_vel[2], f.target_acc[2], dt_s)


@compiled
def _input_pos_neu(e: Any, f: Any, p: Any, dt_s: float) -> None:
    """Shape the reference towards a fixed position, on a straight line (`input_pos_NEU_m`)."""
    d_e = f.target_pos[0] - f.ref_pos[0]
    d_n = f.target_pos[1] - f.ref_pos[1]
    d_u = f.target_pos[2] - f.ref_pos[2]
    most = kinematic_limit(d_e, d_n, d_u, f.speed_xy, f.speed_up, f.speed_down)
    flat = math.sqrt(d_e * d_e + d_n * d_n)
    far = math.sqrt(flat * flat + d_u * d_u)
    per = most / far if far > 1e-9 else 0.0
    speed = min(approach_velocity(flat, f.accel_xy, p.PSC_JERK_XY, dt_s), flat * per)
    scale = speed / flat if flat > 1e-9 else 0.0
    _input_vel_accel_ne(e, f, p, d_e * scale, d_n * scale, 0.0, 0.0, dt_s)
    climb = approach_velocity(d_u, f.accel_z, p.PSC_JERK_Z, dt_s)
    _input_vel_accel_u(e, f, p, clamp(climb, -abs(d_u) * per, abs(d_u) * per), 0.0, dt_s)


@compiled
def _land_descent_rate(e: Any, f: Any, p: Any, dt_s: float) -> float:
    """Return the climb rate of a landing, m/s (negative): fast down to LAND_ALT_LOW, then LAND_SPEED."""
    slow = p.LAND_SPEED * 0.01
    quick = p.LAND_SPEED_HIGH * 0.01 if p.LAND_SPEED_HIGH > 0.0 else f.speed_down
    rate = sqrt_controller(p.LAND_ALT_LOW * 0.01 - (e.height - f.land_datum), p.PSC_POSZ_P, f.accel_z, dt_s)
    return clamp(rate, -max(quick, slow), -slow)


@compiled
def _update_circle(e: Any, f: Any, p: Any, dt_s: float) -> None:
    """Move the target around the circle (AC_Circle::update_cms), no faster than half the acceleration allows."""
    radius = f.circle_radius
    if radius > 0.0:
        fast = min(f.speed_xy, math.sqrt(0.5 * f.accel_xy * radius)) / radius
        most = clamp(f.circle_rate, -fast, fast)
        accel = max(f.accel_xy / radius, _TURN_ACCEL_MIN)
    else:
        most = f.circle_rate
        accel = max(abs(most), _TURN_ACCEL_MIN)
    f.circle_ang_vel += clamp(most - f.circle_ang_vel, -accel * dt_s, accel * dt_s)
    f.circle_angle = wrap_pi(f.circle_angle - f.circle_ang_vel * dt_s)
    f.circle_angle_total += f.circle_ang_vel * dt_s
    f.target_pos[0] = f.centre[0] + radius * elementary.cos(f.circle_angle)
    f.target_pos[1] = f.centre[1] + radius * elementary.sin(f.circle_angle)
    _input_pos_vel_accel_ne(e, f, p, dt_s)
    _input_vel_accel_u(e, f, p, 0.0, 0.0, dt_s)


@compiled
def _loiter_to_alt(e: Any, f: Any, p: Any, dt_s: float) -> None:
    """Hold the position and go to the height of the target; raise ALTITUDE_REACHED there (loiter_to_alt_run)."""
    error_cm = int(e.pos[2] * 100.0) - round(f.target_pos[2] * 100.0)  # current_loc.alt is in whole centimetres
    error = 0.01 * error_cm
    _input_vel_accel_ne(e, f, p, 0.0, 0.0, 0.0, 0.0, dt_s)
    want = sqrt_controller(-error, p.PSC_POSZ_P, f.accel_z, dt_s)
    _input_vel_accel_u(e, f, p, clamp(want, -f.speed_down, f.speed_up), 0.0, dt_s)
    if abs(error_cm) < _LEVEL_CM or error * f.target_vel[2] < 0.0:
        f.flags |= _ALTITUDE_REACHED
    f.target_vel[2] = error  # only its sign is used, in the next step


@compiled
def _follow_estimate(e: Any, f: Any) -> None:
    """Let the reference follow the estimate where there is no position to hold."""
    for axis in range(2):
        f.ref_pos[axis] = e.pos[axis]
        f.ref_vel[axis] = e.vel[axis]
        f.ref_acc[axis] = 0.0


@compiled
def update_reference(e: Any, f: Any, w: Any, p: Any, dt_s: float) -> None:
    """Move the reference of one flying aircraft by one step, according to its control mode."""
    control = f.control
    if control == _LEG:
        wpnav.advance_along_track(e, f, w, p, dt_s)
    elif control == _POSITION:
        _input_pos_neu(e, f, p, dt_s)
    elif control == _VELOCITY:
        _input_vel_accel_ne(e, f, p, f.target_vel[0], f.target_vel[1], f.target_acc[0], f.target_acc[1], dt_s)
        _input_vel_accel_u(e, f, p, f.target_vel[2], f.target_acc[2], dt_s)
        for axis in range(3):
            f.target_vel[axis] += f.target_acc[axis] * dt_s
    elif control == _POS_VEL_ACCEL:
        _input_pos_vel_accel_ne(e, f, p, dt_s)
        _input_pos_vel_accel_u(e, f, p, dt_s)
        for axis in range(3):
            f.target_pos[axis] += f.target_vel[axis] * dt_s
            f.target_vel[axis] += f.target_acc[axis] * dt_s
    elif control == _ACCEL:
        _update_pos_vel_accel_ne(e, f, dt_s)
        step_e, step_n = limit_xy(f.target_acc[0] - f.ref_acc[0], f.target_acc[1] - f.ref_acc[1], p.PSC_JERK_XY * dt_s)
        f.ref_acc[0] += step_e
        f.ref_acc[1] += step_n
        _update_pos_vel_accel_u(e, f, dt_s)
        f.ref_acc[2] += clamp(f.target_acc[2] - f.ref_acc[2], -p.PSC_JERK_Z * dt_s, p.PSC_JERK_Z * dt_s)
    elif control == _LAND:
        if f.land_nogps == 1:
            _follow_estimate(e, f)
        else:
            _input_vel_accel_ne(e, f, p, 0.0, 0.0, 0.0, 0.0, dt_s)
        f.land_delay_s = max(f.land_delay_s - dt_s, 0.0)
        _input_vel_accel_u(e, f, p, 0.0 if f.land_delay_s > 0.0 else _land_descent_rate(e, f, p, dt_s), 0.0, dt_s)
    elif control == _TAKEOFF:
        _input_vel_accel_ne(e, f, p, 0.0, 0.0, 0.0, 0.0, dt_s)
        want = approach_velocity(f.target_pos[2] - f.ref_pos[2], f.accel_z, p.PSC_JERK_Z, dt_s)
        _input_vel_accel_u(e, f, p, clamp(want, -f.speed_down, f.speed_up), 0.0, dt_s)
        # within 1 % of the stopping distance and below 10 % of the climb rate (takeoff.cpp)
        slow = 0.1 * f.speed_up
        if f.ref_pos[2] >= f.target_pos[2] - 0.5 * slow * slow / f.accel_z and f.ref_vel[2] < slow:
            f.flags |= _TAKEOFF_COMPLETE
    elif control == _CIRCLE:
        _update_circle(e, f, p, dt_s)
    elif control == _LOITER_TO_ALT:
        _loiter_to_alt(e, f, p, dt_s)
    elif control == _LOITER:
        pilot.update_loiter(e, f, p, dt_s)
        _input_vel_accel_u(e, f, p, pilot.desired_climb_rate(f, p), 0.0, dt_s)
    elif control == _ALT_HOLD:
        _input_vel_accel_u(e, f, p, pilot.desired_climb_rate(f, p), 0.0, dt_s)
    elif control == _ATTITUDE:
        _input_vel_accel_u(e, f, p, f.guided_climb_rate, 0.0, dt_s)
