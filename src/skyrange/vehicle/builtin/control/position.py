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

from skyrange.core.compiled import compiled, inlined
from skyrange.vehicle.builtin.control.shaping import clamp, limit_xy, sqrt_controller, sqrt_controller_xy


@inlined
def limit_accel(vel_e: float, vel_n: float, e: float, n: float, most: float) -> tuple[float, float]:
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
    room = math.sqrt(max(most * most - square, 0.0))
    along = clamp(along, -room, room)
    return across_e + u * along, across_n + v * along


@inlined
def integrate_velocity_error(
    i_e: float, i_n: float, more_e: float, more_n: float, limited_e: float, limited_n: float, most: float
) -> tuple[float, float]:
    """Return the integral of the velocity error; towards an acceleration that was limited, it turns but does not grow.

    After AC_PID_2D::update_i. `limited_e` and `limited_n` are the acceleration that was requested, 0 if it was granted.
    """
    size = math.sqrt(i_e * i_e + i_n * i_n)
    grows = more_e * limited_e + more_n * limited_n > 0.0
    return limit_xy(i_e + more_e, i_n + more_n, min(most, size) if grows else most)


@inlined
def request_velocity(
    off_e: float, off_n: float, p: float, accel: float, most: float, dt_s: float
) -> tuple[float, float]:
    """Return the velocity, at most `most`, that corrects an error of position by deceleration at `accel`."""
    want_e, want_n = sqrt_controller_xy(off_e, off_n, p, accel, dt_s)
    return limit_xy(want_e, want_n, most)


@inlined
def request_climb(off: float, p: float, accel: float, down: float, up: float, dt_s: float) -> float:
    """Return the climb rate that corrects an error of height, within the speeds down and up."""
    want = sqrt_controller(off, p, accel, dt_s)
    return clamp(want, -max(down, 0.5), max(up, 0.5))


@compiled
def update_u_controller(e: Any, f: Any, g: Any, dt_s: float) -> None:
    """Compute the vertical acceleration to request, m/s², from the errors of height and climb rate."""
    want = request_climb(f.ref_pos[2] - e.pos[2], g.height_p, f.accel_z, f.speed_down, f.speed_up, dt_s) + f.ref_vel[2]
    f.climb_err += (want - e.vel[2] - f.climb_err) * g.climb_alpha
    f.climb_accel = g.climb_p * f.climb_err + f.ref_acc[2]


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
