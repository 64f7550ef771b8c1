"""Commands: MAV_CMD → handler → MAV_RESULT.

Commands arrive as COMMAND_INT or COMMAND_LONG (https://mavlink.io/en/services/command.html) and are always answered
with COMMAND_ACK; one without a row here is UNSUPPORTED. Results are ArduCopter's (GCS_MAVLink_Copter.cpp,
GCS_Common.cpp).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.commands import flying, telling, upkeep
from skyrange.vehicle.builtin.commands.command import UNSUPPORTED, Command, of
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet
from skyrange.vehicle.builtin.telemetry.schedule import Schedule
from skyrange.vehicle.builtin.telemetry.table import BUILDERS, message

Handler = Callable[[Fleet, Schedule, Craft, Command], int | None]
"""Executes a command and returns the MAV_RESULT; `None` where the answer has already been sent."""

HANDLERS: Final[dict[int, Handler]] = {
    mav.MAV_CMD_COMPONENT_ARM_DISARM: flying.arm_disarm,
    mav.MAV_CMD_NAV_TAKEOFF: flying.takeoff,
    mav.MAV_CMD_NAV_VTOL_TAKEOFF: flying.takeoff,
    mav.MAV_CMD_NAV_LAND: flying.land,
    mav.MAV_CMD_NAV_VTOL_LAND: flying.land,
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: flying.go_home,
    mav.MAV_CMD_NAV_LOITER_UNLIM: flying.loiter,
    mav.MAV_CMD_DO_SET_MODE: flying.do_set_mode,
    mav.MAV_CMD_MISSION_START: flying.mission_start,
    mav.MAV_CMD_DO_CHANGE_SPEED: flying.change_speed,
    mav.MAV_CMD_CONDITION_YAW: flying.turn,
    mav.MAV_CMD_DO_REPOSITION: flying.reposition,
    mav.MAV_CMD_DO_FLIGHTTERMINATION: flying.terminate,
    mav.MAV_CMD_DO_SET_MISSION_CURRENT: flying.set_current,
    mav.MAV_CMD_DO_JUMP_TAG: flying.jump_tag,
    mav.MAV_CMD_DO_LAND_START: flying.land_start,
    mav.MAV_CMD_DO_PAUSE_CONTINUE: flying.pause,
    mav.MAV_CMD_DO_MOTOR_TEST: flying.motor_test,
    mav.MAV_CMD_SET_MESSAGE_INTERVAL: telling.set_interval,
    mav.MAV_CMD_GET_MESSAGE_INTERVAL: telling.get_interval,
    mav.MAV_CMD_REQUEST_MESSAGE: telling.request_message,
    mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: telling.capabilities,
    mav.MAV_CMD_DO_SEND_BANNER: telling.banner,
    mav.MAV_CMD_GET_HOME_POSITION: telling.get_home,
    mav.MAV_CMD_DO_SET_HOME: telling.do_set_home,
    mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: upkeep.restart,
    mav.MAV_CMD_PREFLIGHT_STORAGE: upkeep.erase,
    mav.MAV_CMD_PREFLIGHT_CALIBRATION: upkeep.calibrate,
    mav.MAV_CMD_RUN_PREARM_CHECKS: upkeep.check_prearm,
    mav.MAV_CMD_DO_FENCE_ENABLE: upkeep.enable_fence,
    mav.MAV_CMD_DO_SET_ROI: upkeep.look_at,
    mav.MAV_CMD_DO_SET_ROI_LOCATION: upkeep.look_at,
    mav.MAV_CMD_DO_SET_ROI_NONE: upkeep.look_ahead,
    mav.MAV_CMD_DO_PARACHUTE: upkeep.parachute,
    mav.MAV_CMD_DEBUG_TRAP: upkeep.trap,
    mav.MAV_CMD_DO_AUX_FUNCTION: upkeep.aux_function,
    mav.MAV_CMD_DO_GRIPPER: upkeep.not_fitted,
    mav.MAV_CMD_DO_SPRAYER: upkeep.not_fitted,
    mav.MAV_CMD_DO_WINCH: upkeep.not_fitted,
    mav.MAV_CMD_DO_SET_SERVO: upkeep.not_fitted,
    mav.MAV_CMD_DO_REPEAT_SERVO: upkeep.not_fitted,
    mav.MAV_CMD_DO_SET_RELAY: upkeep.not_fitted,
    mav.MAV_CMD_DO_REPEAT_RELAY: upkeep.not_fitted,
    mav.MAV_CMD_DO_ADSB_OUT_IDENT: upkeep.not_fitted,
    mav.MAV_CMD_FLASH_BOOTLOADER: upkeep.not_fitted,
    mav.MAV_CMD_CONTROL_HIGH_LATENCY: upkeep.not_fitted,
}


def on_command(
    fleet: Fleet, schedule: Schedule, craft: Craft, received: Any, partner: tuple[int, int], causes: Causes
) -> None:
    """COMMAND_LONG or COMMAND_INT: execute it and answer its sender; requested messages follow the answer."""
    command = of(received, partner, causes)
    handler = HANDLERS.get(received.command)
    result = UNSUPPORTED if command is None or handler is None else handler(fleet, schedule, craft, command)
    if result is None or command is None:
        if command is None:
            _acknowledge(fleet, craft, received.command, UNSUPPORTED, partner, causes)
        return
    _acknowledge(fleet, craft, received.command, result, partner, causes)
    for number in command.after:
        told = message(fleet, craft, number) if number in BUILDERS else None
        if told is not None:
            fleet.send(craft, told)


def _acknowledge(
    fleet: Fleet, craft: Craft, number: int, result: int, partner: tuple[int, int], causes: Causes
) -> None:
    fleet.send(craft, mav.MAVLink_command_ack_message(number, result, 0, 0, *partner), causes)
