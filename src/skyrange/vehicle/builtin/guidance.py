"""Where should each aircraft be right now? References by control mode, and what has been achieved.

Legs follow a jerk-limited profile in a straight line; the end of one and the start of the next are added
at a corner, as libraries/AC_WPNav/AC_WPNav.cpp does with its S-curves. Everything else is ArduPilot's input shaping
(AC_PosControl `input_pos_vel_accel`). Take-off is ArduCopter/takeoff.cpp `_AutoTakeoff::run`, landing
mode.cpp `land_run_vertical_control` and land_detector.cpp.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import kernel
from skyrange.vehicle.builtin.layout import Control, Flag
from skyrange.vehicle.builtin.shaping import (
    approach_velocity,
    clamp,
    limit_xy,
    peak_speed,
    ramp_at,
    ramp_time,
    shape_velocity,
    shape_velocity_xy,
    sqrt_controller,
    wrap_pi,
)

_ARRIVED = int(Flag.ARRIVED)
_CLIMBED = int(Flag.CLIMBED)
_LEG = int(Control.LEG)
_POSITION = int(Control.POSITION)
_VELOCITY = int(Control.VELOCITY)
_LAND = int(Control.LAND)
_TAKEOFF = int(Control.TAKEOFF)
_TURN_MIN_M = 2.0
"""Legs shorter than this over the ground turn no nose (WPNAV_YAW_DIST_MIN, AC_WPNav.h)."""
_YAW_TC_S = 0.15  # ATC_INPUT_TC's default


@kernel
def plan(leg: Any, speed: float) -> None:
    """Lay the rest of a leg out anew from where it is now, at its present speed, to rest at its end.

    Only called where the acceleration is zero: before the start, or in the cruise.
    """
    done, now_speed, _ = along(leg)
    leg.start = done
    leg.v0 = now_speed
    rest = max(leg.length - done, 0.0)
    leg.peak = peak_speed(rest, now_speed, speed, leg.accel, leg.jerk)
    leg.t_up = ramp_time(leg.v0, leg.peak, leg.accel, leg.jerk)
    leg.t_down = ramp_time(leg.peak, 0.0, leg.accel, leg.jerk)
    moved = 0.5 * (leg.v0 + leg.peak) * leg.t_up + 0.5 * leg.peak * leg.t_down
    leg.t_cruise = max(rest - moved, 0.0) / leg.peak if leg.peak > 1e-9 else 0.0
    leg.t = 0.0


@kernel
def along(leg: Any) -> tuple[float, float, float]:
    """(distance from the leg's origin, speed, acceleration) at the leg's present time."""
    t = leg.t
    if t < leg.t_up:
        moved, speed, accel = ramp_at(t, leg.v0, leg.peak, leg.accel, leg.jerk)
        return leg.start + moved, speed, accel
    start = leg.start + 0.5 * (leg.v0 + leg.peak) * leg.t_up
    t -= leg.t_up
    if t < leg.t_cruise:
        return start + leg.peak * t, leg.peak, 0.0
    start += leg.peak * leg.t_cruise
    t -= leg.t_cruise
    if t < leg.t_down:
        moved, speed, accel = ramp_at(t, leg.peak, 0.0, leg.accel, leg.jerk)
        return start + moved, speed, accel
    return leg.length, 0.0, 0.0


@kernel
def share(unit: Any, level: float, up: float, down: float) -> float:
    """The most along a direction so that neither its level nor its vertical part exceeds its own limit.

    ArduPilot's `kinematic_limit` (libraries/AP_Math/control.cpp).
    """
    flat = math.sqrt(unit[0] * unit[0] + unit[1] * unit[1])
    most = 1e9
    if flat > 1e-9:
        most = level / flat
    if unit[2] > 1e-9:
        most = min(most, up / unit[2])
    elif unit[2] < -1e-9:
        most = min(most, down / -unit[2])
    return most if most < 1e9 else level


@kernel
def leg_speed(f: Any) -> float:
    """The speed limit along the present leg, m/s."""
    return share(f.leg.unit, f.speed_xy, f.speed_up, f.speed_down)


@kernel
def begin_leg(f: Any, p: Any, east: float, north: float, up: float, fast: bool, corner: bool) -> None:
    """Start a straight leg to a point, metres, without a jump of the reference.

    At a `corner` the leg before fades out while this one starts; otherwise what speed there is, is braked
    off along its own direction. `fast` passes the end without stopping.
    """
    leg = f.leg
    tail = f.tail
    if corner:
        for axis in range(3):
            tail.unit[axis] = leg.unit[axis]
            tail.origin[axis] = leg.origin[axis]
            leg.origin[axis] = leg.origin[axis] + leg.unit[axis] * leg.length
        tail.length = leg.length
        tail.start = leg.start
        tail.v0 = leg.v0
        tail.peak = leg.peak
        tail.t_up = leg.t_up
        tail.t_cruise = leg.t_cruise
        tail.t_down = leg.t_down
        tail.t = leg.t
        tail.accel = leg.accel
        tail.jerk = leg.jerk
    else:
        speed = math.sqrt(f.ref_vel[0] ** 2 + f.ref_vel[1] ** 2 + f.ref_vel[2] ** 2)
        for axis in range(3):
            tail.unit[axis] = f.ref_vel[axis] / speed if speed > 1e-6 else 0.0
            tail.origin[axis] = f.ref_pos[axis]
        tail.accel = f.accel_xy
        tail.jerk = p.PSC_JERK_XY
        tail.start = 0.0
        tail.v0 = speed if speed > 1e-6 else 0.0
        tail.peak = tail.v0
        tail.t_up = 0.0
        tail.t_cruise = 0.0
        tail.t_down = ramp_time(tail.v0, 0.0, tail.accel, tail.jerk)
        tail.t = 0.0
        tail.length = 0.5 * tail.v0 * tail.t_down
        for axis in range(3):
            leg.origin[axis] = tail.origin[axis] + tail.unit[axis] * tail.length
    d_e = east - leg.origin[0]
    d_n = north - leg.origin[1]
    d_u = up - leg.origin[2]
    leg.length = math.sqrt(d_e * d_e + d_n * d_n + d_u * d_u)
    scale = 1.0 / leg.length if leg.length > 1e-6 else 0.0
    leg.unit[0] = d_e * scale
    leg.unit[1] = d_n * scale
    leg.unit[2] = d_u * scale
    leg.accel = share(leg.unit, f.accel_xy, f.accel_z, f.accel_z)
    leg.jerk = p.WPNAV_JERK
    leg.start = 0.0
    leg.v0 = 0.0
    leg.peak = 0.0
    leg.t_up = 0.0
    leg.t_cruise = 0.0
    leg.t_down = 0.0
    leg.t = 0.0
    full = leg.length
    leg.length = 0.0 if full <= 1e-6 else full
    # `along` of an empty plan is the end: start from the beginning instead
    leg.peak = peak_speed(leg.length, 0.0, leg_speed(f), leg.accel, leg.jerk)
    leg.t_up = ramp_time(0.0, leg.peak, leg.accel, leg.jerk)
    leg.t_down = leg.t_up
    leg.t_cruise = max(leg.length - leg.peak * leg.t_up, 0.0) / leg.peak if leg.peak > 1e-9 else 0.0
    f.target_pos[0] = east
    f.target_pos[1] = north
    f.target_pos[2] = up
    f.fast = 1 if fast else 0
    f.replan = 0
    f.control = _LEG
    f.flags &= ~_ARRIVED
    f.seen &= ~_ARRIVED
    f.radius = p.WPNAV_RADIUS * 0.01


@kernel
def face(f: Any, p: Any, east: float, north: float) -> None:
    """Turn the nose along a horizontal direction if it is long enough to mean one."""
    if east * east + north * north >= _TURN_MIN_M * _TURN_MIN_M and p.WP_YAW_BEHAVIOR > 0:
        f.target_yaw = math.atan2(north, east)


@kernel
def _pace(e: Any, f: Any, p: Any, dt_s: float) -> float:
    """How far to advance along the track in a step: less where the aircraft cannot keep up, as in strong wind.

    ArduPilot's `_track_dt_scalar` (AC_WPNav::advance_wp_target_along_track): with a margin of 5 %, and a
    time constant of acceleration over jerk. Speed and acceleration of the reference are not scaled.
    """
    wanted = 1.0
    speed = math.sqrt(f.ref_vel[0] ** 2 + f.ref_vel[1] ** 2 + f.ref_vel[2] ** 2)
    if speed > 0.0:
        ahead_m = 0.0
        made_mps = 0.0
        for axis in range(3):
            ahead_m += (f.ref_pos[axis] - e.pos[axis]) * f.ref_vel[axis] / speed
            made_mps += e.vel[axis] * f.ref_vel[axis] / speed
        wanted = clamp(0.05 + (made_mps - p.PSC_POSXY_P * ahead_m) / speed, 0.0, 1.0)
    f.track_lag += (1.0 - wanted - f.track_lag) * min(1.0, dt_s * p.WPNAV_JERK / f.accel_xy)
    scaled: float = dt_s * (1.0 - f.track_lag)
    return scaled


@kernel
def _follow_leg(e: Any, f: Any, p: Any, dt_s: float) -> None:
    """Advance leg and fading tail; raise ARRIVED once."""
    leg = f.leg
    tail = f.tail
    total = leg.t_up + leg.t_cruise + leg.t_down
    if f.replan == 1:
        if leg.t >= total:
            f.replan = 0
        elif leg.t_up <= leg.t <= leg.t_up + leg.t_cruise:
            plan(leg, leg_speed(f))
            total = leg.t_up + leg.t_cruise + leg.t_down
            f.replan = 0
    step_s = _pace(e, f, p, dt_s)
    leg.t = min(leg.t + step_s, total)
    tail.t = min(tail.t + step_s, tail.t_up + tail.t_cruise + tail.t_down)
    s, v, a = along(leg)
    tail_s, tail_v, tail_a = along(tail)
    left = tail.length - tail_s
    for axis in range(3):
        f.ref_pos[axis] = leg.origin[axis] + leg.unit[axis] * s - tail.unit[axis] * left
        f.ref_vel[axis] = leg.unit[axis] * v + tail.unit[axis] * tail_v
        f.ref_acc[axis] = leg.unit[axis] * a + tail.unit[axis] * tail_a
    if f.flags & _ARRIVED or tail.t < tail.t_up + tail.t_cruise + tail.t_down:
        return
    if f.fast == 1:
        if leg.t >= leg.t_up + leg.t_cruise and leg.length - s <= min(f.radius, 0.5 * leg.length):
            f.flags |= _ARRIVED
    elif leg.t >= total:
        d_e = f.target_pos[0] - e.pos[0]
        d_n = f.target_pos[1] - e.pos[1]
        d_u = f.target_pos[2] - e.pos[2]
        if d_e * d_e + d_n * d_n + d_u * d_u <= f.radius * f.radius:
            f.flags |= _ARRIVED


@kernel
def _move_level(f: Any, p: Any, want_e: float, want_n: float, dt_s: float) -> None:
    """Shape the reference's horizontal velocity towards a wanted one and move with it."""
    f.ref_acc[0], f.ref_acc[1] = shape_velocity_xy(
        want_e,
        want_n,
        f.ref_vel[0],
        f.ref_vel[1],
        f.ref_acc[0],
        f.ref_acc[1],
        f.accel_xy,
        p.PSC_JERK_XY,
        dt_s,
    )
    for axis in range(2):
        f.ref_pos[axis] += f.ref_vel[axis] * dt_s
        f.ref_vel[axis] += f.ref_acc[axis] * dt_s


@kernel
def _move_up(f: Any, p: Any, want: float, dt_s: float) -> None:
    """The same for height; a reference does not run away below a motor that gives no less thrust already."""
    f.ref_acc[2] = shape_velocity(want, f.ref_vel[2], f.ref_acc[2], f.accel_z, p.PSC_JERK_Z, dt_s)
    if not (f.throttle <= 0.0 and f.ref_vel[2] < 0.0):
        f.ref_pos[2] += f.ref_vel[2] * dt_s
    f.ref_vel[2] += f.ref_acc[2] * dt_s


@kernel
def _climb_to(f: Any, p: Any, up: float, dt_s: float) -> None:
    """Shape the reference's height towards `up`."""
    want = approach_velocity(up - f.ref_pos[2], f.accel_z, p.PSC_JERK_Z, dt_s)
    _move_up(f, p, clamp(want, -f.speed_down, f.speed_up), dt_s)


@kernel
def _land_rate(e: Any, f: Any, p: Any, dt_s: float) -> float:
    """How fast to descend here, m/s (negative): quick down to LAND_ALT_LOW, then LAND_SPEED."""
    slow = p.LAND_SPEED * 0.01
    quick = p.LAND_SPEED_HIGH * 0.01 if p.LAND_SPEED_HIGH > 0.0 else f.speed_down
    rate = sqrt_controller(p.LAND_ALT_LOW * 0.01 - e.height, p.PSC_POSZ_P, f.accel_z, dt_s)
    return clamp(rate, -max(quick, slow), -slow)


@kernel
def _drift(e: Any, f: Any) -> None:
    """Without a position to hold, the reference goes where the aircraft is believed to go."""
    for axis in range(2):
        f.ref_pos[axis] = e.pos[axis]
        f.ref_vel[axis] = e.vel[axis]
        f.ref_acc[axis] = 0.0


@kernel
def guide(e: Any, f: Any, p: Any, dt_s: float) -> None:
    """Move the reference of one flying aircraft by one step, according to its control."""
    control = f.control
    if control == _LEG:
        _follow_leg(e, f, p, dt_s)
    elif control == _POSITION:
        for axis in range(3):
            f.target_pos[axis] += f.target_vel[axis] * dt_s
        d_e = f.target_pos[0] - f.ref_pos[0]
        d_n = f.target_pos[1] - f.ref_pos[1]
        away = math.sqrt(d_e * d_e + d_n * d_n)
        speed = min(approach_velocity(away, f.accel_xy, p.PSC_JERK_XY, dt_s), f.speed_xy)
        scale = speed / away if away > 1e-9 else 0.0
        want_e, want_n = limit_xy(d_e * scale + f.target_vel[0], d_n * scale + f.target_vel[1], f.speed_xy)
        _move_level(f, p, want_e, want_n, dt_s)
        want = approach_velocity(f.target_pos[2] - f.ref_pos[2], f.accel_z, p.PSC_JERK_Z, dt_s) + f.target_vel[2]
        _move_up(f, p, clamp(want, -f.speed_down, f.speed_up), dt_s)
    elif control == _VELOCITY:
        want_e, want_n = limit_xy(f.target_vel[0], f.target_vel[1], f.speed_xy)
        _move_level(f, p, want_e, want_n, dt_s)
        _move_up(f, p, clamp(f.target_vel[2], -f.speed_down, f.speed_up), dt_s)
    elif control == _LAND:
        if f.blind == 1:
            _drift(e, f)
        else:
            _move_level(f, p, 0.0, 0.0, dt_s)
        f.pause_s = max(f.pause_s - dt_s, 0.0)
        _move_up(f, p, 0.0 if f.pause_s > 0.0 else _land_rate(e, f, p, dt_s), dt_s)
    elif control == _TAKEOFF:
        _move_level(f, p, 0.0, 0.0, dt_s)
        _climb_to(f, p, f.target_pos[2], dt_s)
        # within 1 % of the stopping distance and below 10 % of the climb rate (takeoff.cpp)
        slow = 0.1 * f.speed_up
        if f.ref_pos[2] >= f.target_pos[2] - 0.5 * slow * slow / f.accel_z and f.ref_vel[2] < slow:
            f.flags |= _CLIMBED
    _turn(f, p, dt_s)


@kernel
def _turn(f: Any, p: Any, dt_s: float) -> None:
    """Shape the reference's yaw towards its target within rate and acceleration limits."""
    accel = p.ATC_ACCEL_Y_MAX * math.pi / 18_000.0
    most = p.ATC_SLEW_YAW * math.pi / 18_000.0
    error = wrap_pi(f.target_yaw - f.ref_yaw)
    want = clamp(sqrt_controller(error, 1.0 / _YAW_TC_S, 0.5 * accel, dt_s), -most, most)
    f.ref_yaw_rate += clamp(want - f.ref_yaw_rate, -accel * dt_s, accel * dt_s)
    f.ref_yaw = wrap_pi(f.ref_yaw + f.ref_yaw_rate * dt_s)
