"""May the motors turn? Pre-arm checks, arming, disarming, and disarming by itself on the ground.

After ArduCopter/AP_Arming_Copter.cpp and ArduCopter/motors.cpp `auto_disarm_check`. The checks are few because what
can fail is little: there is no radio, battery or compass to fail here.
"""

from __future__ import annotations

import math

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NEVER, Time, from_seconds
from skyrange.vehicle.builtin import loop, sticks_in
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Stage, Timer
from skyrange.vehicle.builtin.layout import Control, Heading
from skyrange.vehicle.builtin.modes import PILOTED, Mode, armable

FORCE_ARM = 2989.0
FORCE = 21196.0
"""Magic numbers in param2 of MAV_CMD_COMPONENT_ARM_DISARM (GCS_Common.cpp): force arming; force either."""


def refusal(fleet: Fleet, craft: Craft) -> str:
    """Why the craft may not be armed now, in ArduCopter's words where it has some; "" where it may."""
    if not armable(craft.mode, int(fleet.param(craft, "AUTO_OPTIONS"))):
        return f"{Mode(craft.mode).name} mode not armable"
    row = craft.row
    here = fleet.estimate["pos"][row]
    if not (np.isfinite(here).all() and np.isfinite(fleet.estimate["vel"][row]).all()):
        return "Need Position Estimate"
    lean = math.hypot(float(fleet.estimate["roll"][row]), float(fleet.estimate["pitch"][row]))
    if lean > math.radians(fleet.param(craft, "ANGLE_MAX") * 0.01):
        return "Leaning"
    if craft.mode == Mode.AUTO and not craft.sees_mission:
        return "No mission loaded"
    if sticks_in.too_high(fleet, craft):
        return "Throttle too high"
    return ""


def arm(fleet: Fleet, craft: Craft, checked: bool, causes: Causes) -> bool:
    """Arm where the checks (if `checked`) allow it: home moves to where the craft stands, motors idle."""
    why = refusal(fleet, craft) if checked else ""
    if why:
        fleet.text(craft, dialect.MAV_SEVERITY_CRITICAL, f"Arm: {why}", causes)
        return False
    row = craft.row
    flight = fleet.flight
    craft.home = fleet.position(craft)
    craft.ready = craft.mode == Mode.AUTO and bool(int(fleet.param(craft, "AUTO_OPTIONS")) & 2)
    flight["armed"][row] = 1
    flight["landed"][row] = 1
    flight["control"][row] = PILOTED.get(craft.mode, Control.IDLE)
    flight["flags"][row] = flight["seen"][row] = 0
    fleet.limits(craft)
    fleet.timer(craft, Timer.IDLE, idle_end(fleet, craft))
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, "Arming motors", causes)
    fleet.note("event.armed", craft, {"forced": not checked}, causes)
    return True


def disarm(fleet: Fleet, craft: Craft, reason: str, causes: Causes) -> None:
    """Stop the motors, wherever the craft is, and put the mission back to its start."""
    flight, row = fleet.flight, craft.row
    flight["armed"][row] = 0
    flight["landed"][row] = 1
    flight["control"][row] = Control.OFF
    flight["flags"][row] = flight["seen"][row] = 0
    craft.ready = False
    craft.stage = Stage.NONE
    craft.flown = None
    craft.current = 0
    craft.jumps.clear()
    craft.do_next = 0
    craft.condition = (0, 0.0)
    craft.reached.clear()
    for timer in (Timer.HOLD, Timer.LANDED, Timer.IDLE, Timer.STALE, Timer.CONDITION):
        fleet.timer(craft, timer)
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, "Disarming motors", causes)
    fleet.note("event.disarmed", craft, {"reason": reason}, causes)


def idle_end(fleet: Fleet, craft: Craft) -> Time:
    """When a craft that stands armed from now on disarms by itself: DISARM_DELAY, never where that is 0."""
    delay_s = fleet.param(craft, "DISARM_DELAY")
    return fleet.now + from_seconds(delay_s) if delay_s > 0 else NEVER


def take_off(fleet: Fleet, craft: Craft, up: float) -> None:
    """Climb to a height (above the origin) from where it is, at the speeds in force: with spool-up, or in flight."""
    row, flight = craft.row, fleet.flight
    flight["flags"][row] = flight["seen"][row] = 0
    flight["target_pos"][row, 2] = up
    flight["heading"][row] = Heading.HOLD
    if flight["landed"][row]:
        flight["spool"][row] = 0.0
        flight["throttle"][row] = 0.0
        loop.rest(flight, row)
        fleet.timer(craft, Timer.IDLE)
    else:
        loop.hold(fleet.estimate, flight, row)
    flight["control"][row] = Control.TAKEOFF
