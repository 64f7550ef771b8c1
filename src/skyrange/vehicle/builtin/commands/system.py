"""Commands about the system: reports, home, reboot, parameters, calibration, fence, and devices that are not fitted.

After `handle_preflight_reboot`, `handle_command_preflight_calibration` and others of
libraries/GCS_MAVLink/GCS_Common.cpp. Commands that ArduCopter answers with UNSUPPORTED have no handler.

Commands about telemetry and home: message intervals, single messages, home position, the banner. After
`handle_command_set_message_interval`, `…_get_message_interval`, `…_request_message`, `…_get_home_position`,
`…_do_set_home` of libraries/GCS_MAVLink/GCS_Common.cpp.

Reboot: an aircraft starts again with its stored parameters and mission, and nothing else. After ArduPilot's storage
(AP_Param, AP_Mission) and `Copter::init_ardupilot`. It takes no time here.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin import fence, pilot
from skyrange.vehicle.builtin.arming import prearm
from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.commands.command import (
    ACCEPTED,
    DENIED,
    FAILED,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    Command,
    check_latlng,
    int32,
    location_of,
    uint32,
)  # fmt: skip  # fmt: skip
from skyrange.vehicle.builtin.failsafes import checks
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionState, Slowdown, Timer, Upload, Vehicle
from skyrange.vehicle.builtin.guidance import auto_yaw
from skyrange.vehicle.builtin.locations import send_home, set_home
from skyrange.vehicle.builtin.log_events import end_log
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameter_protocol import send_banner
from skyrange.vehicle.builtin.parameters.table import PARAMETERS, apply_stored, stored_value
from skyrange.vehicle.builtin.range_sensing.sensors import start_sensors
from skyrange.vehicle.builtin.telemetry.schedule import (
    COLUMN,
    MIN_INTERVAL_MS,
    Schedule,
    default_interval_ns,
    start_boot_streams,
)
from skyrange.vehicle.builtin.telemetry.table import UNSOLICITED


def reboot(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, causes: Causes) -> None:
    """Restart: disarmed, in STABILIZE, under the stored system id, with telemetry at the rates of boot."""
    row = vehicle.row
    if fleet.armed(vehicle):
        disarm(fleet, vehicle, "reboot", causes)
    for index, value in vehicle.unsaved_params.items():
        fleet.stored_params[row, index] = value
    vehicle.unsaved_params.clear()
    if vehicle.params_erased:
        fleet.stored_params[row] = [stored_value(parameter, parameter.default) for parameter in PARAMETERS]
        vehicle.params_erased = False
    apply_stored(fleet.settings, row, fleet.stored_params[row])
    vehicle.system_id = int(fleet.param(vehicle, "SYSID_THISMAV"))
    vehicle.packer.system = vehicle.system_id
    vehicle.packer.sequence = 0
    fleet.system_ids[row] = vehicle.system_id
    fleet.boot_ns[row] = fleet.now
    fleet.clocks.restart(row, int(fleet.estimate["gnss_fix"][row]))
    fleet.rebooted.append(vehicle.id)
    fleet.assign_mode(vehicle, Mode.STABILIZE)
    vehicle.paused, vehicle.suspended_targets, vehicle.resume_mission = False, (), False
    pilot.update_sticks(fleet, vehicle)
    vehicle.mode_causes = causes
    vehicle.uploads = [Upload() for _ in vehicle.uploads]
    vehicle.legacy_warned.clear()
    vehicle.mission_state = MissionState.NOT_STARTED if vehicle.has_mission else MissionState.NONE
    vehicle.next_param = len(PARAMETERS)
    vehicle.slowdowns = Slowdown.NONE
    fleet.stream_factors.pop(row, None)
    vehicle.stream_slowdown_ms = 0
    fleet.stream_delays_ns.pop(row, None)
    vehicle.file_server = None
    end_log(vehicle)
    fleet.assign_home(vehicle, fleet.position(vehicle))
    vehicle.home_locked = False
    for timer in Timer:
        fleet.set_timer(vehicle, timer)
    checks.reset_state(fleet, vehicle)
    start_sensors(fleet, vehicle)
    start_boot_streams(schedule, fleet, vehicle)
    fleet.note("event.reboot", vehicle, {"system_id": vehicle.system_id}, causes)


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


_FORCE_REBOOT: Final = 20_190_226
_PARACHUTE_ACTIONS: Final = 3


def preflight_reboot(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int | None:
    """PREFLIGHT_REBOOT_SHUTDOWN: disarmed, or (20190226 in param6) in any state. Acknowledged before the reboot."""
    if fleet.armed(vehicle) and command.y != _FORCE_REBOOT:
        return FAILED
    if command.params[0] not in (1.0, 3.0):
        return UNSUPPORTED
    ack = mav.MAVLink_command_ack_message(command.number, ACCEPTED, 0, 0, *command.peer)
    fleet.send(vehicle, ack, command.causes)
    reboot(fleet, schedule, vehicle, command.causes)
    return None


def preflight_storage(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """PREFLIGHT_STORAGE: 2 erases all parameters, with effect at the next boot."""
    if command.params[0] != 2.0:
        return DENIED
    vehicle.params_erased = True
    fleet.send_text(vehicle, mav.MAV_SEVERITY_WARNING, "All parameters reset, reboot board", command.causes)
    return ACCEPTED


def preflight_calibration(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """PREFLIGHT_CALIBRATION: gyros or barometer, disarmed; neither needs calibration here."""
    if fleet.armed(vehicle):
        fleet.send_text(vehicle, mav.MAV_SEVERITY_NOTICE, "Disarm to allow calibration", command.causes)
        return FAILED
    return ACCEPTED if command.params[0] == 1.0 or command.params[2] == 1.0 else UNSUPPORTED


def run_prearm_checks(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """RUN_PREARM_CHECKS: report what prevents arming, if anything does."""
    if fleet.armed(vehicle):
        return TEMPORARILY_REJECTED
    prearm.report_failures(fleet, vehicle, command.causes)
    return ACCEPTED


def do_fence_enable(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_FENCE_ENABLE."""
    what, kinds = command.params[:2]
    if not (math.isfinite(what) and math.isfinite(kinds)):
        return DENIED
    return fence.handle_do_fence_enable(fleet, vehicle, int(what), int(kinds))


def do_set_roi(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_SET_ROI, DO_SET_ROI_LOCATION: set a region of interest."""
    where = location_of(fleet, vehicle, command)
    if where is None:
        return DENIED
    if not check_latlng(command.x, command.y):
        return FAILED
    nowhere = command.x == 0 and command.y == 0 and command.z == 0.0
    auto_yaw.set_roi(fleet, vehicle, None if nowhere else where)
    return ACCEPTED


def do_set_roi_none(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_SET_ROI_NONE: return to the default yaw mode."""
    auto_yaw.set_roi(fleet, vehicle, None)
    return ACCEPTED


def do_parachute(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_PARACHUTE: accepted as by ArduCopter, though none is fitted."""
    return ACCEPTED if uint32(command.params[0]) & 0xFFFF < _PARACHUTE_ACTIONS else FAILED


def debug_trap(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DEBUG_TRAP: not supported."""
    return UNSUPPORTED if uint32(command.params[0]) == 32_451 else DENIED


def do_aux_function(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_AUX_FUNCTION: a switch in one of three positions, without a function."""
    return DENIED if command.params[1] > 2.0 else FAILED


def fail_unfitted(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """Fail commands that ArduCopter supports, for devices that are not fitted."""
    return FAILED
