"""S-curves: jerk-limited motion along a straight leg, with a jerk that rises and falls as a raised cosine.

The profile is that of libraries/AP_Math/SCurve.cpp (`calculate_path`, `add_segments_jerk`, `set_speed_max`,
`set_origin_speed_max`, `set_destination_speed_max`): 23 segments, namely a start, seven that accelerate, seven that
change the speed in flight, one at constant speed, and seven that decelerate. A group of seven is jerk rising, held,
falling to zero, constant acceleration, and the same in reverse. Lengths in metres, times in seconds.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core import elementary
from skyrange.core.compiled import compiled

SEGMENTS = 23
_ACCEL_MAX, _ACCEL_END, _CHANGE_END, _CONST, _DECEL_END = 4, 7, 14, 15, 22
_T, _A, _V, _P, _JM = range(5)  # columns of a segment: end time; acceleration, speed and distance then; peak jerk
_ACCEL_SHARE = 0.5  # share of a leg for acceleration; the other half is for deceleration


@compiled
def _root(value: float) -> float:
    return math.sqrt(value) if value > 0.0 else 0.0


@compiled
def calculate_path(
    snap: float, jerk: float, v0: float, accel: float, v1: float, length: float
) -> tuple[float, float, float, float, float]:
    """Return (peak jerk, rise time, then times at jerk, acceleration and jerk) of a change from `v0` towards `v1`.

    `SCurve::calculate_path`: as fast as `snap`, `jerk`, `accel` and half a leg's `length` allow; all zero where
    there is no speed to gain.
    """
    none = (0.0, 0.0, 0.0, 0.0, 0.0)
    if not (snap > 0.0 and jerk > 0.0 and accel > 0.0 and v1 > 0.0 and length > 0.0) or v0 >= v1:
        return none
    tj = jerk * math.pi / (2.0 * snap)
    reach = min(min(accel, (v1 - v0) / (2.0 * tj)), (length + 4.0 * v0 * tj) / (4.0 * tj * tj))
    t2 = 0.0
    t4 = 0.0
    if reach < jerk * tj:
        if v0 <= 0.0:
            tj = min(tj, math.sqrt(math.sqrt(length * math.pi / (8.0 * snap))))
            tj = min(tj, elementary.power(v1 * math.pi / (4.0 * snap), 1.0 / 3.0))
            tj = min(tj, math.sqrt(accel * math.pi / (2.0 * snap)))
            jerk = 2.0 * snap * tj / math.pi
            accel = jerk * tj
        else:  # a change of speed keeps the rise time and lowers the jerk
            accel = reach
            jerk = accel / tj
        if v1 > v0 + 2.0 * accel * tj and length > 4.0 * v0 * tj + 4.0 * accel * tj * tj:
            t4 = _constant_accel_time(v0, accel, v1, length, jerk, tj)
    else:
        full = accel * accel / jerk
        enough = (accel * full + accel * (2.0 * v0 + 2.0 * accel * tj)) / jerk + 2.0 * v0 * tj + accel * tj * tj
        if v1 < v0 + accel * tj + full or length < enough:
            accel = min(accel, 0.5 * jerk * (_root((4.0 * (v1 - v0) + jerk * tj * tj) / jerk) - tj))
            accel = min(accel, _peak_accel(v0, length, jerk, tj))
        else:
            t4 = _constant_accel_time(v0, accel, v1, length, jerk, tj)
        t2 = accel / jerk - tj
    if not (math.isfinite(t2 + t4 + tj) and jerk >= 0.0 and tj >= 0.0 and t2 >= -1e-9 and t4 >= 0.0):
        return none
    return jerk, tj, max(t2, 0.0), t4, max(t2, 0.0)


@compiled
def _constant_accel_time(v0: float, accel: float, v1: float, length: float, jerk: float, tj: float) -> float:
    """Return how long the acceleration is held: until the speed or half the leg is reached (`calculate_path`)."""
    a2 = accel * accel
    j2 = jerk * jerk
    inside = (
        a2 * a2 * 0.25 + j2 * v0 * v0 + a2 * j2 * tj * tj * 0.25 + accel * j2 * length * 2.0
        - a2 * jerk * v0 + a2 * accel * jerk * tj * 0.5 - accel * j2 * v0 * tj
    )  # fmt: skip
    by_length = (-1.5 * a2 + _root(inside) - jerk * v0 - accel * jerk * tj * 1.5) / (accel * jerk)
    by_speed = -(v0 - v1 + accel * tj + a2 / jerk) / accel
    return max(min(by_speed, by_length), 0.0)


@compiled
def _peak_accel(v0: float, length: float, jerk: float, tj: float) -> float:
    """Return the acceleration whose rise and fall, without holding it, takes the whole of `length`.

    `calculate_path` writes this root out by Cardano: length = a³/j² + 2·a·v0/j + 2·a²·tj/j + 2·v0·tj + a·tj², rising
    in a. Here it is found by bisection, which needs no distinction of signs.
    """
    low = 0.0
    high = 1e3
    for _ in range(60):
        a = 0.5 * (low + high)
        used = a * a * a / (jerk * jerk) + 2.0 * a * (v0 + a * tj) / jerk + 2.0 * v0 * tj + a * tj * tj
        if used < length:
            low = a
        else:
            high = a
    return low


@compiled
def _set_segment(c: Any, i: int, t: float, jm: float, a: float, v: float, p: float) -> None:  # noqa: PLR0917
    c.seg[i, _T] = t
    c.seg[i, _JM] = jm
    c.seg[i, _A] = a
    c.seg[i, _V] = v
    c.seg[i, _P] = p


@compiled
def _add_segment_const_jerk(c: Any, i: int, seconds: float, jm: float) -> None:
    """Append a segment of constant jerk after segment i - 1."""
    k = i - 1
    t = seconds if seconds > 0.0 else 0.0
    a = c.seg[k, _A]
    v = c.seg[k, _V]
    _set_segment(
        c, i, c.seg[k, _T] + t, jm, a + jm * t, v + a * t + 0.5 * jm * t * t,
        c.seg[k, _P] + v * t + 0.5 * a * t * t + jm * t * t * t / 6.0,
    )  # fmt: skip


@compiled
def _raised_cosine(tj: float, jm: float) -> tuple[float, float, float]:
    """Return what a jerk that rises to `jm` as a raised cosine adds in acceleration, speed and distance, from rest."""
    half = 0.5 * jm
    per = tj / math.pi
    return half * tj, half * (0.5 * tj * tj - 2.0 * per * per), half * (tj * tj * tj / 6.0 - per * per * tj)


@compiled
def _add_segment_incr_jerk(c: Any, i: int, tj: float, jm: float) -> None:
    """Append a segment in which the jerk rises from 0 to `jm` as a raised cosine."""
    k = i - 1
    if not tj > 0.0:
        _add_segment_const_jerk(c, i, 0.0, 0.0)
        return
    a, v, p = _raised_cosine(tj, jm)
    _set_segment(
        c, i, c.seg[k, _T] + tj, jm, c.seg[k, _A] + a,
        c.seg[k, _V] + c.seg[k, _A] * tj + v,
        c.seg[k, _P] + c.seg[k, _V] * tj + 0.5 * c.seg[k, _A] * tj * tj + p,
    )  # fmt: skip


@compiled
def _add_segment_decr_jerk(c: Any, i: int, tj: float, jm: float) -> None:
    """Append a segment in which the jerk falls from `jm` to 0: the reverse of `_add_segment_incr_jerk`."""
    k = i - 1
    if not tj > 0.0:
        _add_segment_const_jerk(c, i, 0.0, 0.0)
        return
    half = 0.5 * jm
    per = tj / math.pi
    a, v, p = _raised_cosine(tj, jm)
    a0 = c.seg[k, _A] - a
    v0 = c.seg[k, _V] - v
    p0 = c.seg[k, _P] - p
    _set_segment(
        c, i, c.seg[k, _T] + tj, jm, a0 + jm * tj, v0 + a0 * tj + jm * tj * tj,
        p0 + v0 * tj + 0.5 * a0 * tj * tj + half * (4.0 / 3.0 * tj * tj * tj - 2.0 * per * per * tj),
    )  # fmt: skip


@compiled
def _add_segments_jerk(c: Any, i: int, jm: float, tj: float, t_a: float, t4: float, t_b: float) -> None:  # noqa: PLR0917
    """Append seven segments from i on that change the speed: up for positive `jm`, down for negative."""
    _add_segment_incr_jerk(c, i, tj, jm)
    _add_segment_const_jerk(c, i + 1, t_a, jm if tj > 0.0 else 0.0)
    _add_segment_decr_jerk(c, i + 2, tj, jm)
    _add_segment_const_jerk(c, i + 3, t4, 0.0)
    _add_segment_incr_jerk(c, i + 4, tj, -jm)
    _add_segment_const_jerk(c, i + 5, t_b, -jm if tj > 0.0 else 0.0)
    _add_segment_decr_jerk(c, i + 6, tj, -jm)


@compiled
def _fill_empty_segments(c: Any, first: int, last: int) -> None:
    """Fill segments with zero duration, at the state in which the one before `first` ends."""
    for i in range(first, last + 1):
        _set_segment(c, i, c.seg[first - 1, _T], 0.0, 0.0, c.seg[first - 1, _V], c.seg[first - 1, _P])


@compiled
def _add_deceleration(c: Any, v_end: float, room: float) -> None:
    """Append the constant segment and the seven after it, so that the leg ends at its length with at most `v_end`."""
    _add_segment_const_jerk(c, _CONST, 0.0, 0.0)
    c.seg[_CONST, _A] = 0.0
    jm, tj, t2, t4, t6 = calculate_path(c.snap, c.jerk, v_end, c.accel, c.seg[_CONST, _V], room)
    _add_segments_jerk(c, _CONST + 1, -jm, tj, t6, t4, t2)
    c.seg[_DECEL_END, _A] = 0.0
    c.seg[_DECEL_END, _V] = max(0.0, c.seg[_DECEL_END, _V])
    _extend_constant_segment(c)


@compiled
def _extend_constant_segment(c: Any) -> None:
    """Extend the constant segment so that the last one ends at the leg's length."""
    more = max(0.0, c.length - c.seg[_DECEL_END, _P])
    time = more / c.seg[_CONST, _V] if c.seg[_CONST, _V] > 0.0 else 0.0
    for i in range(_CONST, _DECEL_END + 1):
        c.seg[i, _T] += time
        c.seg[i, _P] += more


@compiled
def clear_leg(c: Any) -> None:
    """Remove the leg: position, speed and acceleration are 0, and it is finished."""
    c.active = 0
    c.t = 0.0
    c.segment = 0
    c.length = 0.0
    c.done = 0.0
    for axis in range(3):
        c.unit[axis] = 0.0


@compiled
def kinematic_limit(e: float, n: float, u: float, level: float, up: float, down: float) -> float:
    """Return the largest magnitude along a direction whose horizontal and vertical parts keep their limits.

    `kinematic_limit` (libraries/AP_Math/control.cpp); 0 for no direction.
    """
    flat = math.sqrt(e * e + n * n)
    length = math.sqrt(flat * flat + u * u)
    if length <= 0.0:
        return 0.0
    most = level * length / flat if flat > 0.0 else math.inf
    if u > 0.0:
        most = min(most, up * length / u)
    elif u < 0.0:
        most = min(most, down * length / -u)
    return most


@compiled
def calculate_track(  # noqa: PLR0917
    c: Any, oe: float, on: float, ou: float, de: float, dn: float, du: float,
    level: float, up: float, down: float, accel: float, accel_z: float, snap: float, jerk: float,
) -> None:  # fmt: skip
    """Compute a leg from o to d, at rest at both ends (`SCurve::calculate_track`)."""
    clear_leg(c)
    e, n, u = de - oe, dn - on, du - ou
    length = math.sqrt(e * e + n * n + u * u)
    c.origin[0], c.origin[1], c.origin[2] = oe, on, ou
    if length < 1e-6 or not (level > 0.0 and up > 0.0 and down > 0.0):
        return
    c.unit[0], c.unit[1], c.unit[2] = e / length, n / length, u / length
    c.length = length
    c.speed = kinematic_limit(e, n, u, level, up, down)
    c.accel = kinematic_limit(e, n, u, accel, accel_z, accel_z)
    c.accel_z = accel_z
    c.snap = snap
    c.jerk = jerk
    _calculate_from_rest(c)
    c.active = 1


@compiled
def _calculate_from_rest(c: Any) -> None:
    jm, tj, t2, t4, t6 = calculate_path(c.snap, c.jerk, 0.0, c.accel, c.speed, _ACCEL_SHARE * c.length)
    _set_segment(c, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
    _add_segments_jerk(c, 1, jm, tj, t2, t4, t6)
    c.seg[_ACCEL_END, _A] = 0.0
    _fill_empty_segments(c, _ACCEL_END + 1, _CHANGE_END)
    left = c.length - 2.0 * c.seg[_CHANGE_END, _P]
    _add_segment_const_jerk(c, _CONST, max(0.0, left / c.seg[_CHANGE_END, _V]), 0.0)
    _add_segments_jerk(c, _CONST + 1, -jm, tj, t6, t4, t2)
    c.seg[_DECEL_END, _A] = 0.0
    c.seg[_DECEL_END, _V] = 0.0
    c.segment = 0


@compiled
def set_origin_speed_max(c: Any, speed: float) -> float:
    """Let the leg begin at a speed; return the speed that is possible (`set_origin_speed_max`)."""
    if c.active == 0:
        return 0.0
    if abs(c.seg[0, _V] - speed) < 1e-9:
        return speed
    top = c.seg[_ACCEL_END, _V]
    speed = min(speed, top)
    jm, tj, t2, t4, t6 = calculate_path(c.snap, c.jerk, speed, c.accel, top, _ACCEL_SHARE * c.length)
    _set_segment(c, 0, 0.0, 0.0, 0.0, speed, 0.0)
    _add_segments_jerk(c, 1, jm, tj, t2, t4, t6)
    c.seg[_ACCEL_END, _A] = 0.0
    back = min(0.0, _ACCEL_SHARE * c.length - c.seg[_ACCEL_END, _P])
    earlier = back / c.seg[_ACCEL_END, _V] if c.seg[_ACCEL_END, _V] > 0.0 else 0.0
    for i in range(_ACCEL_END + 1):
        c.seg[i, _T] += earlier
        c.seg[i, _P] += back
    _fill_empty_segments(c, _ACCEL_END + 1, _CHANGE_END)
    _add_deceleration(c, 0.0, _ACCEL_SHARE * c.length)
    c.segment = 0
    return speed


@compiled
def set_destination_speed_max(c: Any, speed: float) -> None:
    """Let the leg end at a speed (`set_destination_speed_max`)."""
    if c.active == 0 or abs(c.seg[_DECEL_END, _V] - speed) < 1e-9:
        return
    c.seg[_CONST, _T] = c.seg[_CHANGE_END, _T]
    _add_deceleration(c, min(speed, c.seg[_CHANGE_END, _V]), _ACCEL_SHARE * c.length)
    c.segment = 0


@compiled
def set_speed_max(c: Any, level: float, up: float, down: float) -> None:
    """Change the speed limit of a leg, also in flight (`set_speed_max`); ignored once it decelerates."""
    if c.active == 0:
        return
    speed = kinematic_limit(c.unit[0], c.unit[1], c.unit[2], level, up, down)
    if abs(speed - c.speed) < 1e-9 or not speed > 0.0:
        return
    c.speed = speed
    if c.t >= c.seg[_CONST, _T]:
        return
    v_end = min(speed, c.seg[_DECEL_END, _V])
    if c.t == 0.0:
        v_start = min(speed, c.seg[0, _V])
        _calculate_from_rest(c)
        set_origin_speed_max(c, v_start)
        set_destination_speed_max(c, v_end)
        return
    if c.seg[_ACCEL_END, _T] <= c.t <= c.seg[_CHANGE_END, _T]:
        # the change in progress moves to the first group, which leaves room for another
        _set_segment(
            c, 0, c.seg[_ACCEL_END, _T], 0.0, c.seg[_ACCEL_END, _A], c.seg[_ACCEL_END, _V], c.seg[_ACCEL_END, _P]
        )
        for i in range(1, _ACCEL_END + 1):
            k = i + 7
            _set_segment(c, i, c.seg[k, _T], c.seg[k, _JM], c.seg[k, _A], c.seg[k, _V], c.seg[k, _P])
    elif c.seg[_CHANGE_END, _T] < c.t <= c.seg[_CONST, _T]:
        done, now, _ = motion_at(c, c.t)
        k = _CHANGE_END
        _set_segment(c, 0, c.seg[k, _T], 0.0, 0.0, c.seg[k, _V], c.seg[k, _P])
        for i in range(1, _ACCEL_END + 1):
            _set_segment(c, i, c.t, 0.0, 0.0, now, done)
    held = c.seg[_ACCEL_MAX, _T] - c.seg[_ACCEL_MAX - 1, _T]
    if c.t <= c.seg[_ACCEL_MAX, _T] and held > 0.0 and speed < c.seg[_ACCEL_END, _V] and c.seg[_ACCEL_MAX, _A] > 0.0:
        # still at constant acceleration: shorten the rest of it
        cut = c.seg[_ACCEL_MAX, _T] - max(c.t, c.seg[_ACCEL_MAX - 1, _T])
        least = max(c.seg[_ACCEL_END, _V] - c.seg[_ACCEL_MAX, _A] * cut, speed)
        jm, tj, t2, t4, t6 = calculate_path(c.snap, c.jerk, c.seg[0, _V], c.accel, least, _ACCEL_SHARE * c.length)
        _add_segments_jerk(c, 1, jm, tj, t2, t4, t6)
        c.seg[_ACCEL_END, _A] = 0.0
    _fill_empty_segments(c, _ACCEL_END + 1, _CHANGE_END)
    top = c.seg[_ACCEL_END, _V]
    if abs(speed - top) > 1e-9:
        length = c.seg[_CONST, _P] - c.seg[_ACCEL_END, _P]
        # ArduPilot raises to the integer quotient 1/3, which is 0: the first of the two values is then 1
        rise = min(1.0, c.jerk * math.pi / (2.0 * c.snap))
        if speed < top and top > 0.0 and rise * 12.0 < length / top:
            jm, tj, t6, t4, t2 = calculate_path(c.snap, c.jerk, speed, c.accel, top, _ACCEL_SHARE * length)
            _add_segments_jerk(c, _ACCEL_END + 1, -jm, tj, t2, t4, t6)
        elif speed > top and length / (rise * 12.0) > top:
            most = min(speed, length / (rise * 12.0))
            jm, tj, t2, t4, t6 = calculate_path(c.snap, c.jerk, top, c.accel, most, _ACCEL_SHARE * length)
            _add_segments_jerk(c, _ACCEL_END + 1, jm, tj, t2, t4, t6)
        c.seg[_CHANGE_END, _A] = 0.0
    v_end = min(v_end, c.seg[_CHANGE_END, _V])
    _add_deceleration(c, v_end, c.length - c.seg[_CHANGE_END, _P])
    c.segment = 0


@compiled
def motion_at(c: Any, t: float) -> tuple[float, float, float]:
    """Return (distance from the origin, speed, acceleration) `t` seconds into the leg."""
    if c.active == 0:
        return 0.0, 0.0, 0.0
    i = c.segment
    if i > 0 and t < c.seg[i - 1, _T]:
        i = 0
    while i < SEGMENTS and t >= c.seg[i, _T]:
        i += 1
    if i == 0:
        return c.seg[0, _P] + c.seg[0, _V] * (t - c.seg[0, _T]), c.seg[0, _V], 0.0
    k = i - 1
    a = c.seg[k, _A]
    v = c.seg[k, _V]
    p = c.seg[k, _P]
    s = t - c.seg[k, _T]
    if i == SEGMENTS:
        return p, v, 0.0
    c.segment = i
    jm = c.seg[i, _JM]
    place = (i - 1) % 7 if i < _CONST else (i - 2) % 7
    if i == _CONST or place in (1, 3, 5):  # constant jerk
        return max(p + v * s + 0.5 * a * s * s + jm * s * s * s / 6.0, 0.0), v + a * s + 0.5 * jm * s * s, a + jm * s
    tj = c.seg[i, _T] - c.seg[k, _T]
    half = 0.5 * jm
    per = tj / math.pi
    if place in (2, 6):  # falling: the second half of the raised cosine, computed as if it had begun at rest
        da, dv, dp = _raised_cosine(tj, jm)
        p -= dp
        v -= dv
        a -= da
        moved = p + v * s + 0.5 * a * s * s
        gained = v + a * s
        s += tj
    else:
        moved = p + v * s + 0.5 * a * s * s
        gained = v + a * s
    sine = elementary.sin(s / per)
    cosine = elementary.cos(s / per)
    return (
        max(moved + half * (s * s * s / 6.0 - per * per * s + per * per * per * sine), 0.0),
        gained + half * (0.5 * s * s + per * per * (cosine - 1.0)),
        a + half * (s - per * sine),
    )


@compiled
def duration(c: Any) -> float:
    """Return the time from start to end, s; 0 without a leg."""
    return c.seg[_DECEL_END, _T] if c.active == 1 else 0.0


@compiled
def decel_start_time(c: Any) -> float:
    """Return when deceleration begins, s."""
    return c.seg[_CONST, _T] if c.active == 1 else 0.0


@compiled
def accel_end_time(c: Any) -> float:
    """Return when acceleration ends, s."""
    return c.seg[_ACCEL_END, _T] if c.active == 1 else 0.0


@compiled
def finished(c: Any) -> bool:
    """Whether the leg has been flown to its end."""
    # in ArduPilot's single floats the last tenth of a second adds no distance
    return bool(c.active == 0 or c.t >= c.seg[_DECEL_END, _T] or c.done >= c.length * (1.0 - 6e-8))


@compiled
def copy_leg(to: Any, c: Any) -> None:
    """Copy one leg to another."""
    to.length, to.speed, to.accel, to.accel_z = c.length, c.speed, c.accel, c.accel_z
    to.jerk, to.snap, to.t, to.active, to.segment, to.done = c.jerk, c.snap, c.t, c.active, c.segment, c.done
    for axis in range(3):
        to.unit[axis] = c.unit[axis]
        to.origin[axis] = c.origin[axis]
    for i in range(SEGMENTS):
        _set_segment(to, i, c.seg[i, _T], c.seg[i, _JM], c.seg[i, _A], c.seg[i, _V], c.seg[i, _P])
