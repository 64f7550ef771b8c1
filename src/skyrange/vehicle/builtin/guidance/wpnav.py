"""Waypoint navigation: straight and curved legs, joined at corners (AC_WPNav).

After libraries/AC_WPNav/AC_WPNav.cpp (`wp_and_spline_init_cm`, `set_wp_destination_NEU_cm`,
`set_wp_destination_next_NEU_cm`, `set_spline_destination_…`, `advance_wp_target_along_track`) and
`SCurve::advance_target_along_track`: the end of one leg and the start of the next are added where the middle of the
turn stays inside WPNAV_RADIUS and within the accelerations.
"""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.control.gains import GRAVITY_MPS2
from skyrange.vehicle.builtin.control.shaping import clamp, limit_xy, stopping_distance
from skyrange.vehicle.builtin.guidance import scurve, spline
from skyrange.vehicle.builtin.layout import ControlMode, FlightEvent, Records

_LEG = int(ControlMode.LEG)
_ATTITUDE = int(ControlMode.ATTITUDE)
_STABILIZE = int(ControlMode.STABILIZE)
_DESTINATION_REACHED = int(FlightEvent.DESTINATION_REACHED)
_CDEG = math.pi / 18_000.0
# AC_PosControl.cpp POSCONTROL_STOPPING_DIST_{UP,DOWN}_MAX_M
_MAX_STOP_UP_M = 3.0
_MAX_STOP_DOWN_M = 2.0


@compiled
def stopping_point(e: Any, f: Any, p: Any) -> tuple[float, float, float]:
    """Return where the aircraft comes to rest if it brakes now (AC_PosControl::get_stopping_point_…)."""
    speed = math.sqrt(e.vel[0] * e.vel[0] + e.vel[1] * e.vel[1])
    ahead_s = 0.0
    if speed > 1e-9:
        ahead_s = stopping_distance(min(speed, f.speed_xy), p.PSC_POSXY_P, f.accel_xy) / speed
    rise = clamp(stopping_distance(e.vel[2], p.PSC_POSZ_P, f.accel_z), -_MAX_STOP_DOWN_M, _MAX_STOP_UP_M)
    return e.pos[0] + e.vel[0] * ahead_s, e.pos[1] + e.vel[1] * ahead_s, e.pos[2] + rise


@compiled
def _init_controllers(e: Any, f: Any, p: Any) -> None:
    """Let the integrals request what is requested now (AC_PosControl `init_NE_controller`, `init_U_controller`).

    The errors of velocity start from 0: at the stopping point the velocity is the one that is wanted.
    """
    if f.control == _ATTITUDE or f.control >= _STABILIZE:  # no position was controlled: the lean is what is requested
        q = f.att_target
        upward = max(1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]), 0.1)
        acc_e = GRAVITY_MPS2 * 2.0 * (q[1] * q[3] + q[0] * q[2]) / upward
        acc_n = GRAVITY_MPS2 * 2.0 * (q[2] * q[3] - q[0] * q[1]) / upward
    else:
        acc_e = p.PSC_VELXY_P * f.vel_err[0] + f.vel_i[0] + p.PSC_VELXY_D * f.vel_d[0] + f.ref_acc[0]
        acc_n = p.PSC_VELXY_P * f.vel_err[1] + f.vel_i[1] + p.PSC_VELXY_D * f.vel_d[1] + f.ref_acc[1]
    most = min(GRAVITY_MPS2 * elementary.tan(p.ANGLE_MAX * _CDEG), p.PSC_VELXY_IMAX * 0.01)
    f.vel_i[0], f.vel_i[1] = limit_xy(acc_e, acc_n, most)
    for axis in range(2):
        f.vel_err[axis] = 0.0
        f.vel_d[axis] = 0.0
    f.climb_err = 0.0
    f.accel_err = -e.accel[2]
    f.throttle_i = f.throttle - p.MOT_THST_HOVER


@compiled
def wp_init(e: Any, f: Any, w: Any, p: Any) -> None:
    """Reset all legs; the destination reached is the stopping point (`wp_and_spline_init_cm`)."""
    _init_controllers(e, f, p)
    for c in (w.prev_leg, w.this_leg, w.next_leg):
        scurve.clear_leg(c)
    stop = stopping_point(e, f, p)
    for axis in range(3):
        w.origin[axis] = stop[axis]
        w.destination[axis] = stop[axis]
        f.ref_pos[axis] = stop[axis]
        f.ref_vel[axis] = 0.0
        f.ref_acc[axis] = 0.0
        f.target_pos[axis] = stop[axis]
    w.this_leg_is_spline = 0
    w.next_leg_is_spline = 0
    w.fast_waypoint = 0
    w.reached_destination = 1
    f.track_lag = 0.0
    f.speed_changed = 0
    f.control = _LEG


@compiled
def _calculate_scurve(f: Any, p: Any, c: Any, o: Any, de: float, dn: float, du: float) -> None:  # noqa: PLR0917
    """Compute a straight leg from a point within the limits in force (`calc_scurve_jerk_and_snap`)."""
    jerk = p.WPNAV_JERK
    snap = jerk * math.pi / (2.0 * max(p.ATC_INPUT_TC, 0.1))
    snap = min(snap, min(p.ATC_ACCEL_R_MAX, p.ATC_ACCEL_P_MAX) * _CDEG * GRAVITY_MPS2)
    scurve.calculate_track(
        c, o[0], o[1], o[2], de, dn, du, f.speed_xy, f.speed_up, f.speed_down, f.accel_xy, f.accel_z, 0.5 * snap, jerk
    )


@compiled
def _init_unless_active(e: Any, f: Any, w: Any, p: Any) -> None:
    if w.reached_destination == 0 or f.control != _LEG:
        wp_init(e, f, w, p)
    f.control = _LEG
    f.flags &= ~_DESTINATION_REACHED
    f.handled_flags &= ~_DESTINATION_REACHED


@compiled
def _set_destination(w: Any, f: Any, de: float, dn: float, du: float) -> None:
    w.destination[0], w.destination[1], w.destination[2] = de, dn, du
    f.target_pos[0], f.target_pos[1], f.target_pos[2] = de, dn, du
    w.reached_destination = 0


@compiled
def set_wp_destination(e: Any, f: Any, w: Any, p: Any, de: float, dn: float, du: float) -> None:  # noqa: PLR0917
    """Fly to a point from the destination reached, or from the stopping point."""
    _init_unless_active(e, f, w, p)
    scurve.clear_leg(w.prev_leg)
    from_speed = 0.0
    if w.this_leg_is_spline == 1:
        from_speed = math.sqrt(f.ref_vel[0] ** 2 + f.ref_vel[1] ** 2 + f.ref_vel[2] ** 2)
    else:
        scurve.copy_leg(w.prev_leg, w.this_leg)
    for axis in range(3):
        w.origin[axis] = w.destination[axis]
    if (
        w.fast_waypoint == 1
        and w.this_leg_is_spline == 0
        and w.next_leg_is_spline == 0
        and w.next_leg.active == 1
        and not scurve.finished(w.next_leg)
    ):
        # ArduPilot does not compare where it leads
        scurve.copy_leg(w.this_leg, w.next_leg)
    else:
        _calculate_scurve(f, p, w.this_leg, w.origin, de, dn, du)
        if from_speed > 0.0:
            scurve.set_origin_speed_max(w.this_leg, from_speed)
    _set_destination(w, f, de, dn, du)
    w.this_leg_is_spline = 0
    w.next_leg_is_spline = 0
    scurve.clear_leg(w.next_leg)
    w.fast_waypoint = 0


@compiled
def set_wp_destination_next(f: Any, w: Any, p: Any, de: float, dn: float, du: float) -> None:
    """Let a straight leg to a point follow this leg without a stop."""
    _calculate_scurve(f, p, w.next_leg, w.destination, de, dn, du)
    if w.this_leg_is_spline == 1:
        w.this_spline.to_speed = min(
            w.this_spline.to_speed, scurve.set_origin_speed_max(w.next_leg, w.this_spline.to_speed)
        )
    w.next_leg_is_spline = 0
    w.fast_waypoint = 1


@compiled
def set_spline_destination(e: Any, f: Any, w: Any, p: Any, goal: Any, after: Any, after_curved: bool) -> None:  # noqa: FBT001, PLR0917
    """Fly to a point on a curve that departs towards `after`; it stops there if `after` is the same point."""
    _init_unless_active(e, f, w, p)
    leave = (0.0, 0.0, 0.0)
    if w.fast_waypoint == 1:
        if w.this_leg_is_spline == 1:
            leave = (w.this_spline.leave[0], w.this_spline.leave[1], w.this_spline.leave[2])
        else:
            leave = (w.destination[0] - w.origin[0], w.destination[1] - w.origin[1], w.destination[2] - w.origin[2])
    for axis in range(3):
        w.origin[axis] = w.destination[axis]
    # numbers, not arrays: numba cannot unify a record's field and a separate array in one type
    x, y, z = goal[0], goal[1], goal[2]
    if after_curved:
        x, y, z = w.origin[0], w.origin[1], w.origin[2]
    arrive = (after[0] - x, after[1] - y, after[2] - z)
    spline.set_origin_and_destination(
        w.this_spline, f, w.origin[0], w.origin[1], w.origin[2], goal[0], goal[1], goal[2],
        leave[0], leave[1], leave[2], arrive[0], arrive[1], arrive[2],
    )  # fmt: skip
    w.fast_waypoint = 0 if arrive[0] == 0.0 and arrive[1] == 0.0 and arrive[2] == 0.0 else 1
    _set_destination(w, f, goal[0], goal[1], goal[2])
    w.this_leg_is_spline = 1
    w.next_leg_is_spline = 0
    scurve.clear_leg(w.next_leg)


@compiled
def set_spline_destination_next(f: Any, w: Any, goal: Any, after: Any, after_curved: bool) -> None:  # noqa: FBT001
    """Let a curve to a point, departing towards `after`, follow this leg; end this leg at the curve's initial speed."""
    if w.this_leg_is_spline == 1:
        leave = (w.this_spline.leave[0], w.this_spline.leave[1], w.this_spline.leave[2])
    else:
        leave = (w.destination[0] - w.origin[0], w.destination[1] - w.origin[1], w.destination[2] - w.origin[2])
    x, y, z = goal[0], goal[1], goal[2]
    if after_curved:
        x, y, z = w.destination[0], w.destination[1], w.destination[2]
    spline.set_origin_and_destination(
        w.next_spline, f, w.destination[0], w.destination[1], w.destination[2], goal[0], goal[1], goal[2],
        leave[0], leave[1], leave[2], after[0] - x, after[1] - y, after[2] - z,
    )  # fmt: skip
    w.next_leg_is_spline = 1
    w.fast_waypoint = 1
    if w.this_leg_is_spline == 1:
        w.this_spline.to_speed = min(w.this_spline.to_speed, w.next_spline.from_speed)
    else:
        scurve.set_destination_speed_max(w.this_leg, w.next_spline.from_speed)


@compiled
def _track_dt(e: Any, f: Any, p: Any, dt_s: float) -> float:
    """Return how far to advance along the track in a step: less where the aircraft lags, as in strong wind.

    `_track_dt_scalar` (advance_wp_target_along_track): with a margin of 5 %, and a time constant of acceleration
    over jerk. Speed and acceleration of the reference are not scaled. The position error is that of the last step, as
    `get_pos_error_NEU_cm` has it: the reference has not moved since, and the aircraft has.
    """
    wanted = 1.0
    speed = math.sqrt(f.ref_vel[0] ** 2 + f.ref_vel[1] ** 2 + f.ref_vel[2] ** 2)
    if speed > spline.STILL_MPS:
        per = 1.0 / (speed * speed)
        ahead = 0.0
        made = 0.0
        for axis in range(3):
            ahead += (f.ref_pos[axis] - (e.pos[axis] - e.vel[axis] * dt_s)) * f.ref_vel[axis]
            made += e.vel[axis] * f.ref_vel[axis]
        wanted = clamp(0.05 + (made - p.PSC_POSXY_P * ahead) * per, 0.0, 1.0)
    f.track_lag += (1.0 - wanted - f.track_lag) * min(1.0, dt_s * p.WPNAV_JERK / f.accel_xy)
    scaled: float = dt_s * (1.0 - f.track_lag)
    return scaled


@compiled
def _add_motion(f: Any, c: Any, t: float) -> float:
    """Add a leg's motion at a time to the reference; return the distance along the leg."""
    s, v, a = scurve.motion_at(c, t)
    for axis in range(3):
        f.ref_pos[axis] += c.unit[axis] * s
        f.ref_vel[axis] += c.unit[axis] * v
        f.ref_acc[axis] += c.unit[axis] * a
    return s


@compiled
def _advance_leg(f: Any, c: Any, dt_s: float) -> None:
    c.t = min(c.t + dt_s, scurve.duration(c))
    c.done = _add_motion(f, c, c.t)


@compiled
def _corner_within_limits(f: Any, w: Any, p: Any) -> bool:
    """Whether the middle of a turn onto the next leg, begun now, keeps within radius, speed and accelerations."""
    half = 0.5 * (scurve.duration(w.this_leg) - w.this_leg.t)
    s, v, a = scurve.motion_at(w.this_leg, w.this_leg.t + half)
    s2, v2, a2 = scurve.motion_at(w.next_leg, half)
    off = 0.0
    speed = 0.0
    level = 0.0
    upward = 0.0
    for axis in range(3):
        place = w.this_leg.unit[axis] * (s - w.this_leg.length) + w.next_leg.unit[axis] * s2
        moving = w.this_leg.unit[axis] * v + w.next_leg.unit[axis] * v2
        turning = w.this_leg.unit[axis] * a + w.next_leg.unit[axis] * a2
        off += place * place
        speed += moving * moving
        if axis < 2:
            level += turning * turning
        else:
            upward = abs(turning)
    radius = p.WPNAV_RADIUS * 0.01
    corner = p.WPNAV_ACCEL_C * 0.01 if p.WPNAV_ACCEL_C > 0.0 else 2.0 * p.WPNAV_ACCEL * 0.01
    # the next leg has not begun, yet ArduPilot compares with its speed limit too
    least = min(w.this_leg.speed, w.next_leg.speed)
    return bool(
        off < radius * radius
        and speed < least * least
        and level < corner * corner
        and upward < min(w.this_leg.accel_z, w.next_leg.accel_z)
    )


@compiled
def advance_along_track(e: Any, f: Any, w: Any, p: Any, dt_s: float) -> None:
    """Advance the reference along the legs; raise DESTINATION_REACHED once."""
    if f.speed_changed == 1:
        f.speed_changed = 0
        scurve.set_speed_max(w.this_leg, f.speed_xy, f.speed_up, f.speed_down)
        scurve.set_speed_max(w.next_leg, f.speed_xy, f.speed_up, f.speed_down)
    step_s = _track_dt(e, f, p, dt_s)
    if w.this_leg_is_spline == 1:
        spline.advance_target_along_track(w.this_spline, f, step_s)
        for axis in range(3):
            f.ref_acc[axis] = 0.0
        done = w.this_spline.reached == 1
    else:
        for axis in range(3):
            f.ref_pos[axis] = w.origin[axis] - w.prev_leg.unit[axis] * w.prev_leg.length
            f.ref_vel[axis] = 0.0
            f.ref_acc[axis] = 0.0
        if w.prev_leg.active == 1:
            _advance_leg(f, w.prev_leg, step_s)
        _advance_leg(f, w.this_leg, step_s)
        done = scurve.finished(w.this_leg)
        left = scurve.duration(w.this_leg) - w.this_leg.t
        if w.fast_waypoint == 1 and w.next_leg_is_spline == 0 and w.next_leg.t == 0.0:
            if (
                w.this_leg.t >= scurve.decel_start_time(w.this_leg)
                and left <= scurve.accel_end_time(w.next_leg)
                and _corner_within_limits(f, w, p)
            ):
                _advance_leg(f, w.next_leg, step_s)
        elif w.next_leg.t > 0.0:
            _advance_leg(f, w.next_leg, step_s)
            done = done or w.next_leg.t >= left
    if w.reached_destination == 1 or not done:
        return
    if w.fast_waypoint == 0:
        radius = p.WPNAV_RADIUS * 0.01
        off = 0.0
        for axis in range(3):
            away = e.pos[axis] - w.destination[axis]
            off += away * away
        if off > radius * radius:
            return
    w.reached_destination = 1
    f.flags |= _DESTINATION_REACHED


@compiled
def begin_at(
    estimate: Records, flight: Records, legs: Records, settings: Records, row: int, place: NDArray[Any]
) -> None:
    """Call `wp_init` for one row, with legs that begin at a point instead of the stopping point."""
    wp_init(estimate[row], flight[row], legs[row], settings[row])
    for axis in range(3):
        legs[row].origin[axis] = place[axis]
        legs[row].destination[axis] = place[axis]
        flight[row].target_pos[axis] = place[axis]


@compiled
def start_leg(  # noqa: PLR0917
    estimate: Records,
    flight: Records,
    legs: Records,
    settings: Records,
    row: int,
    goal: NDArray[Any],
    anew: bool,  # noqa: FBT001
) -> None:
    """Call `set_wp_destination` for one row; with `anew`, from the stopping point, whatever it flies."""
    if anew:
        wp_init(estimate[row], flight[row], legs[row], settings[row])
    set_wp_destination(estimate[row], flight[row], legs[row], settings[row], goal[0], goal[1], goal[2])


@compiled
def queue_leg(flight: Records, legs: Records, settings: Records, row: int, goal: NDArray[Any]) -> None:
    """Call `set_wp_destination_next` for one row."""
    set_wp_destination_next(flight[row], legs[row], settings[row], goal[0], goal[1], goal[2])


@compiled
def start_spline(  # noqa: PLR0917
    estimate: Records, flight: Records, legs: Records, settings: Records, row: int,
    goal: NDArray[Any], after: NDArray[Any], after_curved: bool,  # noqa: FBT001
) -> None:  # fmt: skip
    """Call `set_spline_destination` for one row."""
    set_spline_destination(estimate[row], flight[row], legs[row], settings[row], goal, after, after_curved)


@compiled
def queue_spline(
    flight: Records,
    legs: Records,
    row: int,
    goal: NDArray[Any],
    after: NDArray[Any],
    curved: bool,  # noqa: FBT001
) -> None:
    """Call `set_spline_destination_next` for one row."""
    set_spline_destination_next(flight[row], legs[row], goal, after, curved)


@compiled
def stopping_point_of(estimate: Records, flight: Records, settings: Records, row: int) -> tuple[float, float, float]:
    """Return `stopping_point` of one row."""
    return stopping_point(estimate[row], flight[row], settings[row])
