"""EKF failsafe, dead reckoning and GNSS glitches: FS_EKF_…, FS_DR_….

After ArduCopter/ekf_check.cpp (`ekf_check`, `ekf_over_threshold`, `failsafe_ekf_event`, `failsafe_ekf_off_event`) and
ArduCopter/events.cpp (`gpsglitch_check`, `failsafe_deadreckon_check`), at 10 Hz.
"""

from __future__ import annotations

import math
from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.failsafes.actions import (
    Alarm,
    do_failsafe_action,
    set_mode_land_with_pause,
    should_disarm,
)
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.mode_change import set_mode
from skyrange.vehicle.builtin.modes import REQUIRES_POSITION, Mode, mode_of

_BAD = int(Alarm.ESTIMATOR_BAD)
_GOOD = int(Alarm.ESTIMATOR_GOOD)
_GLITCH_STARTED = int(Alarm.GLITCH_STARTED)
_GLITCH_STOPPED = int(Alarm.GLITCH_STOPPED)
_STARTED = int(Alarm.DEAD_RECKONING_STARTED)
_STOPPED = int(Alarm.DEAD_RECKONING_STOPPED)
_OVER = int(Alarm.DEAD_RECKONING_TIMEOUT)
_FAILSAFE = int(Alarm.DEAD_RECKONING_FAILSAFE)
_ITERATIONS = 10  # EKF_CHECK_ITERATIONS_MAX
_WARNING_NS = 30 * NS_PER_S  # EKF_CHECK_WARNING_TIME
_ABS = int(dialect.EKF_POS_HORIZ_ABS)
_REL = int(dialect.EKF_POS_HORIZ_REL)
_PRED_ABS = int(dialect.EKF_PRED_POS_HORIZ_ABS)
_PRED_REL = int(dialect.EKF_PRED_POS_HORIZ_REL)
_CONST = int(dialect.EKF_CONST_POS_MODE)
_UNINITIALIZED = int(dialect.EKF_UNINITIALIZED)
_GLITCHING = int(dialect.EKF_GPS_GLITCHING)
_CRITICAL = dialect.MAV_SEVERITY_CRITICAL

_REPORT_ONLY = 0
_ALT_HOLD_ACTION = 2
_LAND_ALWAYS = 3
_ALT_HOLD: Final = 2
"""Mode::Number::ALT_HOLD."""


@compiled
def has_position(e: Any, f: Any, w: Any) -> bool:
    """`ekf_has_relative_position() || ekf_has_absolute_position()`."""
    reckons = w.dr_active == 1 and w.dr_timed_out == 0
    absolute, relative = _ABS, _REL
    if f.armed == 0:
        absolute |= _PRED_ABS
        relative = _PRED_REL
    elif e.status & _CONST != 0:
        return False
    there: bool = e.status & absolute != 0 or (reckons and e.status & relative != 0)
    return there


@compiled
def _over_threshold(e: Any, p: Any, w: Any, dt_s: float) -> bool:
    """Two of compass, velocity and position over FS_EKF_THRESH, or velocity over twice that; filtered."""
    share = 1.0
    if p.FS_EKF_FILT > 0.0 and w.ekf_passed == 1:
        share = dt_s / (dt_s + 1.0 / (2.0 * math.pi * p.FS_EKF_FILT))
    w.vel_ratio_filt += (e.vel_ratio - w.vel_ratio_filt) * share
    w.pos_ratio_filt += (e.pos_ratio - w.pos_ratio_filt) * share
    most = p.FS_EKF_THRESH
    over = 1 if e.mag_ratio >= most else 0
    if w.vel_ratio_filt >= 2.0 * most:
        over += 2
    elif w.vel_ratio_filt >= most:
        over += 1
    return over >= 2 or (w.pos_ratio_filt >= most and over >= 1)


@compiled
def check_ekf(e: Any, f: Any, p: Any, w: Any, dt_s: float) -> int:
    """Check one aircraft: ten more bad checks than good ones raise the failsafe, as many good ones end it."""
    if e.status & _UNINITIALIZED != 0:
        return 0
    if p.FS_EKF_THRESH <= 0.0:
        w.ekf_count = 0
        w.ekf_bad = 0
        return _GOOD if w.ekf_failsafe == 1 else 0
    over = _over_threshold(e, p, w, dt_s)
    passed = not over and has_position(e, f, w)
    if passed:
        w.ekf_passed = 1
    elif w.ekf_passed == 0:
        return 0
    if not passed:
        if w.ekf_bad == 0:
            w.ekf_count += 1
            if w.ekf_count == _ITERATIONS - 2 and over:
                e.yaw_reset = 1
            if w.ekf_count >= _ITERATIONS:
                w.ekf_count = _ITERATIONS
                w.ekf_bad = 1
                return _BAD
    elif w.ekf_count > 0:
        w.ekf_count -= 1
        if w.ekf_bad == 1 and w.ekf_count == 0:
            w.ekf_bad = 0
            return _GOOD
    return 0


@compiled
def check_glitch(e: Any, w: Any) -> int:
    """Check one aircraft: whether the estimator begins or ceases to report a glitch."""
    now = 1 if e.status & _GLITCHING != 0 else 0
    if now == w.glitching:
        return 0
    w.glitching = now
    return _GLITCH_STARTED if now == 1 else _GLITCH_STOPPED


@compiled
def check_dead_reckoning(e: Any, p: Any, w: Any, now_ns: int) -> int:
    """Check one aircraft: whether dead reckoning begins, ends, or has lasted for FS_DR_TIMEOUT."""
    alarms = 0
    active = 1 if e.dead_reckoning != 0 else 0
    if active != w.dr_active:
        w.dr_active = active
        if active == 1:
            w.dr_started_ns = now_ns
            alarms |= _STARTED
        else:
            w.dr_timed_out = 0
            alarms |= _STOPPED
    if active == 1 and w.dr_timed_out == 0 and (now_ns - w.dr_started_ns) * 1e-9 > p.FS_DR_TIMEOUT:
        w.dr_timed_out = 1
        alarms |= _OVER
    if p.FS_DR_ENABLE <= 0:
        w.dr_failsafe = 0
    elif active != w.dr_failsafe:
        w.dr_failsafe = active
        if active == 1:
            alarms |= _FAILSAFE
    return alarms


def on_ekf_bad(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report an invalid estimate, at most every 30 s, and leave modes that require a position."""
    row, watch = vehicle.row, fleet.checks
    if fleet.now - int(watch["ekf_warned_ns"][row]) > _WARNING_NS:
        fleet.send_text(vehicle, _CRITICAL, "EKF variance")
        watch["ekf_warned_ns"][row] = fleet.now
    watch["ekf_failsafe"][row] = 1
    fleet.note("event.ekf_failsafe", vehicle, {"on": True})
    if not fleet.armed(vehicle):
        return
    watch["ekf_reported"][row] = 1
    action = int(fleet.param(vehicle, "FS_EKF_ACTION"))
    flight = fleet.flight
    by_position = vehicle.mode == Mode.LAND and not flight["land_nogps"][row]
    if by_position and action != _REPORT_ONLY:
        flight["land_nogps"][row] = 1  # LAND continues level, without a position (ModeLand::do_not_use_GPS)
    needed = vehicle.mode in REQUIRES_POSITION or action == _LAND_ALWAYS
    if action == _REPORT_ONLY or by_position or not needed:
        fleet.send_text(vehicle, _CRITICAL, "EKF Failsafe")
        return
    alt_hold = action == _ALT_HOLD_ACTION and mode_of(_ALT_HOLD) is not None
    if not (alt_hold and set_mode(fleet, vehicle, _ALT_HOLD, "ekf_failsafe", ())):
        set_mode_land_with_pause(fleet, vehicle, "ekf_failsafe")
    fleet.send_text(vehicle, _CRITICAL, f"EKF Failsafe: changed to {Mode(vehicle.mode).name} Mode")


def on_ekf_good(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report that the estimate is valid again; the mode stays."""
    row, watch = vehicle.row, fleet.checks
    if not watch["ekf_failsafe"][row]:
        return
    watch["ekf_failsafe"][row] = 0
    fleet.note("event.ekf_failsafe", vehicle, {"on": False})
    if watch["ekf_reported"][row]:
        watch["ekf_reported"][row] = 0
        fleet.send_text(vehicle, _CRITICAL, "EKF Failsafe Cleared")


def on_glitch_started(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report that the estimator rejects GNSS."""
    fleet.send_text(vehicle, _CRITICAL, "GPS Glitch or Compass error")
    fleet.note("event.glitch", vehicle, {"on": True})


def on_glitch_stopped(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report that the estimator accepts GNSS again."""
    fleet.send_text(vehicle, _CRITICAL, "Glitch cleared")
    fleet.note("event.glitch", vehicle, {"on": False})


def on_dead_reckoning_started(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report that the position is extrapolated."""
    fleet.send_text(vehicle, _CRITICAL, "Dead Reckoning started")


def on_dead_reckoning_stopped(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report that the position is measured again, or lost."""
    fleet.send_text(vehicle, _CRITICAL, "Dead Reckoning stopped")


def on_dead_reckoning_timeout(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report that dead reckoning has lasted too long: the position is invalid, which the EKF check detects."""
    fleet.send_text(vehicle, _CRITICAL, "Dead Reckoning timeout")


def on_dead_reckoning_failsafe(fleet: Fleet, vehicle: Vehicle) -> None:
    """Execute the action of FS_DR_ENABLE in modes that require a position."""
    if vehicle.mode not in REQUIRES_POSITION:
        return
    if should_disarm(fleet, vehicle):
        if fleet.armed(vehicle):
            disarm(fleet, vehicle, "deadreckon_failsafe", ())
        return
    do_failsafe_action(fleet, vehicle, int(fleet.param(vehicle, "FS_DR_ENABLE")), "deadreckon_failsafe")
