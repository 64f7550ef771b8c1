"""Position control of several aircraft at once: from the errors of position and velocity to a lean and a thrust.

Gains, limits and structure are those of libraries/AC_AttitudeControl: AC_PosControl.cpp (`update_NE_controller`,
`update_U_controller`, `soften_for_landing_NE`) and AC_AttitudeControl_Multi.cpp (`get_throttle_boosted`,
`get_throttle_avg_max`). Positions and velocities are controlled at 100 Hz (`gains.SLOW_LOOP_S`), the vertical
acceleration and the attitude at the rate of the loop. ArduCopter controls all of them at 400 Hz; the velocity filters
(5 Hz) and the input shaping (0.15 s) leave nothing in between that is faster than 100 Hz.

The lanes, from errors of position and velocity to rates of the attitude target, are computed by the same functions as
one aircraft (`attitude`), with an aircraft in each lane (see `motor_control`).
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.contracts.components import Floats
from skyrange.core import elementary
from skyrange.core.compiled import compiled, inlined
from skyrange.vehicle.builtin.control import attitude
from skyrange.vehicle.builtin.control.motor_control import LANES
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
def integrate_velocity_error(  # noqa: PLR0917
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


# where the lanes of each column begin; of three columns named ..._E, north and up follow
(
    _POS_P, _VEL_ALPHA, _VEL_D_ALPHA, _VEL_P, _VEL_I_GAIN, _VEL_D_GAIN, _VEL_IMAX, _LEAN_ACCEL, _HEIGHT_P, _CLIMB_ALPHA,
    _CLIMB_P, _INPUT_P, _ACCEL_MAX, _ACCEL_MAX_Y, _ACCEL_MAX_Z, _SLEW_YAW,
    _DT, _CORRECTION, _LEVEL, _TURNING, _YAW_RATE, _COS, _SIN,
    _POS_E, _POS_N, _POS_U, _VEL_E, _VEL_N, _VEL_U, _REF_POS_E, _REF_POS_N, _REF_POS_U, _REF_VEL_E, _REF_VEL_N,
    _REF_VEL_U, _REF_ACC_E, _REF_ACC_N, _REF_ACC_U, _ACCEL_XY, _ACCEL_Z, _SPEED_UP, _SPEED_DOWN,
    _ERR_E, _ERR_N, _D_E, _D_N, _I_E, _I_N, _LIMITED_E, _LIMITED_N, _CLIMB_ERR, _QW, _QX, _QY, _QZ,
    _RATE_X, _RATE_Y, _RATE_Z,
    _OFF_E, _OFF_N, _CLIMB_ACCEL, _TILT_COS, _W, _X, _Y, _Z, _ROLL, _PITCH, _TURN, _SMALL, COLUMNS,
) = range(0, 71 * LANES, LANES)  # fmt: skip


@compiled
def load_gains(s: Floats, k: int, g: Any) -> None:
    """Copy an aircraft's gains into its lane."""
    s[_POS_P + k] = g.pos_p
    s[_VEL_ALPHA + k] = g.vel_alpha
    s[_VEL_D_ALPHA + k] = g.vel_d_alpha
    s[_VEL_P + k] = g.vel_p
    s[_VEL_I_GAIN + k] = g.vel_i
    s[_VEL_D_GAIN + k] = g.vel_d
    s[_VEL_IMAX + k] = g.vel_imax
    s[_LEAN_ACCEL + k] = g.lean_accel
    s[_HEIGHT_P + k] = g.height_p
    s[_CLIMB_ALPHA + k] = g.climb_alpha
    s[_CLIMB_P + k] = g.climb_p
    s[_INPUT_P + k] = g.input_p
    s[_ACCEL_MAX + k] = g.accel_max[0]
    s[_ACCEL_MAX_Y + k] = g.accel_max[1]
    s[_ACCEL_MAX_Z + k] = g.accel_max[2]
    s[_SLEW_YAW + k] = g.slew_yaw


@inlined
def load_lane(  # noqa: PLR0917
    s: Floats, k: int, e: Any, f: Any,
    correction_mps: float, level: bool, turning: bool, yaw: float, yaw_rate: float, dt_s: float,  # noqa: FBT001
) -> None:  # fmt: skip
    """Copy an aircraft's state into its lane, with what is asked for.

    `correction_mps` is the largest correction of the velocity, `level` asks for no horizontal acceleration, `turning`
    for a yaw rate instead of a yaw; `dt_s` is the time since position control ran last.
    """
    s[_DT + k] = dt_s
    s[_CORRECTION + k] = correction_mps
    s[_LEVEL + k] = 1.0 if level else 0.0
    s[_TURNING + k] = 1.0 if turning else 0.0
    s[_YAW_RATE + k] = yaw_rate
    s[_COS + k] = elementary.cos(0.5 * yaw)
    s[_SIN + k] = elementary.sin(0.5 * yaw)
    for axis in range(3):
        at = axis * LANES + k
        s[_POS_E + at] = e.pos[axis]
        s[_VEL_E + at] = e.vel[axis]
        s[_REF_POS_E + at] = f.ref_pos[axis]
        s[_REF_VEL_E + at] = f.ref_vel[axis]
        s[_REF_ACC_E + at] = f.ref_acc[axis]
        s[_RATE_X + at] = f.att_target_rate[axis]
    for axis in range(2):
        at = axis * LANES + k
        s[_ERR_E + at] = f.vel_err[axis]
        s[_D_E + at] = f.vel_d[axis]
        s[_I_E + at] = f.vel_i[axis]
        s[_LIMITED_E + at] = f.limited_accel[axis]
    for part in range(4):
        s[_QW + part * LANES + k] = f.att_target[part]
    s[_ACCEL_XY + k] = f.accel_xy
    s[_ACCEL_Z + k] = f.accel_z
    s[_SPEED_UP + k] = f.speed_up
    s[_SPEED_DOWN + k] = f.speed_down
    s[_CLIMB_ERR + k] = f.climb_err


@inlined
def store_lane(s: Floats, k: int, f: Any) -> None:
    """Copy the result from a lane to an aircraft's record."""
    f.climb_err = s[_CLIMB_ERR + k]
    f.climb_accel = s[_CLIMB_ACCEL + k]
    f.tilt_cos = s[_TILT_COS + k]
    for axis in range(3):
        f.att_target_rate[axis] = s[_RATE_X + axis * LANES + k]
    if s[_LEVEL + k] == 1.0:
        return
    for axis in range(2):
        at = axis * LANES + k
        f.pos_err[axis] = s[_OFF_E + at]
        f.vel_err[axis] = s[_ERR_E + at]
        f.vel_d[axis] = s[_D_E + at]
        f.vel_i[axis] = s[_I_E + at]
        f.limited_accel[axis] = s[_LIMITED_E + at]


@compiled
def run_position_control(s: Floats, used: int) -> None:
    """Compute the first `used` lanes."""
    _request_attitude(s)
    for k in range(used):
        if s[_SMALL + k] == 0.0:
            s[_ROLL + k], s[_PITCH + k], s[_TURN + k], _ = attitude.thrust_heading_rotation_angles(
                s[_W + k], s[_X + k], s[_Y + k], s[_Z + k]
            )
    _shape_rates(s)


@compiled
def _request_attitude(s: Floats) -> None:
    """From position to acceleration, from that to an attitude, and to the error of the attitude target."""
    for k in range(LANES):
        dt_s = s[_DT + k]
        climb = request_climb(
            s[_REF_POS_U + k] - s[_POS_U + k], s[_HEIGHT_P + k], s[_ACCEL_Z + k],
            s[_SPEED_DOWN + k], s[_SPEED_UP + k], dt_s,
        )  # fmt: skip
        climb_err = s[_CLIMB_ERR + k]
        climb_err += (climb + s[_REF_VEL_U + k] - s[_VEL_U + k] - climb_err) * s[_CLIMB_ALPHA + k]
        s[_CLIMB_ERR + k] = climb_err
        s[_CLIMB_ACCEL + k] = s[_CLIMB_P + k] * climb_err + s[_REF_ACC_U + k]

        off_e = s[_REF_POS_E + k] - s[_POS_E + k]
        off_n = s[_REF_POS_N + k] - s[_POS_N + k]
        s[_OFF_E + k], s[_OFF_N + k] = off_e, off_n
        want_e, want_n = request_velocity(off_e, off_n, s[_POS_P + k], s[_ACCEL_XY + k], s[_CORRECTION + k], dt_s)
        last_e, last_n = s[_ERR_E + k], s[_ERR_N + k]
        err_e = last_e + (want_e + s[_REF_VEL_E + k] - s[_VEL_E + k] - last_e) * s[_VEL_ALPHA + k]
        err_n = last_n + (want_n + s[_REF_VEL_N + k] - s[_VEL_N + k] - last_n) * s[_VEL_ALPHA + k]
        d_e, d_n = s[_D_E + k], s[_D_N + k]
        d_e += (err_e - last_e - d_e) * s[_VEL_D_ALPHA + k]
        d_n += (err_n - last_n - d_n) * s[_VEL_D_ALPHA + k]
        i_e, i_n = integrate_velocity_error(
            s[_I_E + k], s[_I_N + k], s[_VEL_I_GAIN + k] * err_e * dt_s, s[_VEL_I_GAIN + k] * err_n * dt_s,
            s[_LIMITED_E + k], s[_LIMITED_N + k], s[_VEL_IMAX + k],
        )  # fmt: skip
        ask_e = s[_VEL_P + k] * err_e + i_e + s[_VEL_D_GAIN + k] * d_e + s[_REF_ACC_E + k]
        ask_n = s[_VEL_P + k] * err_n + i_n + s[_VEL_D_GAIN + k] * d_n + s[_REF_ACC_N + k]
        got_e, got_n = limit_accel(s[_REF_VEL_E + k], s[_REF_VEL_N + k], ask_e, ask_n, s[_LEAN_ACCEL + k])
        cut = (got_e != ask_e) | (got_n != ask_n)
        s[_ERR_E + k], s[_ERR_N + k] = err_e, err_n
        s[_D_E + k], s[_D_N + k] = d_e, d_n
        s[_I_E + k], s[_I_N + k] = i_e, i_n
        s[_LIMITED_E + k] = ask_e if cut else 0.0
        s[_LIMITED_N + k] = ask_n if cut else 0.0

        level = s[_LEVEL + k] == 1.0
        w, x, y, s[_TILT_COS + k] = attitude.thrust_attitude(0.0 if level else got_e, 0.0 if level else got_n)
        hw, hx, hy, hz = attitude.turn_to_heading(w, x, y, s[_COS + k], s[_SIN + k])
        turning = s[_TURNING + k] == 1.0
        w, x, y, z = w if turning else hw, x if turning else hx, y if turning else hy, 0.0 if turning else hz
        w, x, y, z = attitude.relative_rotation(s[_QW + k], s[_QX + k], s[_QY + k], s[_QZ + k], w, x, y, z)
        roll, pitch, turn, _, small = attitude.small_rotation_angles(w, x, y, z)
        s[_W + k], s[_X + k], s[_Y + k], s[_Z + k] = w, x, y, z
        s[_ROLL + k], s[_PITCH + k], s[_TURN + k] = roll, pitch, turn
        s[_SMALL + k] = 1.0 if small else 0.0


@compiled
def _shape_rates(s: Floats) -> None:
    """Shape the rates of the attitude target towards the requested attitude."""
    for k in range(LANES):
        dt_s = s[_DT + k]
        p = s[_INPUT_P + k]
        for axis in range(2):
            at = axis * LANES + k
            accel = s[_ACCEL_MAX + at]
            wanted = sqrt_controller(s[_ROLL + at], p, accel, dt_s)
            s[_RATE_X + at] = attitude.input_shaping_ang_vel(s[_RATE_X + at], wanted, accel, dt_s)
        s[_RATE_Z + k] = attitude.shape_yaw_rate(
            s[_RATE_Z + k], s[_TURN + k], p, s[_ACCEL_MAX_Z + k],
            s[_SLEW_YAW + k], s[_TURNING + k] == 1.0, s[_YAW_RATE + k], dt_s,
        )  # fmt: skip
