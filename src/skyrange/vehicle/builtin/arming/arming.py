"""Arming and disarming, the automatic disarming on the ground, and the start of a take-off.

After ArduCopter/AP_Arming_Copter.cpp (`arm`, `arm_checks`, `disarm`) and ArduCopter/motors.cpp `auto_disarm_check`.
The pre-arm checks are in `arming.prearm`.
"""

from __future__ import annotations

import math

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NEVER, Time, from_seconds
from skyrange.vehicle.builtin import auto_rtl, fence, loop, prearm, sticks_in
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Stage, Timer
from skyrange.vehicle.builtin.layout import Control, Heading
from skyrange.vehicle.builtin.modes import PILOTED, Mode, armable

FORCE_ARM = 2989.0
FORCE = 21196.0
"""Magic numbers in param2 of MAV_CMD_COMPONENT_ARM_DISARM (GCS_Common.cpp): to force arming; to force either."""


def arm(fleet: Fleet, craft: Craft, checked: bool, causes: Causes) -> bool:
    """Arm if the checks pass, and return whether it is armed: home moves here, the motors idle.

    Without `checked` only the mandatory checks run.
    """
    if not prearm.passes(fleet, craft, not checked, causes):
        return False
    why = _refusal(fleet, craft) if checked else ""
    if why:
        fleet.text(craft, dialect.MAV_SEVERITY_CRITICAL, f"Arm: {why}", causes)
        return False
    if checked and fleet.param(craft, "ARMING_CHECK") == 0:
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, "Warning: Arming Checks Disabled", causes)
    row = craft.row
    flight = fleet.flight
    if not craft.home_locked:
        fleet.take_home(craft, fleet.position(craft))
    craft.armed_yaw = float(fleet.estimate["yaw"][craft.row])
    craft.ready = craft.mode == Mode.AUTO and bool(int(fleet.param(craft, "AUTO_OPTIONS")) & 2)
    flight["armed"][row] = 1
    fleet.watch["armed_up_m"][row], fleet.watch["crashed"][row] = fleet.estimate["pos"][row, 2], 0
    flight["landed"][row] = 1
    flight["control"][row] = PILOTED.get(craft.mode, Control.IDLE)
    flight["flags"][row] = flight["seen"][row] = 0
    fleet.limits(craft)
    fleet.timer(craft, Timer.IDLE, idle_end(fleet, craft))
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, "Arming motors", causes)
    fleet.note("event.armed", craft, {"forced": not checked}, causes)
    fence.on_arming(fleet, craft)
    return True


def _refusal(fleet: Fleet, craft: Craft) -> str:
    """Return why an aircraft that passes the pre-arm checks may not be armed (`arm_checks`), or ""."""
    if not armable(craft.shown_mode, int(fleet.param(craft, "AUTO_OPTIONS"))):
        return f"{Mode(craft.shown_mode).name} mode not armable"
    checks = int(fleet.param(craft, "ARMING_CHECK"))
    lean = math.hypot(float(fleet.estimate["roll"][craft.row]), float(fleet.estimate["pitch"][craft.row]))
    if checks & (prearm.Bit.ALL | prearm.Bit.INS) and lean > math.radians(fleet.param(craft, "ANGLE_MAX") * 0.01):
        return "Leaning"
    if checks & (prearm.Bit.ALL | prearm.Bit.RC) and sticks_in.too_high(fleet, craft):
        return "Throttle too high"
    return ""


def disarm(fleet: Fleet, craft: Craft, reason: str, causes: Causes) -> None:
    """Stop the motors, also in flight, and set the mission back to its start."""
    flight, row = fleet.flight, craft.row
    flight["armed"][row] = 0
    flight["landed"][row] = 1
    flight["control"][row] = Control.OFF
    flight["spool"][row] = 0.0
    flight["flags"][row] = flight["seen"][row] = 0
    craft.ready = False
    craft.stage = Stage.NONE
    craft.flown = None
    craft.in_landing = False
    craft.current = 0
    craft.jumps.clear()
    craft.do_next = 0
    craft.condition = (0, 0.0)
    craft.reached.clear()
    for timer in (Timer.HOLD, Timer.LANDED, Timer.IDLE, Timer.STALE, Timer.CONDITION):
        fleet.timer(craft, timer)
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, "Disarming motors", causes)
    fleet.note("event.disarmed", craft, {"reason": reason}, causes)
    auto_rtl.look(fleet, craft)
    fence.on_disarming(fleet, craft)


def idle_end(fleet: Fleet, craft: Craft) -> Time:
    """Return when an aircraft that stands armed from now on disarms automatically: after DISARM_DELAY, never for 0."""
    delay_s = fleet.param(craft, "DISARM_DELAY")
    return fleet.now + from_seconds(delay_s) if delay_s > 0 else NEVER


def take_off(fleet: Fleet, craft: Craft, up: float) -> None:
    """Climb to a height `up` (m above the origin) at the speeds in force: with spool-up on the ground, or in flight."""
    row, flight = craft.row, fleet.flight
    flight["flags"][row] = flight["seen"][row] = 0
    flight["target_pos"][row, 2] = up
    flight["heading"][row] = Heading.HOLD
    if flight["landed"][row]:
        flight["throttle"][row] = 0.0
        loop.rest(flight, row)
        fleet.timer(craft, Timer.IDLE)
    else:
        loop.hold(fleet.estimate, flight, row)
    flight["control"][row] = Control.TAKEOFF
