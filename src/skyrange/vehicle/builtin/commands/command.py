"""A received command: COMMAND_INT, or COMMAND_LONG converted to one, and the conversion of its fields.

https://mavlink.io/en/services/command.html and `convert_COMMAND_LONG_to_COMMAND_INT`, `location_from_command_t`,
`mav_frame_for_command_long` of libraries/GCS_MAVLink/GCS_Common.cpp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle
from skyrange.vehicle.builtin.locations import (
    ABSOLUTE_FRAMES,
    RELATIVE_FRAMES,
    TERRAIN_FRAMES,
    altitude_datum_m,
)

ACCEPTED: Final = int(mav.MAV_RESULT_ACCEPTED)
DENIED: Final = int(mav.MAV_RESULT_DENIED)
FAILED: Final = int(mav.MAV_RESULT_FAILED)
UNSUPPORTED: Final = int(mav.MAV_RESULT_UNSUPPORTED)
TEMPORARILY_REJECTED: Final = int(mav.MAV_RESULT_TEMPORARILY_REJECTED)

ALT_MAX_M: Final = 83_000.0
"""LOCATION_ALT_MAX_M (AP_Common/Location.h)."""
_LOCATED: Final = frozenset(
    (
        mav.MAV_CMD_DO_SET_HOME,
        mav.MAV_CMD_DO_SET_ROI,
        mav.MAV_CMD_DO_SET_ROI_LOCATION,
        mav.MAV_CMD_DO_REPOSITION,
        mav.MAV_CMD_EXTERNAL_POSITION_ESTIMATE,
    )
)
"""Commands whose params 5 and 6 are degrees, as integers 1e-7 degrees (`command_long_stores_location`)."""
_FRAME_OF_LONG: Final = {
    mav.MAV_CMD_DO_SET_ROI: mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mav.MAV_CMD_DO_SET_ROI_LOCATION: mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mav.MAV_CMD_DO_SET_HOME: mav.MAV_FRAME_GLOBAL,
}
"""The frame of a COMMAND_LONG with a place; one without a row here is not accepted as COMMAND_LONG."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command with its parameters; `x` and `y` are integers, `frame` is a MAV_FRAME, `peer` its sender."""

    number: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    frame: int
    peer: tuple[int, int]
    causes: Causes
    after: list[int] = field(default_factory=list)
    """Messages that follow the acknowledgement."""


def decode_command(message: Any, peer: tuple[int, int], causes: Causes) -> Command | None:
    """Return the command of a COMMAND_INT or COMMAND_LONG; `None` where it is not accepted as COMMAND_LONG."""
    params = (message.param1, message.param2, message.param3, message.param4)
    number = message.command
    if message.get_msgId() == mav.MAVLINK_MSG_ID_COMMAND_INT:
        return Command(number, params, message.x, message.y, message.z, message.frame, peer, causes)
    frame = int(mav.MAV_FRAME_GLOBAL_RELATIVE_ALT)
    scale = 1.0
    if number in _LOCATED:
        if number not in _FRAME_OF_LONG:
            return None
        frame, scale = int(_FRAME_OF_LONG[number]), 1e7
    x, y = (0 if math.isnan(part) else int32(part * scale) for part in (message.param5, message.param6))
    return Command(number, params, x, y, message.param7, frame, peer, causes)


def int32(value: float) -> int:
    """Convert a float to a signed 32-bit integer; what does not fit, or is not a number, becomes the minimum.

    The minimum is a valid value of no field. ArduPilot leaves this conversion to the compiler; x86 gives this result.
    """
    return int(value) if -(2.0**31) < value < 2.0**31 else -(2**31)


def uint32(value: float) -> int:
    """Convert a float to an unsigned 32-bit integer; what does not fit becomes the maximum.

    ArduPilot may read 0 instead, which can be a valid value.
    """
    return int(value) if -1.0 < value < 2.0**32 else 2**32 - 1


def uint8(value: float) -> int:
    """Return the lowest byte of `uint32`."""
    return uint32(value) & 0xFF


def check_latlng(x: int, y: int) -> bool:
    """Whether these are a latitude and a longitude in 1e-7 degrees (AP_Math/location.cpp `check_latlng`)."""
    return abs(x) <= 900_000_000 and abs(y) <= 1_800_000_000


def location_of(fleet: Fleet, vehicle: Vehicle, command: Command) -> tuple[float, float, float] | None:
    """Return the command's place in ENU metres; `None` for an invalid altitude or frame. Terrain is flat."""
    if not abs(command.z) <= ALT_MAX_M:
        return None
    if command.frame not in RELATIVE_FRAMES | TERRAIN_FRAMES | ABSOLUTE_FRAMES:
        return None
    held = (max(min(command.x, 900_000_000), -900_000_000), max(min(command.y, 1_800_000_000), -1_800_000_000))
    east, north = fleet.origin.enu_of(held[0] * 1e-7, held[1] * 1e-7)
    return east, north, command.z + altitude_datum_m(fleet, vehicle, command.frame)


def is_relative(command: Command) -> bool:
    """Whether the altitude is above home or terrain."""
    return command.frame in RELATIVE_FRAMES or command.frame in TERRAIN_FRAMES
