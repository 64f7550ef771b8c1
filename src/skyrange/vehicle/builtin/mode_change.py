"""Mode changes: when a mode may be entered, and what a flying aircraft does on entry.

The rules are those of `Copter::set_mode` (ArduCopter/mode.cpp) and each mode's `init`. A refused change sends a text
and changes nothing else. While disarmed, any mode may be chosen: arming checks it.
"""

from __future__ import annotations

from collections.abc import Callable

from skyrange.codec.mavlink import dialect
from skyrange.core.time import from_seconds
from skyrange.vehicle.builtin import (
    auto_rtl,
    facing,
    fence,
    landing_sequence,
    loop,
    navigator,
    position,
    returning,
    sticks_in,
    targets,
)
from skyrange.vehicle.builtin.arming import idle_end
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Stage, Timer
from skyrange.vehicle.builtin.layout import Control, Heading
from skyrange.vehicle.builtin.modes import MANUAL_THROTTLE, NEEDS_POSITION, PILOTED, Mode, known
from skyrange.vehicle.builtin.telemetry.table import message

_BRAKE_SPEED_Z_MPS = 2.5  # config.h BRAKE_MODE_SPEED_Z
_BRAKE_DECEL_MPS2 = 7.5  # config.h BRAKE_MODE_DECEL_RATE


def _refusal(fleet: Fleet, craft: Craft, mode: Mode) -> str:
    """Return why an armed aircraft may not enter a mode, or ""."""
    if mode in NEEDS_POSITION and not position.ok(fleet, craft):
        return "requires position"
    if craft.mode in MANUAL_THROTTLE and mode not in MANUAL_THROTTLE and not position.height_ok(fleet, craft):
        return "need alt estimate"
    if fence.holds_mode(fleet, craft):
        return "in fence recovery"
    if mode == Mode.AUTO:
        if not craft.sees_mission:
            return "init failed"
        if fleet.landed(craft) and not navigator.starts_with_takeoff(fleet, craft):
            fleet.text(craft, dialect.MAV_SEVERITY_CRITICAL, "Auto: Missing Takeoff Cmd")
            return "init failed"
    by_hand = mode in MANUAL_THROTTLE and craft.mode not in MANUAL_THROTTLE and fleet.landed(craft)
    if by_hand and sticks_in.thrust(fleet, craft) > 0.5 * fleet.param(craft, "MOT_THST_HOVER"):
        return "throttle too high"  # it must not jump off the ground (get_non_takeoff_throttle)
    return ""


def _enter_hold(fleet: Fleet, craft: Craft) -> None:
    loop.hold(fleet.estimate, fleet.flight, craft.row)
    fleet.limits(craft)
    facing.set_kind(fleet, craft, Heading.HOLD)
    fleet.fly(craft, Control.VELOCITY)


def _enter_brake(fleet: Fleet, craft: Craft) -> None:
    _enter_hold(fleet, craft)
    row = craft.row
    fleet.flight["accel_xy"][row] = _BRAKE_DECEL_MPS2
    fleet.flight["accel_z"][row] = _BRAKE_DECEL_MPS2
    fleet.flight["speed_up"][row] = _BRAKE_SPEED_Z_MPS
    fleet.flight["speed_down"][row] = _BRAKE_SPEED_Z_MPS


def _enter_land(fleet: Fleet, craft: Craft) -> None:
    _enter_hold(fleet, craft)
    craft.stage = Stage.LAND
    fleet.fly(craft, Control.LAND)
    fleet.flight["blind"][craft.row] = not position.ok(fleet, craft)


def _enter_pilot_mode(fleet: Fleet, craft: Craft) -> None:
    """Let the pilot's sticks take over from the present state."""
    control = PILOTED[craft.mode]
    row, flight = craft.row, fleet.flight
    pilot_limits(fleet, craft)
    facing.set_kind(fleet, craft, Heading.HOLD)
    if not fleet.landed(craft):
        loop.hold(fleet.estimate, flight, row)
        loop.loiter(fleet.estimate, flight, row)
    fleet.fly(craft, control)


def pilot_limits(fleet: Fleet, craft: Craft) -> None:
    """Set speed and acceleration limits to the PILOT and LOIT parameters (mode_loiter.cpp, mode_althold.cpp)."""
    row, flight = craft.row, fleet.flight
    fleet.limits(craft)
    up = fleet.param(craft, "PILOT_SPEED_UP") * 0.01
    flight["speed_up"][row] = up
    flight["speed_down"][row] = fleet.param(craft, "PILOT_SPEED_DN") * 0.01 or up
    flight["accel_z"][row] = fleet.param(craft, "PILOT_ACCEL_Z") * 0.01
    if craft.mode == Mode.LOITER:
        flight["accel_xy"][row] = fleet.param(craft, "LOIT_ACC_MAX") * 0.01


_ENTRY_ACTIONS: dict[Mode, Callable[[Fleet, Craft], None]] = {
    Mode.STABILIZE: _enter_pilot_mode,
    Mode.ALT_HOLD: _enter_pilot_mode,
    Mode.AUTO: _enter_hold,
    Mode.GUIDED: targets.halt,
    Mode.LOITER: _enter_pilot_mode,
    Mode.RTL: returning.start,
    Mode.LAND: _enter_land,
    Mode.BRAKE: _enter_brake,
}
"""What a flying aircraft does on entry; AUTO holds until its mission starts."""


def set_mode(fleet: Fleet, craft: Craft, number: int, reason: str, causes: Causes) -> bool:
    """Change the mode; `False` and a text where it is refused. The present mode again changes nothing.

    `reason` is ArduCopter's (AP_Vehicle/ModeReason.h), in lower case, as in `event.mode`.
    """
    if number == craft.shown_mode:
        craft.mode_reason = reason
        return True
    mode = known(number)
    if mode is Mode.AUTO_RTL:
        return _enter_auto_rtl(fleet, craft, reason, causes)
    if mode is None:
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, f"No such mode {number}", causes)
        return False
    armed = fleet.armed(craft)
    why = _refusal(fleet, craft, mode) if armed else ""
    if why:
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, f"Mode change to {mode.name} failed: {why}", causes)
        return False
    if craft.mode == Mode.AUTO:
        navigator.stop(fleet, craft)
    fleet.take_mode(craft, mode)
    craft.mode_causes = causes
    craft.mode_reason = reason
    craft.stage = Stage.NONE
    craft.paused, craft.beneath = False, ()
    sticks_in.place(fleet, craft)
    fleet.timer(craft, Timer.HOLD)
    fleet.timer(craft, Timer.STALE)
    fleet.note("event.mode", craft, {"mode": mode.name, "number": int(mode), "reason": str(reason)}, causes)
    fleet.send(craft, message(fleet, craft, dialect.MAVLINK_MSG_ID_HEARTBEAT), causes)  # at once (Copter::set_mode)
    fence.mode_changed(fleet, craft)
    if armed and not fleet.landed(craft):
        fleet.flight["blind"][craft.row] = 0
        _ENTRY_ACTIONS[mode](fleet, craft)
    elif armed:
        fleet.limits(craft)
        fleet.fly(craft, Control.IDLE)  # a take-off that has not left the ground is cancelled
        if mode in PILOTED:
            _enter_pilot_mode(fleet, craft)
        if mode == Mode.LAND:
            fleet.timer(craft, Timer.LANDED, fleet.now + from_seconds(fleet.param(craft, "MOT_SPOOL_TIME")))
        else:
            fleet.timer(craft, Timer.IDLE, idle_end(fleet, craft))
    if mode == Mode.AUTO:
        navigator.start_or_resume(fleet, craft)
    return True


def _enter_auto_rtl(fleet: Fleet, craft: Craft, reason: str, causes: Causes) -> bool:
    """Enter AUTO_RTL (`return_path_or_jump_to_landing_sequence_auto_RTL`)."""
    if landing_sequence.join(fleet, craft, causes):
        return _fly_landing_sequence(fleet, craft, reason, causes)
    _send_landing_refusal(fleet, craft, "No return path or landing sequence found", causes)
    return False


def start_landing(fleet: Fleet, craft: Craft, reason: str, causes: Causes) -> bool:
    """Jump to the nearest DO_LAND_START in any case (ModeAuto::jump_to_landing_sequence_auto_RTL)."""
    if landing_sequence.jump(fleet, craft, causes):
        return _fly_landing_sequence(fleet, craft, reason, causes)
    _send_landing_refusal(fleet, craft, "No landing sequence found", causes)
    return False


def _send_landing_refusal(fleet: Fleet, craft: Craft, why: str, causes: Causes) -> None:
    fleet.text(craft, dialect.MAV_SEVERITY_WARNING, f"Mode change to AUTO RTL failed: {why}", causes)


def _fly_landing_sequence(fleet: Fleet, craft: Craft, reason: str, causes: Causes) -> bool:
    """Fly the mission from its current item on, reported as AUTO_RTL (ModeAuto::enter_auto_rtl)."""
    if craft.mode != Mode.AUTO:
        craft.resumes = True
        if not set_mode(fleet, craft, Mode.AUTO, reason, causes):
            craft.resumes = False
            return False
    craft.mode_causes = causes
    auto_rtl.begin(fleet, craft, reason)
    auto_rtl.look(fleet, craft)
    return True
