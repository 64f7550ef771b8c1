"""System commands: reboot, erasing parameters, calibration, fence, regions of interest, devices that are not fitted.

After `handle_preflight_reboot`, `handle_command_preflight_calibration` and others of
libraries/GCS_MAVLink/GCS_Common.cpp. Commands that ArduCopter answers with UNSUPPORTED have no handler.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin import facing, fence, prearm
from skyrange.vehicle.builtin.boot import reboot
from skyrange.vehicle.builtin.commands.command import (
    ACCEPTED,
    BUSY,
    DENIED,
    FAILED,
    UNSUPPORTED,
    Command,
    on_earth,
    place,
    uint32,
)  # fmt: skip
from skyrange.vehicle.builtin.fleet import Craft, Fleet
from skyrange.vehicle.builtin.telemetry.schedule import Schedule

_FORCE_REBOOT: Final = 20_190_226
_PARACHUTE_ACTIONS: Final = 3


def restart(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int | None:
    """PREFLIGHT_REBOOT_SHUTDOWN: disarmed, or (20190226 in param6) in any state. Acknowledged before the reboot."""
    if fleet.armed(craft) and command.y != _FORCE_REBOOT:
        return FAILED
    if command.params[0] not in (1.0, 3.0):
        return UNSUPPORTED
    ack = mav.MAVLink_command_ack_message(command.number, ACCEPTED, 0, 0, *command.partner)
    fleet.send(craft, ack, command.causes)
    reboot(fleet, schedule, craft, command.causes)
    return None


def erase(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """PREFLIGHT_STORAGE: 2 erases all parameters, with effect at the next boot."""
    if command.params[0] != 2.0:
        return DENIED
    craft.erased = True
    fleet.text(craft, mav.MAV_SEVERITY_WARNING, "All parameters reset, reboot board", command.causes)
    return ACCEPTED


def calibrate(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """PREFLIGHT_CALIBRATION: gyros or barometer, disarmed; neither needs calibration here."""
    if fleet.armed(craft):
        fleet.text(craft, mav.MAV_SEVERITY_NOTICE, "Disarm to allow calibration", command.causes)
        return FAILED
    return ACCEPTED if command.params[0] == 1.0 or command.params[2] == 1.0 else UNSUPPORTED


def check_prearm(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """RUN_PREARM_CHECKS: report what prevents arming, if anything does."""
    if fleet.armed(craft):
        return BUSY
    prearm.report(fleet, craft, command.causes)
    return ACCEPTED


def enable_fence(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """DO_FENCE_ENABLE."""
    what, kinds = command.params[:2]
    if not (math.isfinite(what) and math.isfinite(kinds)):
        return DENIED
    return fence.command(fleet, craft, int(what), int(kinds))


def look_at(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """DO_SET_ROI, DO_SET_ROI_LOCATION: set a region of interest."""
    where = place(fleet, craft, command)
    if where is None:
        return DENIED
    if not on_earth(command.x, command.y):
        return FAILED
    nowhere = command.x == 0 and command.y == 0 and command.z == 0.0
    facing.look_at(fleet, craft, None if nowhere else where)
    return ACCEPTED


def look_ahead(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """DO_SET_ROI_NONE: return to the default yaw mode."""
    facing.look_at(fleet, craft, None)
    return ACCEPTED


def parachute(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """DO_PARACHUTE: accepted as by ArduCopter, though none is fitted."""
    return ACCEPTED if uint32(command.params[0]) & 0xFFFF < _PARACHUTE_ACTIONS else FAILED


def trap(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """DEBUG_TRAP: not supported."""
    return UNSUPPORTED if uint32(command.params[0]) == 32_451 else DENIED


def aux_function(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """DO_AUX_FUNCTION: a switch in one of three positions, without a function."""
    return DENIED if command.params[1] > 2.0 else FAILED


def not_fitted(fleet: Fleet, schedule: Schedule, craft: Craft, command: Command) -> int:
    """Fail commands that ArduCopter supports, for devices that are not fitted."""
    return FAILED
