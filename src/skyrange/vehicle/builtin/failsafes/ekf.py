"""EKF failsafe, dead reckoning and GNSS glitches: FS_EKF_…, FS_DR_….

After ArduCopter/ekf_check.cpp (`ekf_check`, `ekf_over_threshold`, `failsafe_ekf_event`, `failsafe_ekf_off_event`) and
ArduCopter/events.cpp (`gpsglitch_check`, `failsafe_deadreckon_check`), at 10 Hz.
"""

from __future__ import annotations

import math
from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.core.compiled import kernel
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin.arming import disarm
from skyrange.vehicle.builtin.failsafes.actions import act, land, should_disarm
from skyrange.vehicle.builtin.failsafes.alarms import Alarm
from skyrange.vehicle.builtin.fleet import Craft, Fleet
from skyrange.vehicle.builtin.modes import NEEDS_POSITION, Mode, known
from skyrange.vehicle.builtin.switching import set_mode

_BAD = int(Alarm.ESTIMATOR_BAD)
_GOOD = int(Alarm.ESTIMATOR_GOOD)
_GLITCH_STARTED = int(Alarm.GLITCH_STARTED)
_GLITCH_STOPPED = int(Alarm.GLITCH_STOPPED)
_STARTED = int(Alarm.RECKONING_STARTED)
_STOPPED = int(Alarm.RECKONING_STOPPED)
_OVER = int(Alarm.RECKONING_OVER)
_FAILSAFE = int(Alarm.RECKONING_FAILSAFE)
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


@kernel
def has_position(e: Any, f: Any, w: Any) -> bool:
    """`ekf_has_relative_position() || ekf_has_absolute_position()`."""
    reckons = w.reckoning == 1 and w.reckoning_over == 0
    absolute, relative = _ABS, _REL
    if f.armed == 0:
        absolute |= _PRED_ABS
        relative = _PRED_REL
    elif e.status & _CONST != 0:
        return False
    there: bool = e.status & absolute != 0 or (reckons and e.status & relative != 0)
    return there


@kernel
def _over_threshold(e: Any, p: Any, w: Any, dt_s: float) -> bool:
    """Two of compass, velocity and position over FS_EKF_THRESH, or velocity over twice that; filtered."""
    share = 1.0
    if p.FS_EKF_FILT > 0.0 and w.ekf_passed == 1:
        share = dt_s / (dt_s + 1.0 / (2.0 * math.pi * p.FS_EKF_FILT))
    w.vel_slow += (e.vel_ratio - w.vel_slow) * share
    w.pos_slow += (e.pos_ratio - w.pos_slow) * share
    most = p.FS_EKF_THRESH
    over = 1 if e.mag_ratio >= most else 0
    if w.vel_slow >= 2.0 * most:
        over += 2
    elif w.vel_slow >= most:
        over += 1
    return over >= 2 or (w.pos_slow >= most and over >= 1)


@kernel
def check_estimator(e: Any, f: Any, p: Any, w: Any, dt_s: float) -> int:
    """Check one aircraft: ten more bad checks than good ones raise the failsafe, as many good ones end it."""
    if e.status & _UNINITIALIZED != 0:
        return 0
    if p.FS_EKF_THRESH <= 0.0:
        w.ekf_count = 0
        w.ekf_bad = 0
        return _GOOD if w.ekf_lost == 1 else 0
    passed = not _over_threshold(e, p, w, dt_s) and has_position(e, f, w)
    if passed:
        w.ekf_passed = 1
    elif w.ekf_passed == 0:
        return 0
    if not passed:
        if w.ekf_bad == 0:
            w.ekf_count += 1
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


@kernel
def check_glitch(e: Any, w: Any) -> int:
    """Check one aircraft: whether the estimator begins or ceases to report a glitch."""
    now = 1 if e.status & _GLITCHING != 0 else 0
    if now == w.glitching:
        return 0
    w.glitching = now
    return _GLITCH_STARTED if now == 1 else _GLITCH_STOPPED


@kernel
def check_reckoning(e: Any, p: Any, w: Any, now_ns: int) -> int:
    """Check one aircraft: whether dead reckoning begins, ends, or has lasted for FS_DR_TIMEOUT."""
    alarms = 0
    active = 1 if e.dead_reckoning != 0 else 0
    if active != w.reckoning:
        w.reckoning = active
        if active == 1:
            w.reckoning_ns = now_ns
            alarms |= _STARTED
        else:
            w.reckoning_over = 0
            alarms |= _STOPPED
    if active == 1 and w.reckoning_over == 0 and (now_ns - w.reckoning_ns) * 1e-9 > p.FS_DR_TIMEOUT:
        w.reckoning_over = 1
        alarms |= _OVER
    if p.FS_DR_ENABLE <= 0:
        w.reckoning_lost = 0
    elif active != w.reckoning_lost:
        w.reckoning_lost = active
        if active == 1:
            alarms |= _FAILSAFE
    return alarms


def bad(fleet: Fleet, craft: Craft) -> None:
    """Report an invalid estimate, at most every 30 s, and leave modes that require a position."""
    row, watch = craft.row, fleet.watch
    if fleet.now - int(watch["ekf_warned_ns"][row]) > _WARNING_NS:
        fleet.text(craft, _CRITICAL, "EKF variance")
        watch["ekf_warned_ns"][row] = fleet.now
    watch["ekf_lost"][row] = 1
    fleet.note("event.ekf_failsafe", craft, {"on": True})
    if not fleet.armed(craft):
        return
    watch["ekf_told"][row] = 1
    action = int(fleet.param(craft, "FS_EKF_ACTION"))
    flight = fleet.flight
    by_position = craft.mode == Mode.LAND and not flight["blind"][row]
    if by_position and action != _REPORT_ONLY:
        flight["blind"][row] = 1  # LAND continues level, without a position (ModeLand::do_not_use_GPS)
    needed = craft.mode in NEEDS_POSITION or action == _LAND_ALWAYS
    if action == _REPORT_ONLY or by_position or not needed:
        fleet.text(craft, _CRITICAL, "EKF Failsafe")
        return
    alt_hold = action == _ALT_HOLD_ACTION and known(_ALT_HOLD) is not None
    if not (alt_hold and set_mode(fleet, craft, _ALT_HOLD, "ekf_failsafe", ())):
        land(fleet, craft, "ekf_failsafe")
    fleet.text(craft, _CRITICAL, f"EKF Failsafe: changed to {Mode(craft.mode).name} Mode")


def good(fleet: Fleet, craft: Craft) -> None:
    """Report that the estimate is valid again; the mode stays."""
    row, watch = craft.row, fleet.watch
    if not watch["ekf_lost"][row]:
        return
    watch["ekf_lost"][row] = 0
    fleet.note("event.ekf_failsafe", craft, {"on": False})
    if watch["ekf_told"][row]:
        watch["ekf_told"][row] = 0
        fleet.text(craft, _CRITICAL, "EKF Failsafe Cleared")


def glitch_started(fleet: Fleet, craft: Craft) -> None:
    """Report that the estimator rejects GNSS."""
    fleet.text(craft, _CRITICAL, "GPS Glitch or Compass error")
    fleet.note("event.glitch", craft, {"on": True})


def glitch_stopped(fleet: Fleet, craft: Craft) -> None:
    """Report that the estimator accepts GNSS again."""
    fleet.text(craft, _CRITICAL, "Glitch cleared")
    fleet.note("event.glitch", craft, {"on": False})


def reckoning_started(fleet: Fleet, craft: Craft) -> None:
    """Report that the position is extrapolated."""
    fleet.text(craft, _CRITICAL, "Dead Reckoning started")


def reckoning_stopped(fleet: Fleet, craft: Craft) -> None:
    """Report that the position is measured again, or lost."""
    fleet.text(craft, _CRITICAL, "Dead Reckoning stopped")


def reckoning_over(fleet: Fleet, craft: Craft) -> None:
    """Report that dead reckoning has lasted too long: the position is invalid, which the EKF check detects."""
    fleet.text(craft, _CRITICAL, "Dead Reckoning timeout")


def reckoning_failsafe(fleet: Fleet, craft: Craft) -> None:
    """Execute the action of FS_DR_ENABLE in modes that require a position."""
    if craft.mode not in NEEDS_POSITION:
        return
    if should_disarm(fleet, craft):
        if fleet.armed(craft):
            disarm(fleet, craft, "deadreckon_failsafe", ())
        return
    act(fleet, craft, int(fleet.param(craft, "FS_DR_ENABLE")), "deadreckon_failsafe")
