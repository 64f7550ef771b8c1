"""Arming and disarming, the automatic disarming on the ground, and the start of a take-off.

After ArduCopter/AP_Arming_Copter.cpp (`arm`, `arm_checks`, `disarm`) and ArduCopter/motors.cpp `auto_disarm_check`.
The pre-arm checks are in `arming.prearm`.
"""

from __future__ import annotations

import math

from skyrange.codec.mavlink import dialect
from skyrange.core import elementary
from skyrange.core.time import NEVER, Time, from_seconds
from skyrange.vehicle.builtin import fence, loop, pilot
from skyrange.vehicle.builtin.arming import prearm
from skyrange.vehicle.builtin.fleet import Causes, Fleet, SubMode, Timer, Vehicle
from skyrange.vehicle.builtin.flight_modes import auto_rtl
from skyrange.vehicle.builtin.layout import AutoYawMode, ControlMode
from skyrange.vehicle.builtin.log_events import log_arming, log_disarming
from skyrange.vehicle.builtin.modes import PILOT_CONTROLS, Mode, allows_arming

MAGIC_FORCE_ARM = 2989.0
MAGIC_FORCE_ARM_DISARM = 21196.0
"""Magic numbers in param2 of MAV_CMD_COMPONENT_ARM_DISARM (GCS_Common.cpp): to force arming; to force either."""

ARMING_DELAY_S = 2.0
"""After arming, the motors stay stopped for this time (ARMING_DELAY_SEC of ArduCopter/config.h, `motors_output`)."""


def arm(fleet: Fleet, vehicle: Vehicle, causes: Causes, *, checked: bool) -> bool:
    """Arm if the checks pass, and return whether it is armed: home moves here, the motors idle after `ARMING_DELAY_S`.

    Without `checked` only the mandatory checks run.
    """
    if not prearm.run_checks(fleet, vehicle, causes, forced=not checked):
        return False
    why = _refusal(fleet, vehicle) if checked else ""
    if why:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_CRITICAL, f"Arm: {why}", causes)
        return False
    if checked and fleet.param(vehicle, "ARMING_CHECK") == 0:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, "Warning: Arming Checks Disabled", causes)
    row = vehicle.row
    flight = fleet.flight
    if not vehicle.home_locked:
        fleet.assign_home(vehicle, fleet.position(vehicle))
    vehicle.armed_yaw = float(fleet.estimate["yaw"][vehicle.row])
    vehicle.auto_armed = vehicle.mode == Mode.AUTO and bool(int(fleet.param(vehicle, "AUTO_OPTIONS")) & 2)
    flight["armed"][row] = 1
    flight["arming_delay_s"][row] = ARMING_DELAY_S
    fleet.checks["armed_up_m"][row], fleet.checks["crashed"][row] = fleet.estimate["pos"][row, 2], 0
    flight["landed"][row] = 1
    flight["control"][row] = PILOT_CONTROLS.get(vehicle.mode, ControlMode.IDLE)
    flight["flags"][row] = flight["handled_flags"][row] = 0
    fleet.set_default_limits(vehicle)
    fleet.set_timer(vehicle, Timer.DISARM_DELAY, auto_disarm_time(fleet, vehicle))
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, "Arming motors", causes)
    fleet.note("event.armed", vehicle, {"forced": not checked}, causes)
    log_arming(fleet, vehicle)
    fence.auto_enable_on_arming(fleet, vehicle)
    return True


def _refusal(fleet: Fleet, vehicle: Vehicle) -> str:
    """Return why an aircraft that passes the pre-arm checks may not be armed (`arm_checks`), or ""."""
    if not allows_arming(vehicle.reported_mode, int(fleet.param(vehicle, "AUTO_OPTIONS"))):
        return f"{Mode(vehicle.reported_mode).name} mode not armable"
    checks = int(fleet.param(vehicle, "ARMING_CHECK"))
    lean = elementary.hypot(float(fleet.estimate["roll"][vehicle.row]), float(fleet.estimate["pitch"][vehicle.row]))
    if checks & (prearm.ArmingCheck.ALL | prearm.ArmingCheck.INS) and lean > math.radians(
        fleet.param(vehicle, "ANGLE_MAX") * 0.01
    ):
        return "Leaning"
    if checks & (prearm.ArmingCheck.ALL | prearm.ArmingCheck.RC) and pilot.throttle_too_high(fleet, vehicle):
        return "Throttle too high"
    return ""


def disarm(fleet: Fleet, vehicle: Vehicle, reason: str, causes: Causes) -> None:
    """Stop the motors, also in flight, and set the mission back to its start."""
    flight, row = fleet.flight, vehicle.row
    flight["armed"][row] = 0
    flight["arming_delay_s"][row] = 0.0
    flight["landed"][row] = 1
    flight["control"][row] = ControlMode.OFF
    flight["spool_state"][row] = 0.0
    flight["flags"][row] = flight["handled_flags"][row] = 0
    vehicle.auto_armed = False
    vehicle.submode = SubMode.NONE
    vehicle.active_item = None
    vehicle.in_landing_sequence = False
    vehicle.current = 0
    vehicle.jump_counts.clear()
    vehicle.next_do, vehicle.do_started = 0, False
    vehicle.condition = (0, 0.0)
    vehicle.aux_functions.clear()
    vehicle.reached_ns.clear()
    for timer in (Timer.HOLD, Timer.LANDED, Timer.DISARM_DELAY, Timer.GUIDED_TIMEOUT, Timer.CONDITION):
        fleet.set_timer(vehicle, timer)
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, "Disarming motors", causes)
    fleet.note("event.disarmed", vehicle, {"reason": reason}, causes)
    log_disarming(fleet, vehicle)
    auto_rtl.update(fleet, vehicle)
    fence.auto_disable_on_disarming(fleet, vehicle)


def auto_disarm_time(fleet: Fleet, vehicle: Vehicle) -> Time:
    """Return when an aircraft that stands armed from now on disarms automatically: after DISARM_DELAY, never for 0."""
    delay_s = fleet.param(vehicle, "DISARM_DELAY")
    return fleet.now + from_seconds(delay_s) if delay_s > 0 else NEVER


def start_takeoff(fleet: Fleet, vehicle: Vehicle, up: float) -> None:
    """Climb to a height `up` (m above the origin) at the speeds in force: with spool-up on the ground, or in flight."""
    row, flight = vehicle.row, fleet.flight
    flight["flags"][row] = flight["handled_flags"][row] = 0
    flight["target_pos"][row, 2] = up
    flight["auto_yaw_mode"][row] = AutoYawMode.HOLD
    if flight["landed"][row]:
        flight["throttle"][row] = 0.0
        loop.reset_controllers(flight, row)
        fleet.set_timer(vehicle, Timer.DISARM_DELAY)
    else:
        loop.init_reference(fleet.estimate, flight, row)
    flight["control"][row] = ControlMode.TAKEOFF
