"""Position control: from the errors of position and velocity to a lean and a thrust, as in ArduCopter.

Gains, limits and structure are those of libraries/AC_AttitudeControl: AC_PosControl.cpp (`update_NE_controller`,
`update_U_controller`, `soften_for_landing_NE`) and AC_AttitudeControl_Multi.cpp (`get_throttle_boosted`,
`get_throttle_avg_max`). Positions and velocities are controlled at 100 Hz (`gains.SLOW_LOOP_S`), the vertical
acceleration and the attitude at the rate of the loop. ArduCopter controls all of them at 400 Hz; the velocity filters
(5 Hz) and the input shaping (0.15 s) leave nothing in between that is faster than 100 Hz.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.control.attitude import cos_tilt, mix_motors, run_angle_controller, run_rate_controller
from skyrange.vehicle.builtin.control.shaping import clamp, limit_xy, sqrt_controller, sqrt_controller_xy

_LEAN_COS_MIN = 0.5  # the angle boost's limit (AC_AttitudeControl_Multi::get_throttle_boosted)
_MIX_MAX = 0.5  # ATC_THR_MIX_MAX: share of hover thrust up to which attitude control may raise the thrust
_MIX_MIN = 0.1  # ATC_THR_MIX_MIN: the same on descent close to the ground


@compiled
def _limit_accel(vel_e: float, vel_n: float, e: float, n: float, most: float) -> tuple[float, float]:
    """Limit an acceleration to `most`; the part across the velocity has priority (`limit_accel_xy`)."""
    if e * e + n * n <= most * most:
        return e, n
    speed = math.sqrt(vel_e * vel_e + vel_n * vel_n)
    if speed < 1e-9:
        return limit_xy(e, n, most)
    u = vel_e / speed
    v = vel_n / speed
    along = u * e + v * n
    across_e = e - u * along
    across_n = n - v * along
    square = across_e * across_e + across_n * across_n
    if square > most * most:
        return limit_xy(across_e, across_n, most)
    room = math.sqrt(most * most - square)
    along = clamp(along, -room, room)
    return across_e + u * along, across_n + v * along


@compiled
def _update_vel_i(f: Any, g: Any, dt_s: float) -> None:
    """Integrate the velocity error; towards an acceleration that was limited, the integral turns but does not grow.

    After AC_PID_2D::update_i.
    """
    more_e = g.vel_i * f.vel_err[0] * dt_s
    more_n = g.vel_i * f.vel_err[1] * dt_s
    most = g.vel_imax
    if more_e * f.limited_accel[0] + more_n * f.limited_accel[1] > 0.0:
        most = min(most, math.sqrt(f.vel_i[0] * f.vel_i[0] + f.vel_i[1] * f.vel_i[1]))
    f.vel_i[0], f.vel_i[1] = limit_xy(f.vel_i[0] + more_e, f.vel_i[1] + more_n, most)


@compiled
def update_ne_controller(e: Any, f: Any, g: Any, correction_mps: float, dt_s: float) -> tuple[float, float]:
    """Return the horizontal acceleration to request, m/s² (east, north), within the lean limit.

    A square-root controller turns the position error into a velocity (at most `correction_mps`), a PID turns the
    velocity error into an acceleration; the reference's own velocity and acceleration are added.
    """
    f.pos_err[0] = f.ref_pos[0] - e.pos[0]
    f.pos_err[1] = f.ref_pos[1] - e.pos[1]
    want_e, want_n = sqrt_controller_xy(f.pos_err[0], f.pos_err[1], g.pos_p, f.accel_xy, dt_s)
    want_e, want_n = limit_xy(want_e, want_n, correction_mps)
    last_e = f.vel_err[0]
    last_n = f.vel_err[1]
    f.vel_err[0] += (want_e + f.ref_vel[0] - e.vel[0] - last_e) * g.vel_alpha
    f.vel_err[1] += (want_n + f.ref_vel[1] - e.vel[1] - last_n) * g.vel_alpha
    f.vel_d[0] += (f.vel_err[0] - last_e - f.vel_d[0]) * g.vel_d_alpha
    f.vel_d[1] += (f.vel_err[1] - last_n - f.vel_d[1]) * g.vel_d_alpha
    _update_vel_i(f, g, dt_s)
    ask_e = g.vel_p * f.vel_err[0] + f.vel_i[0] + g.vel_d * f.vel_d[0] + f.ref_acc[0]
    ask_n = g.vel_p * f.vel_err[1] + f.vel_i[1] + g.vel_d * f.vel_d[1] + f.ref_acc[1]
    got_e, got_n = _limit_accel(f.ref_vel[0], f.ref_vel[1], ask_e, ask_n, g.lean_accel)
    cut = got_e != ask_e or got_n != ask_n
    f.limited_accel[0] = ask_e if cut else 0.0
    f.limited_accel[1] = ask_n if cut else 0.0
    return got_e, got_n


@compiled
def update_u_controller(e: Any, f: Any, g: Any, dt_s: float) -> None:
    """Compute the vertical acceleration to request, m/s², from the errors of height and climb rate."""
    want = sqrt_controller(f.ref_pos[2] - e.pos[2], g.height_p, f.accel_z, dt_s)
    want = clamp(want, -max(f.speed_down, 0.5), max(f.speed_up, 0.5)) + f.ref_vel[2]
    f.climb_err += (want - e.vel[2] - f.climb_err) * g.climb_alpha
    f.climb_accel = g.climb_p * f.climb_err + f.ref_acc[2]


@compiled
def run_accel_controller(e: Any, f: Any, g: Any) -> float:
    """Return the thrust to request, 0…1 of full, before the compensation of the lean."""
    f.accel_err += (f.climb_accel - e.accel[2] - f.accel_err) * g.accel_alpha
    step = g.accel_i * f.accel_err
    throttle = g.throttle_hover + g.accel_p * f.accel_err + f.throttle_i
    if not ((throttle <= 0.0 and step < 0.0) or ((throttle >= 1.0 or f.throttle_limited == 1) and step > 0.0)):
        f.throttle_i = clamp(f.throttle_i + step, -g.accel_imax, g.accel_imax)
    return clamp(g.throttle_hover + g.accel_p * f.accel_err + f.throttle_i, 0.0, 1.0)


@compiled
def relax_controllers(f: Any) -> None:
    """Reset the controllers: on the ground their accumulated errors mean nothing."""
    for axis in range(2):
        f.vel_err[axis] = 0.0
        f.vel_d[axis] = 0.0
        f.vel_i[axis] = 0.0
        f.rate_d[axis] = 0.0
        f.pos_err[axis] = 0.0
    for axis in range(3):
        f.rate_i[axis] = 0.0
    f.climb_err = 0.0
    f.climb_accel = 0.0
    f.accel_err = 0.0
    f.throttle_limited = 0


@compiled
def output_motors(e: Any, f: Any, g: Any, coming_down: bool, rates_only: bool) -> tuple[float, float, float, float]:
    """Hold the attitude target, or (`rates_only`) its rates, at `throttle`; return the commands of four motors.

    They are returned as numbers because a compiled function that is passed an array counts a reference to it, which
    takes as long.
    """
    if rates_only:
        roll_rate = f.att_target_rate[0]
        pitch_rate = f.att_target_rate[1]
        yaw_rate = f.att_target_rate[2]
    else:
        roll_rate, pitch_rate, yaw_rate = run_angle_controller(e, f, g)
    roll, pitch, yaw = run_rate_controller(e, f, g, roll_rate, pitch_rate, yaw_rate)
    boost = 1.0 / max(cos_tilt(e), _LEAN_COS_MIN)
    thrust = f.throttle * boost
    share_of_mix = _MIX_MIN if coming_down else _MIX_MAX
    average = max(thrust, f.throttle * (1.0 - share_of_mix) + g.throttle_hover * share_of_mix)
    full, a, b, c, d = mix_motors(g, thrust, average, roll, pitch, yaw)
    f.throttle_limited = 1 if full else 0
    return a, b, c, d
