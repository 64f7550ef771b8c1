"""System commands: reboot, erasing parameters, calibration, fence, regions of interest, devices that are not fitted.

After `handle_preflight_reboot`, `handle_command_preflight_calibration` and others of
libraries/GCS_MAVLink/GCS_Common.cpp. Commands that ArduCopter answers with UNSUPPORTED have no handler.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.arming import prearm
from skyrange.vehicle.builtin.commands.command import (
    ACCEPTED,
    DENIED,
    FAILED,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    Command,
    check_latlng,
    location_of,
    uint32,
)  # fmt: skip
from skyrange.vehicle.builtin.fence import fence
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.guidance import auto_yaw
from skyrange.vehicle.builtin.reboot import reboot
from skyrange.vehicle.builtin.telemetry.schedule import Schedule

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
