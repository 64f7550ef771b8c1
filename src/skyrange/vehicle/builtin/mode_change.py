"""Mode changes: when a mode may be entered, and what a flying aircraft does on entry.

The rules are those of `Copter::set_mode` (ArduCopter/mode.cpp) and each mode's `init`. A refused change sends a text
and changes nothing else. While disarmed, any mode may be chosen: arming checks it.
"""

from __future__ import annotations

from collections.abc import Callable

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NEVER, from_seconds
from skyrange.vehicle.builtin import fence, loop, pilot
from skyrange.vehicle.builtin.arming.arming import auto_disarm_time
from skyrange.vehicle.builtin.estimation import validity
from skyrange.vehicle.builtin.fleet import Causes, Fleet, SubMode, Timer, Vehicle
from skyrange.vehicle.builtin.flight_modes import auto_rtl, guided, rtl
from skyrange.vehicle.builtin.guidance import auto_yaw
from skyrange.vehicle.builtin.layout import AutoYawMode, ControlMode
from skyrange.vehicle.builtin.log_events import log_mode
from skyrange.vehicle.builtin.mission import (
    execution,
)
from skyrange.vehicle.builtin.modes import MANUAL_THROTTLE, PILOT_CONTROLS, REQUIRES_POSITION, Mode, mode_of
from skyrange.vehicle.builtin.telemetry.table import build_message

_BRAKE_SPEED_Z_MPS = 2.5  # config.h BRAKE_MODE_SPEED_Z
_BRAKE_DECEL_MPS2 = 7.5  # config.h BRAKE_MODE_DECEL_RATE


def _refusal(fleet: Fleet, vehicle: Vehicle, mode: Mode) -> str:
    """Return why an armed aircraft may not enter a mode, or ""."""
    if mode in REQUIRES_POSITION and not validity.position_ok(fleet, vehicle):
        return "requires position"
    if vehicle.mode in MANUAL_THROTTLE and mode not in MANUAL_THROTTLE and not validity.ekf_alt_ok(fleet, vehicle):
        return "need alt estimate"
    if fence.blocks_mode_change(fleet, vehicle):
        return "in fence recovery"
    if mode == Mode.AUTO:
        if not vehicle.has_mission:
            return "init failed"
        if fleet.landed(vehicle) and not execution.starts_with_takeoff_cmd(fleet, vehicle):
            fleet.send_text(vehicle, dialect.MAV_SEVERITY_CRITICAL, "Auto: Missing Takeoff Cmd")
            return "init failed"
    by_hand = mode in MANUAL_THROTTLE and vehicle.mode not in MANUAL_THROTTLE and fleet.landed(vehicle)
    if by_hand and pilot.manual_thrust(fleet, vehicle) > 0.5 * fleet.param(vehicle, "MOT_THST_HOVER"):
        return "throttle too high"  # it must not jump off the ground (get_non_takeoff_throttle)
    return ""


def _enter_hold(fleet: Fleet, vehicle: Vehicle) -> None:
    loop.init_reference(fleet.estimate, fleet.flight, vehicle.row)
    fleet.set_default_limits(vehicle)
    auto_yaw.set_mode(fleet, vehicle, AutoYawMode.HOLD)
    fleet.set_control(vehicle, ControlMode.VELOCITY)


def _enter_brake(fleet: Fleet, vehicle: Vehicle) -> None:
    _enter_hold(fleet, vehicle)
    row = vehicle.row
    fleet.flight["accel_xy"][row] = _BRAKE_DECEL_MPS2
    fleet.flight["accel_z"][row] = _BRAKE_DECEL_MPS2
    fleet.flight["speed_up"][row] = _BRAKE_SPEED_Z_MPS
    fleet.flight["speed_down"][row] = _BRAKE_SPEED_Z_MPS


def _enter_land(fleet: Fleet, vehicle: Vehicle) -> None:
    _enter_hold(fleet, vehicle)
    vehicle.submode = SubMode.LAND
    fleet.set_control(vehicle, ControlMode.LAND)
    fleet.flight["land_nogps"][vehicle.row] = not validity.position_ok(fleet, vehicle)


def _enter_pilot_mode(fleet: Fleet, vehicle: Vehicle) -> None:
    """Let the pilot's sticks take over from the present state."""
    control = PILOT_CONTROLS[vehicle.mode]
    row, flight = vehicle.row, fleet.flight
    set_pilot_limits(fleet, vehicle)
    auto_yaw.set_mode(fleet, vehicle, AutoYawMode.HOLD)
    if not fleet.landed(vehicle):
        loop.init_reference(fleet.estimate, flight, row)
        loop.init_loiter(fleet.estimate, flight, row)
    fleet.set_control(vehicle, control)


def set_pilot_limits(fleet: Fleet, vehicle: Vehicle) -> None:
    """Set speed and acceleration limits to the PILOT and LOIT parameters (mode_loiter.cpp, mode_althold.cpp)."""
    row, flight = vehicle.row, fleet.flight
    fleet.set_default_limits(vehicle)
    up = fleet.param(vehicle, "PILOT_SPEED_UP") * 0.01
    flight["speed_up"][row] = up
    flight["speed_down"][row] = fleet.param(vehicle, "PILOT_SPEED_DN") * 0.01 or up
    flight["accel_z"][row] = fleet.param(vehicle, "PILOT_ACCEL_Z") * 0.01
    if vehicle.mode == Mode.LOITER:
        flight["accel_xy"][row] = fleet.param(vehicle, "LOIT_ACC_MAX") * 0.01


_ENTRY_ACTIONS: dict[Mode, Callable[[Fleet, Vehicle], None]] = {
    Mode.STABILIZE: _enter_pilot_mode,
    Mode.ALT_HOLD: _enter_pilot_mode,
    Mode.AUTO: _enter_hold,
    Mode.GUIDED: guided.hold_velocity,
    Mode.LOITER: _enter_pilot_mode,
    Mode.RTL: rtl.start,
    Mode.LAND: _enter_land,
    Mode.BRAKE: _enter_brake,
}
"""What a flying aircraft does on entry; AUTO holds until its mission starts."""


def set_mode(fleet: Fleet, vehicle: Vehicle, number: int, reason: str, causes: Causes) -> bool:
    """Change the mode; `False` and a text where it is refused. The present mode again changes nothing.

    `reason` is ArduCopter's (AP_Vehicle/ModeReason.h), in lower case, as in `event.mode`.
    """
    if number == vehicle.reported_mode:
        vehicle.mode_reason = reason
        return True
    mode = mode_of(number)
    if mode is Mode.AUTO_RTL:
        return _enter_auto_rtl(fleet, vehicle, reason, causes)
    if mode is None:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, f"No such mode {number}", causes)
        return False
    armed = fleet.armed(vehicle)
    why = _refusal(fleet, vehicle, mode) if armed else ""
    if why:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, f"Mode change to {mode.name} failed: {why}", causes)
        return False
    if vehicle.mode == Mode.AUTO:
        execution.stop(fleet, vehicle)
    fleet.assign_mode(vehicle, mode)
    vehicle.mode_causes = causes
    vehicle.mode_reason = reason
    vehicle.submode = SubMode.NONE
    vehicle.paused, vehicle.suspended_targets = False, ()
    pilot.update_sticks(fleet, vehicle)
    fleet.set_timer(vehicle, Timer.HOLD)
    fleet.set_timer(vehicle, Timer.GUIDED_TIMEOUT)
    fleet.note("event.mode", vehicle, {"mode": mode.name, "number": int(mode), "reason": str(reason)}, causes)
    log_mode(fleet, vehicle)
    fleet.send(
        vehicle, build_message(fleet, vehicle, dialect.MAVLINK_MSG_ID_HEARTBEAT), causes
    )  # at once (Copter::set_mode)
    fence.start_manual_recovery(fleet, vehicle)
    if armed and not fleet.landed(vehicle):
        fleet.flight["land_nogps"][vehicle.row] = 0
        _ENTRY_ACTIONS[mode](fleet, vehicle)
    elif armed:
        fleet.set_default_limits(vehicle)
        fleet.set_control(vehicle, ControlMode.IDLE)  # a take-off that has not left the ground is cancelled
        if mode in PILOT_CONTROLS:
            _enter_pilot_mode(fleet, vehicle)
        if mode == Mode.LAND:
            fleet.set_timer(vehicle, Timer.LANDED, fleet.now + from_seconds(fleet.param(vehicle, "MOT_SPOOL_TIME")))
        elif fleet.timers[vehicle.row, Timer.DISARM_DELAY] == NEVER:  # idle motors do not start it anew
            fleet.set_timer(vehicle, Timer.DISARM_DELAY, auto_disarm_time(fleet, vehicle))
    if mode == Mode.AUTO:
        vehicle.speed_overrides.clear()
        vehicle.guided_limits = (0.0, 0.0, 0.0, 0.0)
        execution.start_or_resume(fleet, vehicle)
    return True


def _enter_auto_rtl(fleet: Fleet, vehicle: Vehicle, reason: str, causes: Causes) -> bool:
    """Enter AUTO_RTL (`return_path_or_jump_to_landing_sequence_auto_RTL`)."""
    if execution.jump_unless_active(fleet, vehicle, causes):
        return _fly_landing_sequence(fleet, vehicle, reason, causes)
    _send_landing_refusal(fleet, vehicle, "No return path or landing sequence found", causes)
    return False


def enter_landing_sequence(fleet: Fleet, vehicle: Vehicle, reason: str, causes: Causes) -> bool:
    """Jump to the nearest DO_LAND_START in any case (ModeAuto::jump_to_landing_sequence_auto_RTL)."""
    if execution.jump_to_start(fleet, vehicle, causes):
        return _fly_landing_sequence(fleet, vehicle, reason, causes)
    _send_landing_refusal(fleet, vehicle, "No landing sequence found", causes)
    return False


def _send_landing_refusal(fleet: Fleet, vehicle: Vehicle, why: str, causes: Causes) -> None:
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, f"Mode change to AUTO RTL failed: {why}", causes)


def _fly_landing_sequence(fleet: Fleet, vehicle: Vehicle, reason: str, causes: Causes) -> bool:
    """Fly the mission from its current item on, reported as AUTO_RTL (ModeAuto::enter_auto_rtl)."""
    if vehicle.mode != Mode.AUTO:
        vehicle.resume_mission = True
        if not set_mode(fleet, vehicle, Mode.AUTO, reason, causes):
            vehicle.resume_mission = False
            return False
    vehicle.mode_causes = causes
    auto_rtl.enter(fleet, vehicle, reason)
    auto_rtl.update(fleet, vehicle)
    return True
