"""Which commands are obeyed, and what is the answer? MAV_CMD → handler → MAV_RESULT.

Commands come as COMMAND_INT or COMMAND_LONG (https://mavlink.io/en/services/command.html) and are always answered with
COMMAND_ACK; one that has no row here is UNSUPPORTED. Results are ArduCopter's (GCS_MAVLink_Copter.cpp, GCS_Common.cpp).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_US
from skyrange.vehicle.builtin import navigator
from skyrange.vehicle.builtin.arming import FORCE, FORCE_ARM, arm, disarm, take_off
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, MissionState
from skyrange.vehicle.builtin.mission_protocol import current_message
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.switching import set_mode
from skyrange.vehicle.builtin.telemetry import BUILDERS, COLUMN, SERVICE_NS, Schedule, boot_period_ns

ACCEPTED = dialect.MAV_RESULT_ACCEPTED
DENIED = dialect.MAV_RESULT_DENIED
FAILED = dialect.MAV_RESULT_FAILED
UNSUPPORTED = dialect.MAV_RESULT_UNSUPPORTED

_INTERVAL_MAX_US = 60_000_000  # GCS_MAVLINK::set_message_interval
_GROUND_SPEEDS = 4  # SPEED_TYPE values: airspeed, ground speed, climb, descent


@dataclass(frozen=True, slots=True)
class Command:
    """A command with its parameters, however it came; `frame` is the MAV_FRAME of a COMMAND_INT."""

    number: int
    params: tuple[float, float, float, float]
    z: float
    frame: int
    causes: Causes


def _whole(value: float) -> int | None:
    """A parameter that means a number of something; `None` where it is no such number."""
    return int(value) if math.isfinite(value) and abs(value) < 2**31 else None


def _arm_disarm(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    want, magic = command.params[0], command.params[1]
    if want == 1.0:
        if fleet.armed(craft):
            return int(ACCEPTED)
        if not arm(fleet, craft, magic not in (FORCE_ARM, FORCE), command.causes):
            return int(FAILED)
        # home is where it stands now, and ArduPilot says so (AP_AHRS::set_home)
        fleet.send(craft, BUILDERS[dialect.MAVLINK_MSG_ID_HOME_POSITION](fleet, craft), command.causes)
        navigator.update(fleet, craft)
        return int(ACCEPTED)
    if want == 0.0:
        if fleet.armed(craft):
            if magic != FORCE and not fleet.landed(craft):
                return int(FAILED)
            disarm(fleet, craft, "forced" if magic == FORCE else "command", command.causes)
        return int(ACCEPTED)
    return int(UNSUPPORTED)


def _takeoff(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    if command.frame not in navigator.RELATIVE_FRAMES:
        return int(DENIED)
    up = craft.home[2] + command.z
    here = fleet.position(craft)[2]
    if not math.isfinite(command.z) or abs(command.z) > 1e5:
        return int(DENIED)
    if craft.mode != Mode.GUIDED or not fleet.armed(craft) or not fleet.landed(craft) or up <= here:
        return int(FAILED)
    craft.ready = True
    craft.target_causes = command.causes
    fleet.limits(craft)
    take_off(fleet, craft, up)
    return int(ACCEPTED)


def _land(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    return int(ACCEPTED if set_mode(fleet, craft, Mode.LAND, "gcs_command", command.causes) else FAILED)


def _return(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    return int(ACCEPTED if set_mode(fleet, craft, Mode.RTL, "gcs_command", command.causes) else FAILED)


def mode_result(fleet: Fleet, craft: Craft, base_mode: int | None, number: int | None, causes: Causes) -> int:
    """Change the mode as SET_MODE or DO_SET_MODE ask; the MAV_RESULT."""
    if base_mode is None or number is None or not base_mode & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return int(DENIED)
    return int(ACCEPTED if set_mode(fleet, craft, number, "gcs_command", causes) else FAILED)


def _do_set_mode(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    return mode_result(fleet, craft, _whole(command.params[0]), _whole(command.params[1]), command.causes)


def _mission_start(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    if command.params[0] != 0.0 or command.params[1] != 0.0:
        return int(DENIED)  # a first or last item is not supported
    if not set_mode(fleet, craft, Mode.AUTO, "gcs_command", command.causes):
        return int(FAILED)
    craft.mode_causes = command.causes
    craft.ready = fleet.armed(craft)
    if craft.mission_state != MissionState.ACTIVE:
        navigator.start_or_resume(fleet, craft)
    navigator.update(fleet, craft)
    return int(ACCEPTED)


def _change_speed(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    kind, speed = _whole(command.params[0]), command.params[1]
    if kind is None or not 0 <= kind < _GROUND_SPEEDS or not (speed > 0.0 and math.isfinite(speed)):
        return int(DENIED)
    if craft.mode not in (Mode.AUTO, Mode.GUIDED, Mode.RTL):
        return int(FAILED)
    return int(ACCEPTED if navigator.change_speed(fleet, craft, kind, speed) else FAILED)


def _set_current(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    seq = _whole(command.params[0])
    if seq is None or not 0 <= seq < len(craft.mission):
        return int(DENIED)
    again = command.params[1] == 1.0
    if again:
        navigator.reset(craft)
    if not navigator.set_current(fleet, craft, seq):
        return int(FAILED)
    if again and craft.mode == Mode.AUTO and craft.mission_state != MissionState.ACTIVE:
        navigator.start_or_resume(fleet, craft)
    fleet.send(craft, current_message(craft), command.causes)
    return int(ACCEPTED)


def _set_interval(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    message, interval_us = _whole(command.params[0]), _whole(command.params[1])
    if message not in COLUMN or interval_us is None or interval_us < -1:
        return int(DENIED)
    if interval_us == 0:
        period = boot_period_ns(fleet, craft, message)
    elif interval_us == -1:
        period = 0
    else:
        period = min(interval_us, _INTERVAL_MAX_US) * NS_PER_US
        if period < SERVICE_NS:
            fleet.text(craft, dialect.MAV_SEVERITY_INFO, f"Requested rate for message ID {message} too fast")
            return int(DENIED)
    schedule.set(craft.row, message, period, fleet.now)
    return int(ACCEPTED)


def _tell_interval(fleet: Fleet, schedule: Schedule, craft: Craft, message: int | None) -> int:
    known = message in COLUMN
    if message is None or not 0 <= message <= 0xFFFF:
        return int(FAILED)
    period_us = int(schedule.period[craft.row, COLUMN[message]]) // NS_PER_US if known else 0
    shown = (period_us or -1) if known else 0
    fleet.send(craft, dialect.MAVLink_message_interval_message(message, shown))
    return int(ACCEPTED if known else FAILED)


def _get_interval(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    return _tell_interval(fleet, schedule, craft, _whole(command.params[0]))


def _request_message(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    message = _whole(command.params[0])
    if message == dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
        return _tell_interval(fleet, schedule, craft, _whole(command.params[1]))
    if message not in BUILDERS:
        return int(FAILED)
    fleet.send(craft, BUILDERS[message](fleet, craft))
    return int(ACCEPTED)


def _request_capabilities(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    if command.params[0] == 1.0:
        fleet.send(craft, BUILDERS[dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION](fleet, craft))
    return int(ACCEPTED)


HANDLERS: Final[dict[int, Callable[[Fleet, Schedule, Craft, Command], int]]] = {
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    dialect.MAV_CMD_NAV_TAKEOFF: _takeoff,
    dialect.MAV_CMD_NAV_LAND: _land,
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return,
    dialect.MAV_CMD_DO_SET_MODE: _do_set_mode,
    dialect.MAV_CMD_MISSION_START: _mission_start,
    dialect.MAV_CMD_DO_CHANGE_SPEED: _change_speed,
    dialect.MAV_CMD_DO_SET_MISSION_CURRENT: _set_current,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    dialect.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    dialect.MAV_CMD_REQUEST_MESSAGE: _request_message,
    dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _request_capabilities,
}


def on_command(
    fleet: Fleet, schedule: Schedule, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes
) -> None:
    """COMMAND_LONG or COMMAND_INT: do it and answer whoever sent it."""
    params = (message.param1, message.param2, message.param3, message.param4)
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_INT:
        z, frame = message.z, message.frame
    else:
        z, frame = message.param7, int(dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT)
    handler = HANDLERS.get(message.command)
    command = Command(message.command, params, z, frame, causes)
    result = handler(fleet, schedule, craft, command) if handler else UNSUPPORTED
    fleet.send(craft, dialect.MAVLink_command_ack_message(message.command, result, 0, 0, *partner), causes)
