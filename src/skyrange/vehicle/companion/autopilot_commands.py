"""Commands of a companion to its autopilot: the few MAVLink messages it sends, as ArduCopter expects them.

GCS_MAVLink_Copter.cpp and GCS_Common.cpp: DO_SET_MODE, SET_MESSAGE_INTERVAL by COMMAND_LONG, and
SET_POSITION_TARGET_GLOBAL_INT in GUIDED, from component 191 of the aircraft's own system.
"""

from __future__ import annotations

from typing import Final

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.geodesy import Origin
from skyrange.vehicle.avoidance.contract import Vector

COMPONENT: Final = int(mav.MAV_COMP_ID_ONBOARD_COMPUTER)
"""191."""
AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)
AUTO: Final = int(mav.COPTER_MODE_AUTO)
GUIDED: Final = int(mav.COPTER_MODE_GUIDED)
RTL: Final = int(mav.COPTER_MODE_RTL)

_POSITION_ONLY: Final = 0b110111111000
_VELOCITY_ONLY: Final = 0b110111000111
"""POSITION_TARGET_TYPEMASK: what is ignored. Acceleration, yaw and yaw rate are always ignored."""


def set_mode(system: int, mode: int) -> Message:
    """DO_SET_MODE."""
    return mav.MAVLink_command_long_message(
        system, AUTOPILOT, mav.MAV_CMD_DO_SET_MODE, 0, mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mode, 0, 0, 0, 0, 0
    )


def set_speed(system: int, speed_mps: float) -> Message:
    """DO_CHANGE_SPEED over ground: ArduCopter forgets the mission's speed with every change of mode."""
    return mav.MAVLink_command_long_message(
        system, AUTOPILOT, mav.MAV_CMD_DO_CHANGE_SPEED, 0, mav.SPEED_TYPE_GROUNDSPEED, speed_mps, -1, 0, 0, 0, 0
    )


def set_interval(system: int, message: int, interval_us: int) -> Message:
    """SET_MESSAGE_INTERVAL."""
    return mav.MAVLink_command_long_message(
        system, AUTOPILOT, mav.MAV_CMD_SET_MESSAGE_INTERVAL, 0, message, interval_us, 0, 0, 0, 0, 0
    )


def go_to(system: int, boot_ms: int, origin: Origin, place: Vector) -> Message:
    """Fly to a position and stay there."""
    lat, lon = origin.geodetic_of(place[0], place[1])
    return mav.MAVLink_set_position_target_global_int_message(
        boot_ms, system, AUTOPILOT, mav.MAV_FRAME_GLOBAL_INT, _POSITION_ONLY, round(lat * 1e7), round(lon * 1e7),
        origin.alt_msl_m + place[2], 0, 0, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def hold(system: int, boot_ms: int) -> Message:
    """Stop: a velocity of 0, which ArduCopter keeps after the command expires (GUID_TIMEOUT)."""
    return mav.MAVLink_set_position_target_global_int_message(
        boot_ms, system, AUTOPILOT, mav.MAV_FRAME_GLOBAL_INT, _VELOCITY_ONLY, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0
    )


def arm_status(trouble: str) -> Message:
    """OPEN_DRONE_ID_ARM_STATUS: good, or the reason why not."""
    status = mav.MAV_ODID_ARM_STATUS_PRE_ARM_FAIL_GENERIC if trouble else mav.MAV_ODID_ARM_STATUS_GOOD_TO_ARM
    return mav.MAVLink_open_drone_id_arm_status_message(status, trouble.encode()[:50])
