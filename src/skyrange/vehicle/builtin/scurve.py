"""How does a leg's reference move along its straight line? Jerk that rises and falls as a raised cosine.

The profile is that of libraries/AP_Math/SCurve.cpp (`calculate_path`, `add_segments_jerk`, `set_speed_max`,
`set_origin_speed_max`, `set_destination_speed_max`): 23 segments, namely a start, seven that accelerate, seven that
change the speed in flight, one at constant speed, and seven that decelerate. A group of seven is jerk rising, held,
falling to zero, constant acceleration, and the same in reverse. Lengths in metres, times in seconds.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import kernel

SEGMENTS = 23
_ACCEL_MAX, _ACCEL_END, _CHANGE_END, _CONST, _DECEL_END = 4, 7, 14, 15, 22
_ROOM = 0.5  # of a leg for speeding up, the other half for slowing down


@kernel
def _root(value: float) -> float:
    return math.sqrt(value) if value > 0.0 else 0.0


@kernel
def path_times(
    snap: float, jerk: float, v0: float, accel: float, v1: float, length: float
) -> tuple[float, float, float, float, float]:
    """(peak jerk, rise time, time at the jerk, time at the acceleration, time at the jerk) from `v0` towards `v1`.

    `SCurve::calculate_path`: as fast as `snap`, `jerk`, `accel` and half a leg's `length` allow; all zero where
    there is nothing to gain.
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
            tj = min(tj, (v1 * math.pi / (4.0 * snap)) ** (1.0 / 3.0))
            tj = min(tj, math.sqrt(accel * math.pi / (2.0 * snap)))
            jerk = 2.0 * snap * tj / math.pi
            accel = jerk * tj
        else:  # a change of speed keeps the rise time and lowers the jerk
            accel = reach
            jerk = accel / tj
        if v1 > v0 + 2.0 * accel * tj and length > 4.0 * v0 * tj + 4.0 * accel * tj * tj:
            t4 = _hold(v0, accel, v1, length, jerk, tj)
    else:
        full = accel * accel / jerk
        enough = (accel * full + accel * (2.0 * v0 + 2.0 * accel * tj)) / jerk + 2.0 * v0 * tj + accel * tj * tj
        if v1 < v0 + accel * tj + full or length < enough:
            accel = min(accel, 0.5 * jerk * (_root((4.0 * (v1 - v0) + jerk * tj * tj) / jerk) - tj))
            accel = min(accel, _peak_in(v0, length, jerk, tj))
        else:
            t4 = _hold(v0, accel, v1, length, jerk, tj)
        t2 = accel / jerk - tj
    if not (math.isfinite(t2 + t4 + tj) and jerk >= 0.0 and tj >= 0.0 and t2 >= -1e-9 and t4 >= 0.0):
        return none
    return jerk, tj, max(t2, 0.0), t4, max(t2, 0.0)


@kernel
def _hold(v0: float, accel: float, v1: float, length: float, jerk: float, tj: float) -> float:
    """How long the acceleration is held: until the speed, or until half the leg is used (`calculate_path`)."""
    a2 = accel * accel
    j2 = jerk * jerk
    inside = (
        a2 * a2 * 0.25 + j2 * v0 * v0 + a2 * j2 * tj * tj * 0.25 + accel * j2 * length * 2.0
        - a2 * jerk * v0 + a2 * accel * jerk * tj * 0.5 - accel * j2 * v0 * tj
    )  # fmt: skip
    by_length = (-1.5 * a2 + _root(inside) - jerk * v0 - accel * jerk * tj * 1.5) / (accel * jerk)
    by_speed = -(v0 - v1 + accel * tj + a2 / jerk) / accel
    return max(min(by_speed, by_length), 0.0)


@kernel
def _peak_in(v0: float, length: float, jerk: float, tj: float) -> float:
    """The acceleration whose rise and fall, without holding it, uses the whole of `length`.

    The root that `calculate_path` writes out by Cardano: length = a³/j² + 2·a·v0/j + 2·a²·tj/j + 2·v0·tj + a·tj²,
    rising in a; found by bisection, which needs no care about signs.
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


@kernel
def _set(c: Any, i: int, t: float, jm: float, a: float, v: float, p: float) -> None:
    c.end_t[i] = t
    c.jm[i] = jm
    c.end_a[i] = a
    c.end_v[i] = v
    c.end_p[i] = p


@kernel
def _level(c: Any, i: int, seconds: float, jm: float) -> None:
    """A segment of constant jerk after segment i - 1."""
    k = i - 1
    t = seconds if seconds > 0.0 else 0.0
    a = c.end_a[k]
    v = c.end_v[k]
    _set(
        c, i, c.end_t[k] + t, jm, a + jm * t, v + a * t + 0.5 * jm * t * t,
        c.end_p[k] + v * t + 0.5 * a * t * t + jm * t * t * t / 6.0,
    )  # fmt: skip


@kernel
def _rise(c: Any, i: int, tj: float, jm: float) -> None:
    """A segment in which the jerk rises from 0 to `jm` as a raised cosine."""
    k = i - 1
    if not tj > 0.0:
        _level(c, i, 0.0, 0.0)
        return
    half = 0.5 * jm
    per = tj / math.pi
    _set(
        c, i, c.end_t[k] + tj, jm, c.end_a[k] + half * tj,
        c.end_v[k] + c.end_a[k] * tj + half * (0.5 * tj * tj - 2.0 * per * per),
        c.end_p[k] + c.end_v[k] * tj + 0.5 * c.end_a[k] * tj * tj + half * (tj * tj * tj / 6.0 - per * per * tj),
    )  # fmt: skip


@kernel
def _fall(c: Any, i: int, tj: float, jm: float) -> None:
    """A segment in which the jerk falls from `jm` to 0: `_rise` run backwards."""
    k = i - 1
    if not tj > 0.0:
        _level(c, i, 0.0, 0.0)
        return
    half = 0.5 * jm
    per = tj / math.pi
    a0 = c.end_a[k] - half * tj
    v0 = c.end_v[k] - half * (0.5 * tj * tj - 2.0 * per * per)
    p0 = c.end_p[k] - half * (tj * tj * tj / 6.0 - per * per * tj)
    _set(
        c, i, c.end_t[k] + tj, jm, a0 + jm * tj, v0 + a0 * tj + jm * tj * tj,
        p0 + v0 * tj + 0.5 * a0 * tj * tj + half * (4.0 / 3.0 * tj * tj * tj - 2.0 * per * per * tj),
    )  # fmt: skip


@kernel
def _seven(c: Any, i: int, jm: float, tj: float, t_a: float, t4: float, t_b: float) -> None:
    """Seven segments from i on that change the speed: up for positive `jm`, down for negative."""
    _rise(c, i, tj, jm)
    _level(c, i + 1, t_a, jm if tj > 0.0 else 0.0)
    _fall(c, i + 2, tj, jm)
    _level(c, i + 3, t4, 0.0)
    _rise(c, i + 4, tj, -jm)
    _level(c, i + 5, t_b, -jm if tj > 0.0 else 0.0)
    _fall(c, i + 6, tj, -jm)


@kernel
def _empty(c: Any, first: int, last: int) -> None:
    """Segments that take no time, standing where the one before `first` ends."""
    for i in range(first, last + 1):
        _set(c, i, c.end_t[first - 1], 0.0, 0.0, c.end_v[first - 1], c.end_p[first - 1])


@kernel
def _slow_down(c: Any, v_end: float, room: float) -> None:
    """The constant segment and the seven after it, so that the leg ends at its length with at most `v_end`."""
    _level(c, _CONST, 0.0, 0.0)
    c.end_a[_CONST] = 0.0
    jm, tj, t2, t4, t6 = path_times(c.snap, c.jerk, v_end, c.accel, c.end_v[_CONST], room)
    _seven(c, _CONST + 1, -jm, tj, t6, t4, t2)
    c.end_a[_DECEL_END] = 0.0
    c.end_v[_DECEL_END] = max(0.0, c.end_v[_DECEL_END])
    _stretch(c)


@kernel
def _stretch(c: Any) -> None:
    """Make the constant segment so long that the last one ends at the leg's length."""
    more = max(0.0, c.length - c.end_p[_DECEL_END])
    time = more / c.end_v[_CONST] if c.end_v[_CONST] > 0.0 else 0.0
    for i in range(_CONST, _DECEL_END + 1):
        c.end_t[i] += time
        c.end_p[i] += more


@kernel
def clear(c: Any) -> None:
    """No leg: position, speed and acceleration are 0, and it is finished."""
    c.live = 0
    c.t = 0.0
    c.at = 0
    c.length = 0.0
    c.done = 0.0
    for axis in range(3):
        c.unit[axis] = 0.0


@kernel
def kinematic_limit(e: float, n: float, u: float, level: float, up: float, down: float) -> float:
    """The most along a direction so that neither its level nor its vertical part exceeds its own limit.

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


@kernel
def lay(
    c: Any, oe: float, on: float, ou: float, de: float, dn: float, du: float,
    level: float, up: float, down: float, accel: float, accel_z: float, snap: float, jerk: float,
) -> None:  # fmt: skip
    """A leg from o to d, at rest at both ends (`SCurve::calculate_track`)."""
    clear(c)
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
    _lay_from_rest(c)
    c.live = 1


@kernel
def _lay_from_rest(c: Any) -> None:
    jm, tj, t2, t4, t6 = path_times(c.snap, c.jerk, 0.0, c.accel, c.speed, _ROOM * c.length)
    _set(c, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
    _seven(c, 1, jm, tj, t2, t4, t6)
    c.end_a[_ACCEL_END] = 0.0
    _empty(c, _ACCEL_END + 1, _CHANGE_END)
    left = c.length - 2.0 * c.end_p[_CHANGE_END]
    _level(c, _CONST, max(0.0, left / c.end_v[_CHANGE_END]), 0.0)
    _seven(c, _CONST + 1, -jm, tj, t6, t4, t2)
    c.end_a[_DECEL_END] = 0.0
    c.end_v[_DECEL_END] = 0.0
    c.at = 0


@kernel
def set_origin_speed(c: Any, speed: float) -> float:
    """Begin the leg at a speed; what it will really begin with (`set_origin_speed_max`)."""
    if c.live == 0:
        return 0.0
    if abs(c.end_v[0] - speed) < 1e-9:
        return speed
    top = c.end_v[_ACCEL_END]
    speed = min(speed, top)
    jm, tj, t2, t4, t6 = path_times(c.snap, c.jerk, speed, c.accel, top, _ROOM * c.length)
    _set(c, 0, 0.0, 0.0, 0.0, speed, 0.0)
    _seven(c, 1, jm, tj, t2, t4, t6)
    c.end_a[_ACCEL_END] = 0.0
    back = min(0.0, _ROOM * c.length - c.end_p[_ACCEL_END])
    earlier = back / c.end_v[_ACCEL_END] if c.end_v[_ACCEL_END] > 0.0 else 0.0
    for i in range(_ACCEL_END + 1):
        c.end_t[i] += earlier
        c.end_p[i] += back
    _empty(c, _ACCEL_END + 1, _CHANGE_END)
    _slow_down(c, 0.0, _ROOM * c.length)
    c.at = 0
    return speed


@kernel
def set_destination_speed(c: Any, speed: float) -> None:
    """End the leg at a speed (`set_destination_speed_max`)."""
    if c.live == 0 or abs(c.end_v[_DECEL_END] - speed) < 1e-9:
        return
    c.end_t[_CONST] = c.end_t[_CHANGE_END]
    _slow_down(c, min(speed, c.end_v[_CHANGE_END]), _ROOM * c.length)
    c.at = 0


@kernel
def set_speed(c: Any, level: float, up: float, down: float) -> None:
    """Another speed limit for a leg that may be under way (`set_speed_max`); ignored once it slows down."""
    if c.live == 0:
        return
    speed = kinematic_limit(c.unit[0], c.unit[1], c.unit[2], level, up, down)
    if abs(speed - c.speed) < 1e-9 or not speed > 0.0:
        return
    c.speed = speed
    if c.t >= c.end_t[_CONST]:
        return
    v_end = min(speed, c.end_v[_DECEL_END])
    if c.t == 0.0:
        v_start = min(speed, c.end_v[0])
        _lay_from_rest(c)
        set_origin_speed(c, v_start)
        set_destination_speed(c, v_end)
        return
    if c.end_t[_ACCEL_END] <= c.t <= c.end_t[_CHANGE_END]:
        # the change under way becomes the first one, which leaves room for another
        _set(c, 0, c.end_t[_ACCEL_END], 0.0, c.end_a[_ACCEL_END], c.end_v[_ACCEL_END], c.end_p[_ACCEL_END])
        for i in range(1, _ACCEL_END + 1):
            k = i + 7
            _set(c, i, c.end_t[k], c.jm[k], c.end_a[k], c.end_v[k], c.end_p[k])
    elif c.end_t[_CHANGE_END] < c.t <= c.end_t[_CONST]:
        done, now, _ = at(c, c.t)
        k = _CHANGE_END
        _set(c, 0, c.end_t[k], 0.0, 0.0, c.end_v[k], c.end_p[k])
        for i in range(1, _ACCEL_END + 1):
            _set(c, i, c.t, 0.0, 0.0, now, done)
    held = c.end_t[_ACCEL_MAX] - c.end_t[_ACCEL_MAX - 1]
    if c.t <= c.end_t[_ACCEL_MAX] and held > 0.0 and speed < c.end_v[_ACCEL_END] and c.end_a[_ACCEL_MAX] > 0.0:
        # still at its acceleration: shorten that as far as it is not over yet
        cut = c.end_t[_ACCEL_MAX] - max(c.t, c.end_t[_ACCEL_MAX - 1])
        least = max(c.end_v[_ACCEL_END] - c.end_a[_ACCEL_MAX] * cut, speed)
        jm, tj, t2, t4, t6 = path_times(c.snap, c.jerk, c.end_v[0], c.accel, least, _ROOM * c.length)
        _seven(c, 1, jm, tj, t2, t4, t6)
        c.end_a[_ACCEL_END] = 0.0
    _empty(c, _ACCEL_END + 1, _CHANGE_END)
    top = c.end_v[_ACCEL_END]
    if abs(speed - top) > 1e-9:
        length = c.end_p[_CONST] - c.end_p[_ACCEL_END]
        # the upstream source takes the power 1/3 of integers, which is 0: the first of the two is then 1
        rise = min(1.0, c.jerk * math.pi / (2.0 * c.snap))
        if speed < top and top > 0.0 and rise * 12.0 < length / top:
            jm, tj, t6, t4, t2 = path_times(c.snap, c.jerk, speed, c.accel, top, _ROOM * length)
            _seven(c, _ACCEL_END + 1, -jm, tj, t2, t4, t6)
        elif speed > top and length / (rise * 12.0) > top:
            most = min(speed, length / (rise * 12.0))
            jm, tj, t2, t4, t6 = path_times(c.snap, c.jerk, top, c.accel, most, _ROOM * length)
            _seven(c, _ACCEL_END + 1, jm, tj, t2, t4, t6)
        c.end_a[_CHANGE_END] = 0.0
    v_end = min(v_end, c.end_v[_CHANGE_END])
    _slow_down(c, v_end, c.length - c.end_p[_CHANGE_END])
    c.at = 0


@kernel
def at(c: Any, t: float) -> tuple[float, float, float]:
    """(distance from the origin, speed, acceleration) `t` seconds into the leg."""
    if c.live == 0:
        return 0.0, 0.0, 0.0
    i = c.at
    if i > 0 and t < c.end_t[i - 1]:
        i = 0
    while i < SEGMENTS and t >= c.end_t[i]:
        i += 1
    if i == 0:
        return c.end_p[0] + c.end_v[0] * (t - c.end_t[0]), c.end_v[0], 0.0
    k = i - 1
    a = c.end_a[k]
    v = c.end_v[k]
    p = c.end_p[k]
    s = t - c.end_t[k]
    if i == SEGMENTS:
        return p, v, 0.0
    c.at = i
    jm = c.jm[i]
    place = (i - 1) % 7 if i < _CONST else (i - 2) % 7
    if i == _CONST or place in (1, 3, 5):  # constant jerk
        return max(p + v * s + 0.5 * a * s * s + jm * s * s * s / 6.0, 0.0), v + a * s + 0.5 * jm * s * s, a + jm * s
    tj = c.end_t[i] - c.end_t[k]
    half = 0.5 * jm
    per = tj / math.pi
    if place in (2, 6):  # falling: the second half of the raised cosine, as if it had begun at rest
        p -= half * (tj * tj * tj / 6.0 - per * per * tj)
        v -= half * (0.5 * tj * tj - 2.0 * per * per)
        a -= half * tj
        moved = p + v * s + 0.5 * a * s * s
        gained = v + a * s
        s += tj
    else:
        moved = p + v * s + 0.5 * a * s * s
        gained = v + a * s
    sine = math.sin(s / per)
    cosine = math.cos(s / per)
    return (
        max(moved + half * (s * s * s / 6.0 - per * per * s + per * per * per * sine), 0.0),
        gained + half * (0.5 * s * s + per * per * (cosine - 1.0)),
        a + half * (s - per * sine),
    )


@kernel
def duration(c: Any) -> float:
    """Seconds from start to end; 0 of no leg."""
    return c.end_t[_DECEL_END] if c.live == 1 else 0.0


@kernel
def slows_at(c: Any) -> float:
    """When it begins to slow down."""
    return c.end_t[_CONST] if c.live == 1 else 0.0


@kernel
def fast_at(c: Any) -> float:
    """When it has reached its speed."""
    return c.end_t[_ACCEL_END] if c.live == 1 else 0.0


@kernel
def finished(c: Any) -> bool:
    """Whether it has been flown to its end."""
    return c.live == 0 or c.t >= c.end_t[_DECEL_END] or c.done >= c.length


@kernel
def copy(to: Any, c: Any) -> None:
    """Make one leg the same as another."""
    to.length, to.speed, to.accel, to.accel_z = c.length, c.speed, c.accel, c.accel_z
    to.jerk, to.snap, to.t, to.live, to.at, to.done = c.jerk, c.snap, c.t, c.live, c.at, c.done
    for axis in range(3):
        to.unit[axis] = c.unit[axis]
        to.origin[axis] = c.origin[axis]
    for i in range(SEGMENTS):
        _set(to, i, c.end_t[i], c.jm[i], c.end_a[i], c.end_v[i], c.end_p[i])
