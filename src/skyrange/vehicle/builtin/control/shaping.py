"""Input shaping: motion towards a target within limits of speed, acceleration and jerk.

ArduPilot's square-root controller and its jerk-limited input shaping (libraries/AP_Math/control.cpp:
`sqrt_controller`, `inv_sqrt_controller`, `shape_vel_accel`, `shape_vel_accel_xy`, `shape_pos_vel_accel`). Units are
free but consistent: m, s.
"""

from __future__ import annotations

import math

from skyrange.core.compiled import compiled, inlined

_CORNER = 1.0 / math.sqrt(2.0)  # CORNER_ACCELERATION_RATIO


@inlined
def clamp(value: float, low: float, high: float) -> float:
    """Limit `value` to [low, high]."""
    return min(max(value, low), high)


@compiled
def wrap_pi(angle_rad: float) -> float:
    """Return the same angle in [-π, π)."""
    if -math.pi <= angle_rad < math.pi:
        return angle_rad
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


@inlined
def sqrt_controller(error: float, p: float, second_limit: float, dt_s: float) -> float:
    """Return the correction rate for `error`: linear with gain `p` near 0, a square root beyond.

    The square root keeps the deceleration at `second_limit` (>0). The rate does not overshoot within a step of `dt_s`.
    """
    size = abs(error)
    rate = size * p
    if rate * p > second_limit:
        rate = math.sqrt(max(second_limit * (2.0 * size - second_limit / (p * p)), 0.0))
    if rate * dt_s > size:  # divide only where needed: this runs five times in each step of position control
        rate = size / dt_s
    return math.copysign(rate, error)


@inlined
def sqrt_controller_xy(east: float, north: float, p: float, second_limit: float, dt_s: float) -> tuple[float, float]:
    """Apply `sqrt_controller` to the length of a horizontal vector, along its direction."""
    length = math.sqrt(east * east + north * north)
    if length < 1e-12:
        return 0.0, 0.0
    scale = sqrt_controller(length, p, second_limit, dt_s) / length
    return east * scale, north * scale


@compiled
def stopping_distance(speed: float, p: float, second_limit: float) -> float:
    """Return the error at which `sqrt_controller` requests `speed` (its inverse): the distance to brake."""
    linear = second_limit / p
    if abs(speed) < linear:
        return speed / p
    far = 0.5 * linear / p + 0.5 * speed * speed / second_limit
    return far if speed > 0.0 else -far


@inlined
def limit_xy(east: float, north: float, most: float) -> tuple[float, float]:
    """Return the vector, shortened to length `most` where it is longer."""
    square = east * east + north * north
    if square > most * most:
        scale = most / math.sqrt(square)
        return east * scale, north * scale
    return east, north


@compiled
def shape_vel_accel(  # noqa: PLR0917
    target: float, added: float, velocity: float, accel: float, accel_max: float, jerk_max: float, dt_s: float
) -> float:
    """Return the next acceleration to bring `velocity` to `target`.

    Within `accel_max`, to which `added` is added, and within `jerk_max`.
    """
    wanted = sqrt_controller(target - velocity, jerk_max / accel_max, jerk_max, dt_s)
    wanted = clamp(wanted, -accel_max, accel_max) + added
    return accel + clamp(wanted - accel, -jerk_max * dt_s, jerk_max * dt_s)


@compiled
def shape_vel_accel_xy(  # noqa: PLR0917
    target_e: float, target_n: float, added_e: float, added_n: float, vel_e: float, vel_n: float,
    acc_e: float, acc_n: float, accel_max: float, jerk_max: float, dt_s: float,
) -> tuple[float, float]:  # fmt: skip
    """Apply `shape_vel_accel` to a horizontal vector, with limits on its length.

    Turning takes at most 0.7 of the acceleration.
    """
    want_e, want_n = sqrt_controller_xy(target_e - vel_e, target_n - vel_n, jerk_max / accel_max, jerk_max, dt_s)
    speed = math.sqrt(target_e * target_e + target_n * target_n)
    if speed <= 0.0:
        want_e, want_n = limit_xy(want_e, want_n, accel_max)
    else:
        u = target_e / speed
        v = target_n / speed
        along = u * want_e + v * want_n
        cross_e = want_e - u * along
        cross_n = want_n - v * along
        if along * along <= cross_e * cross_e + cross_n * cross_n:
            want_e, want_n = limit_xy(want_e, want_n, accel_max)
        else:
            cross_e, cross_n = limit_xy(cross_e, cross_n, _CORNER * accel_max)
            room = math.sqrt(accel_max * accel_max - cross_e * cross_e - cross_n * cross_n)
            along = clamp(along, -room, room)
            want_e = cross_e + u * along
            want_n = cross_n + v * along
    step_e, step_n = limit_xy(want_e + added_e - acc_e, want_n + added_n - acc_n, jerk_max * dt_s)
    return acc_e + step_e, acc_n + step_n


@compiled
def approach_velocity(error: float, accel_max: float, jerk_max: float, dt_s: float) -> float:
    """Return the velocity that closes a position `error` and can still be stopped within the limits."""
    return sqrt_controller(error, 0.5 * jerk_max / accel_max, 0.5 * accel_max, dt_s)
