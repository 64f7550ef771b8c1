"""Spline legs: motion along a cubic curve between two points, at a speed that its curvature allows.

After libraries/AP_Math/SplineCurve.cpp: a Hermite cubic; at most half the acceleration limit is used along the curve
for changes of speed, and half across it for turning.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.guidance.scurve import kinematic_limit

STILL_MPS = 3.45e-6
"""A slower reference is at rest: `is_positive` of the squared speed in cm/s compares with FLT_EPSILON.

A rounding error of a speed must not start a curve that departs at rest: its first step would be so short that the
second, at nearly no speed along the curve, would lead beyond its end."""
_SPLINE_FACTOR = 4.0  # SPLINE_FACTOR
_TANGENTIAL_ACCEL_SCALER = 0.5  # TANGENTIAL_ACCEL_SCALER
_LATERAL_ACCEL_SCALER = 0.5  # LATERAL_ACCEL_SCALER


@compiled
def set_origin_and_destination(  # noqa: PLR0917
    c: Any, f: Any, oe: float, on: float, ou: float, de: float, dn: float, du: float,
    ve: float, vn: float, vu: float, we: float, wn: float, wu: float,
) -> None:  # fmt: skip
    """Compute a curve from o, departing along v, to d, arriving along w (metres; `set_origin_and_destination`)."""
    c.goal[0], c.goal[1], c.goal[2] = de, dn, du
    c.t = 0.0
    c.reached = 0
    apart = math.sqrt((de - oe) ** 2 + (dn - on) ** 2 + (du - ou) ** 2)
    if apart < 1e-6:
        c.t = 1.0
        c.reached = 1
        c.from_speed = 0.0
        c.to_speed = 0.0
        c.leave[0], c.leave[1], c.leave[2] = 0.0, 0.0, 0.0
        _update_solution(c, oe, on, ou, de, dn, du, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return
    c.leave[0], c.leave[1], c.leave[2] = we, wn, wu
    long = math.sqrt(ve * ve + vn * vn + vu * vu) + math.sqrt(we * we + wn * wn + wu * wu)
    k = min(1.0, apart * _SPLINE_FACTOR / long) if long > 0.0 else 1.0
    _update_solution(c, oe, on, ou, de, dn, du, ve * k, vn * k, vu * k, we * k, wn * k, wu * k)
    # ArduPilot computes this with the end speed of the curve that the object held before
    _, _, _, _, c.from_speed, _ = calc_dt_speed_max(c, f, 0.0, 0.0)
    c.to_speed = 0.0
    if we != 0.0 or wn != 0.0 or wu != 0.0:
        _, _, _, _, c.to_speed, _ = _calc_limits(c, f, 1.0, 0.0)


@compiled
def _update_solution(  # noqa: PLR0917
    c: Any, oe: float, on: float, ou: float, de: float, dn: float, du: float,
    ve: float, vn: float, vu: float, we: float, wn: float, wu: float,
) -> None:  # fmt: skip
    o = (oe, on, ou)
    d = (de, dn, du)
    v = (ve, vn, vu)
    w = (we, wn, wu)
    for axis in range(3):
        c.terms[0, axis] = o[axis]
        c.terms[1, axis] = v[axis]
        c.terms[2, axis] = 3.0 * (d[axis] - o[axis]) - 2.0 * v[axis] - w[axis]
        c.terms[3, axis] = 2.0 * (o[axis] - d[axis]) + v[axis] + w[axis]


@compiled
def position_at(c: Any, t: float, axis: int) -> float:
    """Return the curve's coordinate at its time 0…1, m."""
    at: float = c.terms[0, axis] + t * (c.terms[1, axis] + t * (c.terms[2, axis] + t * c.terms[3, axis]))
    return at


@compiled
def _calc_limits(c: Any, f: Any, t: float, ahead_m: float) -> tuple[float, float, float, float, float, float]:
    """Return (time for `ahead_m`, direction, maximum speed, maximum acceleration along it) at a time of the curve."""
    ve = c.terms[1, 0] + t * (2.0 * c.terms[2, 0] + 3.0 * t * c.terms[3, 0])
    vn = c.terms[1, 1] + t * (2.0 * c.terms[2, 1] + 3.0 * t * c.terms[3, 1])
    vu = c.terms[1, 2] + t * (2.0 * c.terms[2, 2] + 3.0 * t * c.terms[3, 2])
    ae = 2.0 * c.terms[2, 0] + 6.0 * t * c.terms[3, 0]
    an = 2.0 * c.terms[2, 1] + 6.0 * t * c.terms[3, 1]
    au = 2.0 * c.terms[2, 2] + 6.0 * t * c.terms[3, 2]
    speed = math.sqrt(ve * ve + vn * vn + vu * vu)
    accel = math.sqrt(ae * ae + an * an + au * au)
    if speed > 1e-9:
        e, n, u = ve / speed, vn / speed, vu / speed
        dt = ahead_m / speed
    elif accel > 1e-9:
        e, n, u = ae / accel, an / accel, au / accel
        dt = math.sqrt(2.0 * ahead_m / accel)
    else:
        je, jn, ju = c.terms[3, 0], c.terms[3, 1], c.terms[3, 2]
        jerk = 6.0 * math.sqrt(je * je + jn * jn + ju * ju)
        if jerk <= 1e-9:
            return 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
        e, n, u = 6.0 * je / jerk, 6.0 * jn / jerk, 6.0 * ju / jerk
        dt = elementary.power(6.0 * ahead_m / jerk, 1.0 / 3.0)
    along = ae * e + an * n + au * u
    ce, cn, cu = ae - e * along, an - n * along, au - u * along
    across = math.sqrt(ce * ce + cn * cn + cu * cu)
    fastest = kinematic_limit(e, n, u, f.speed_xy, f.speed_up, f.speed_down)
    turn_most = _LATERAL_ACCEL_SCALER * kinematic_limit(ce, cn, cu, f.accel_xy, f.accel_z, f.accel_z)
    if turn_most > 0.0 and across > 1e-9 and speed > 1e-9 and across / turn_most > (speed / fastest) ** 2:
        fastest = speed / math.sqrt(across / turn_most)
    return dt, e, n, u, fastest, _TANGENTIAL_ACCEL_SCALER * kinematic_limit(e, n, u, f.accel_xy, f.accel_z, f.accel_z)


@compiled
def calc_dt_speed_max(c: Any, f: Any, t: float, ahead_m: float) -> tuple[float, float, float, float, float, float]:
    """Return the limits at a time of the curve, with a speed low enough to brake to its end (`calc_dt_speed_max`)."""
    dt, e, n, u, fastest, accel = _calc_limits(c, f, t, ahead_m)
    left = 0.0
    for axis in range(3):
        away = c.goal[axis] - position_at(c, t, axis)
        left += away * away
    fastest = min(fastest, math.sqrt(2.0 * accel * math.sqrt(left) + c.to_speed * c.to_speed))
    return dt, e, n, u, fastest, accel


@compiled
def advance_target_along_track(c: Any, f: Any, dt_s: float) -> None:
    """Move the reference by one step along the curve (`advance_target_along_track`)."""
    if c.reached == 1 and c.t >= 1.0 and c.from_speed == 0.0 and c.to_speed == 0.0:
        for axis in range(3):
            f.ref_pos[axis] = c.goal[axis]
            f.ref_vel[axis] = 0.0
        return
    speed = math.sqrt(f.ref_vel[0] ** 2 + f.ref_vel[1] ** 2 + f.ref_vel[2] ** 2)
    if speed < STILL_MPS:
        speed = 0.0
    dt, e, n, u, fastest, accel = calc_dt_speed_max(c, f, c.t, speed * dt_s)
    for axis in range(3):
        f.ref_pos[axis] = position_at(c, c.t, axis)
    speed = clamp(fastest, speed - accel * dt_s, speed + accel * dt_s)
    f.ref_vel[0] = e * speed
    f.ref_vel[1] = n * speed
    f.ref_vel[2] = u * speed
    c.t += dt
    if c.t >= 1.0:
        c.t = 1.0
        c.reached = 1
