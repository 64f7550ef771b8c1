"""Commands about telemetry and home: message intervals, single messages, home position, the banner.

After `handle_command_set_message_interval`, `…_get_message_interval`, `…_request_message`, `…_get_home_position`,
`…_do_set_home` of libraries/GCS_MAVLink/GCS_Common.cpp.
"""

from __future__ import annotations

from typing import Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.commands.command import (
    ACCEPTED,
    DENIED,
    FAILED,
    Command,
    check_latlng,
    int32,
    location_of,
    uint32,
)  # fmt: skip
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.locations.home import send_home, set_home
from skyrange.vehicle.builtin.messages.parameter_protocol import send_banner
from skyrange.vehicle.builtin.telemetry.schedule import COLUMN, Schedule
from skyrange.vehicle.builtin.telemetry.streams import MIN_INTERVAL_MS, default_interval_ns
from skyrange.vehicle.builtin.telemetry.table import UNSOLICITED

_MAX_INTERVAL_MS: Final = 60_000
_MAX_MESSAGE_ID: Final = 2 << 15
_REQUESTABLE: Final = COLUMN.keys() - UNSOLICITED


def set_message_interval(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """SET_MESSAGE_INTERVAL: µs; 0 is the default rate, -1 stops. Rounded down to milliseconds, 3 to 60 000."""
    if command.params[2] != 0.0:
        return DENIED
    message, interval_us = uint32(command.params[0]), int32(command.params[1])
    if message not in _REQUESTABLE or interval_us < -1:
        return DENIED
    if interval_us == 0:
        period = default_interval_ns(fleet, vehicle, message)
    elif interval_us == -1:
        period = 0
    else:
        whole_ms = min(max(interval_us // 1000, 1), _MAX_INTERVAL_MS)
        if whole_ms < MIN_INTERVAL_MS:
            text = f"Requested rate for message ID {message} too fast. Increase SCHED_LOOP_RATE"
            fleet.send_text(vehicle, mav.MAV_SEVERITY_INFO, text, command.causes)
            return DENIED
        period = whole_ms * NS_PER_MS
    schedule.set(vehicle.row, message, period, fleet.now)
    return ACCEPTED


def _send_interval(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, message: int) -> int:
    if message >= _MAX_MESSAGE_ID or message not in _REQUESTABLE:
        fleet.send(vehicle, mav.MAVLink_message_interval_message(message & 0xFFFF, 0))
        return FAILED
    period_us = int(schedule.period[vehicle.row, COLUMN[message]]) // 1000
    fleet.send(vehicle, mav.MAVLink_message_interval_message(message, period_us or -1))
    return ACCEPTED


def get_message_interval(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """GET_MESSAGE_INTERVAL: answer with MESSAGE_INTERVAL; -1 is not sent, 0 not known."""
    return _send_interval(fleet, schedule, vehicle, uint32(command.params[0]))


def request_message(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """REQUEST_MESSAGE: accepted for every message that ArduCopter knows; it is sent where it has contents."""
    message = uint32(command.params[0])
    if message == mav.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
        return _send_interval(fleet, schedule, vehicle, uint32(command.params[1]))
    if message not in _REQUESTABLE:
        return FAILED
    command.after.append(message)
    return ACCEPTED


def request_capabilities(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """REQUEST_AUTOPILOT_CAPABILITIES: send AUTOPILOT_VERSION."""
    if command.params[0] != 1.0:
        return FAILED
    command.after.append(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    return ACCEPTED


def do_send_banner(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_SEND_BANNER."""
    send_banner(fleet, vehicle)
    return ACCEPTED


def get_home_position(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """GET_HOME_POSITION: send HOME_POSITION and GPS_GLOBAL_ORIGIN."""
    send_home(fleet, vehicle, ())
    return ACCEPTED


def do_set_home(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_SET_HOME: here (param1 1, or latitude and longitude 0), or at a place. Arming then does not move it."""
    if command.params[0] == 1.0 or (command.x == 0 and command.y == 0):
        set_home(fleet, vehicle, fleet.position(vehicle), command.causes, lock=True)
        return ACCEPTED
    if command.params[0] != 0.0:
        return FAILED
    goal = location_of(fleet, vehicle, command)
    if goal is None:
        return DENIED
    if not check_latlng(command.x, command.y):
        return FAILED
    set_home(fleet, vehicle, goal, command.causes, lock=True)
    return ACCEPTED
