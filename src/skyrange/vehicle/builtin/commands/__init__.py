"""Commands: MAV_CMD → handler → MAV_RESULT.

Commands arrive as COMMAND_INT or COMMAND_LONG (https://mavlink.io/en/services/command.html) and are always answered
with COMMAND_ACK; one without a row here is UNSUPPORTED. Results are ArduCopter's (GCS_MAVLink_Copter.cpp,
GCS_Common.cpp).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.commands import (
    flight,
    system,
)
from skyrange.vehicle.builtin.commands.command import UNSUPPORTED, Command, decode_command
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle
from skyrange.vehicle.builtin.telemetry.schedule import Schedule
from skyrange.vehicle.builtin.telemetry.table import BUILDERS, build_message

Handler = Callable[[Fleet, Schedule, Vehicle, Command], int | None]
"""Executes a command and returns the MAV_RESULT; `None` where the answer has already been sent."""

HANDLERS: Final[dict[int, Handler]] = {
    mav.MAV_CMD_COMPONENT_ARM_DISARM: flight.arm_disarm,
    mav.MAV_CMD_NAV_TAKEOFF: flight.takeoff,
    mav.MAV_CMD_NAV_VTOL_TAKEOFF: flight.takeoff,
    mav.MAV_CMD_NAV_LAND: flight.land,
    mav.MAV_CMD_NAV_VTOL_LAND: flight.land,
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: flight.return_to_launch,
    mav.MAV_CMD_NAV_LOITER_UNLIM: flight.loiter_unlim,
    mav.MAV_CMD_DO_SET_MODE: flight.do_set_mode,
    mav.MAV_CMD_MISSION_START: flight.mission_start,
    mav.MAV_CMD_DO_CHANGE_SPEED: flight.change_speed,
    mav.MAV_CMD_CONDITION_YAW: flight.condition_yaw,
    mav.MAV_CMD_DO_REPOSITION: flight.reposition,
    mav.MAV_CMD_DO_FLIGHTTERMINATION: flight.flight_termination,
    mav.MAV_CMD_DO_SET_MISSION_CURRENT: flight.set_mission_current,
    mav.MAV_CMD_DO_JUMP_TAG: flight.jump_tag,
    mav.MAV_CMD_DO_LAND_START: flight.land_start,
    mav.MAV_CMD_DO_PAUSE_CONTINUE: flight.pause_continue,
    mav.MAV_CMD_DO_MOTOR_TEST: flight.motor_test,
    mav.MAV_CMD_SET_MESSAGE_INTERVAL: system.set_message_interval,
    mav.MAV_CMD_GET_MESSAGE_INTERVAL: system.get_message_interval,
    mav.MAV_CMD_REQUEST_MESSAGE: system.request_message,
    mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: system.request_capabilities,
    mav.MAV_CMD_DO_SEND_BANNER: system.do_send_banner,
    mav.MAV_CMD_GET_HOME_POSITION: system.get_home_position,
    mav.MAV_CMD_DO_SET_HOME: system.do_set_home,
    mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: system.preflight_reboot,
    mav.MAV_CMD_PREFLIGHT_STORAGE: system.preflight_storage,
    mav.MAV_CMD_PREFLIGHT_CALIBRATION: system.preflight_calibration,
    mav.MAV_CMD_RUN_PREARM_CHECKS: system.run_prearm_checks,
    mav.MAV_CMD_DO_FENCE_ENABLE: system.do_fence_enable,
    mav.MAV_CMD_DO_SET_ROI: system.do_set_roi,
    mav.MAV_CMD_DO_SET_ROI_LOCATION: system.do_set_roi,
    mav.MAV_CMD_DO_SET_ROI_NONE: system.do_set_roi_none,
    mav.MAV_CMD_DO_PARACHUTE: system.do_parachute,
    mav.MAV_CMD_DEBUG_TRAP: system.debug_trap,
    mav.MAV_CMD_DO_AUX_FUNCTION: system.do_aux_function,
    mav.MAV_CMD_DO_GRIPPER: system.fail_unfitted,
    mav.MAV_CMD_DO_SPRAYER: system.fail_unfitted,
    mav.MAV_CMD_DO_WINCH: system.fail_unfitted,
    mav.MAV_CMD_DO_SET_SERVO: system.fail_unfitted,
    mav.MAV_CMD_DO_REPEAT_SERVO: system.fail_unfitted,
    mav.MAV_CMD_DO_SET_RELAY: system.fail_unfitted,
    mav.MAV_CMD_DO_REPEAT_RELAY: system.fail_unfitted,
    mav.MAV_CMD_DO_ADSB_OUT_IDENT: system.fail_unfitted,
    mav.MAV_CMD_FLASH_BOOTLOADER: system.fail_unfitted,
    mav.MAV_CMD_CONTROL_HIGH_LATENCY: system.fail_unfitted,
}


def on_command(
    fleet: Fleet, schedule: Schedule, vehicle: Vehicle, received: Any, peer: tuple[int, int], causes: Causes
) -> None:
    """COMMAND_LONG or COMMAND_INT: execute it and answer its sender; requested messages follow the answer."""
    command = decode_command(received, peer, causes)
    handler = HANDLERS.get(received.command)
    result = UNSUPPORTED if command is None or handler is None else handler(fleet, schedule, vehicle, command)
    if result is None or command is None:
        if command is None:
            _acknowledge(fleet, vehicle, received.command, UNSUPPORTED, peer, causes)
        return
    _acknowledge(fleet, vehicle, received.command, result, peer, causes)
    for number in command.after:
        reply = build_message(fleet, vehicle, number) if number in BUILDERS else None
        if reply is not None:
            fleet.send(vehicle, reply)


def _acknowledge(
    fleet: Fleet, vehicle: Vehicle, number: int, result: int, peer: tuple[int, int], causes: Causes
) -> None:
    fleet.send(vehicle, mav.MAVLink_command_ack_message(number, result, 0, 0, *peer), causes)
