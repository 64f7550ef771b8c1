"""How does a reference move towards a target within limits of speed, acceleration and jerk?

Two tools, both ArduPilot's in kind: the square-root controller with jerk-limited input shaping
(libraries/AP_Math/control.cpp: `sqrt_controller`, `shape_vel_accel`, `shape_pos_vel_accel`), and the
jerk-limited rest-to-rest profile along a leg (libraries/AP_Math/SCurve), here in closed form with
a trapezoidal acceleration (Biagiotti & Melchiorri, "Trajectory Planning for Automatic Machines and
Robots", 2008, section 3.4). Units are free but consistent: m, s.
"""

from __future__ import annotations

import math

from skyrange.core.compiled import kernel

_BISECTIONS = 60  # the peak speed of a short leg, to below rounding


@kernel
def clamp(value: float, low: float, high: float) -> float:
    """`value` held inside [low, high]."""
    return min(max(value, low), high)


@kernel
def wrap_pi(angle_rad: float) -> float:
    """The same angle in [-π, π)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


@kernel
def sqrt_controller(error: float, p: float, second_limit: float, dt_s: float) -> float:
    """Correction rate for `error`: linear with gain `p` near 0, then growing as a square root.

    The square root keeps the deceleration at `second_limit` (>0). The rate never overshoots within
    one step of `dt_s`.
    """
    linear = second_limit / (p * p)
    if error > linear:
        rate = math.sqrt(2.0 * second_limit * (error - 0.5 * linear))
    elif error < -linear:
        rate = -math.sqrt(2.0 * second_limit * (-error - 0.5 * linear))
    else:
        rate = error * p
    most = abs(error) / dt_s
    return clamp(rate, -most, most)


@kernel
def sqrt_controller_xy(east: float, north: float, p: float, second_limit: float, dt_s: float) -> tuple[float, float]:
    """`sqrt_controller` on the length of a horizontal vector, along its direction."""
    length = math.sqrt(east * east + north * north)
    if length < 1e-12:
        return 0.0, 0.0
    scale = sqrt_controller(length, p, second_limit, dt_s) / length
    return east * scale, north * scale


@kernel
def limit_xy(east: float, north: float, most: float) -> tuple[float, float]:
    """The vector, shortened to length `most` where it is longer."""
    length = math.sqrt(east * east + north * north)
    if length > most:
        scale = most / length
        return east * scale, north * scale
    return east, north


@kernel
def shape_velocity(
    target: float, velocity: float, accel: float, accel_max: float, jerk_max: float, dt_s: float
) -> float:
    """The next acceleration that brings `velocity` to `target` within `accel_max` and `jerk_max`."""
    wanted = sqrt_controller(target - velocity, jerk_max / accel_max, jerk_max, dt_s)
    wanted = clamp(wanted, -accel_max, accel_max)
    return accel + clamp(wanted - accel, -jerk_max * dt_s, jerk_max * dt_s)


@kernel
def shape_velocity_xy(
    target_e: float,
    target_n: float,
    vel_e: float,
    vel_n: float,
    acc_e: float,
    acc_n: float,
    accel_max: float,
    jerk_max: float,
    dt_s: float,
) -> tuple[float, float]:
    """`shape_velocity` on a horizontal vector, limits on its length."""
    want_e, want_n = sqrt_controller_xy(target_e - vel_e, target_n - vel_n, jerk_max / accel_max, jerk_max, dt_s)
    want_e, want_n = limit_xy(want_e, want_n, accel_max)
    step_e, step_n = limit_xy(want_e - acc_e, want_n - acc_n, jerk_max * dt_s)
    return acc_e + step_e, acc_n + step_n


@kernel
def approach_velocity(error: float, accel_max: float, jerk_max: float, dt_s: float) -> float:
    """The velocity that closes a position `error` and can still be stopped within the limits."""
    return sqrt_controller(error, 0.5 * jerk_max / accel_max, 0.5 * accel_max, dt_s)


@kernel
def ramp_time(from_speed: float, to_speed: float, accel_max: float, jerk_max: float) -> float:
    """How long a jerk-limited change of speed takes, acceleration zero at both ends."""
    change = abs(to_speed - from_speed)
    if change >= accel_max * accel_max / jerk_max:
        return change / accel_max + accel_max / jerk_max
    return 2.0 * math.sqrt(change / jerk_max)


@kernel
def ramp_at(
    t_s: float, from_speed: float, to_speed: float, accel_max: float, jerk_max: float
) -> tuple[float, float, float]:
    """(distance, speed, acceleration) at `t_s` into a jerk-limited change of speed.

    `t_s` is held inside [0, ramp_time].
    """
    total = ramp_time(from_speed, to_speed, accel_max, jerk_max)
    t = clamp(t_s, 0.0, total)
    sign = 1.0 if to_speed >= from_speed else -1.0
    t_jerk = min(accel_max / jerk_max, 0.5 * total)
    peak = jerk_max * t_jerk
    if t <= t_jerk:
        gain = jerk_max * t * t / 2.0
        moved = jerk_max * t * t * t / 6.0
        accel = jerk_max * t
    elif t <= total - t_jerk:
        after = t - t_jerk
        gain = peak * t_jerk / 2.0 + peak * after
        moved = peak * t_jerk * t_jerk / 6.0 + peak * t_jerk / 2.0 * after + peak * after * after / 2.0
        accel = peak
    else:  # mirror image of the first part, seen from the end
        left = total - t
        change = abs(to_speed - from_speed)
        gain = change - jerk_max * left * left / 2.0
        moved = change * total / 2.0 - (change * left - jerk_max * left * left * left / 6.0)
        accel = jerk_max * left
    return from_speed * t + sign * moved, from_speed + sign * gain, sign * accel


@kernel
def peak_speed(distance: float, from_speed: float, speed_max: float, accel_max: float, jerk_max: float) -> float:
    """The cruise speed of a profile that starts at `from_speed` and stops after `distance`.

    `speed_max` where there is room for it; otherwise the highest speed that still stops in time
    (at least `from_speed`, which then overruns `distance`: the caller sees to it that it does not).
    """
    low = min(from_speed, speed_max)
    if _length(from_speed, speed_max, accel_max, jerk_max) <= distance:
        return speed_max
    if speed_max <= from_speed:
        return from_speed
    high = speed_max
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if _length(from_speed, middle, accel_max, jerk_max) <= distance:
            low = middle
        else:
            high = middle
    return low


@kernel
def _length(from_speed: float, peak: float, accel_max: float, jerk_max: float) -> float:
    """Distance of a change from one speed to the peak and from there to rest."""
    up = 0.5 * (from_speed + peak) * ramp_time(from_speed, peak, accel_max, jerk_max)
    return up + 0.5 * peak * ramp_time(peak, 0.0, accel_max, jerk_max)
