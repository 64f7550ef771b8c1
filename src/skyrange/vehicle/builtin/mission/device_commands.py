"""DO commands for devices that are not fitted: what ArduPilot stores of each, and whether it reports it.

ArduCopter accepts these items, stores their parameters in its 15 bytes (AP_Mission.cpp `mavlink_int_to_mission_cmd`,
the structures of AP_Mission.h), and skips them where there is no camera, gimbal, gripper, servo or relay: a survey
that a ground station planned with camera triggers is flown as a survey.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from skyrange.codec.mavlink import dialect as mav

DO_FENCE_ENABLE: Final = mav.MAV_CMD_DO_FENCE_ENABLE
"""The only one of them that has an effect."""

_RANGES: Final = {"B": (0, 255), "b": (-128, 127), "H": (0, 65_535), "h": (-32_768, 32_767)}

DEVICE_COMMANDS: Final = {
    mav.MAV_CMD_DO_SET_RELAY: "BB-----",
    mav.MAV_CMD_DO_REPEAT_RELAY: "Bhf----",
    mav.MAV_CMD_DO_SET_SERVO: "BH-----",
    mav.MAV_CMD_DO_REPEAT_SERVO: "BHhf---",
    mav.MAV_CMD_DO_DIGICAM_CONFIGURE: "BHBHBBf",
    mav.MAV_CMD_DO_DIGICAM_CONTROL: "BBbBBB-",
    mav.MAV_CMD_DO_MOUNT_CONTROL: "fff----",
    mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST: "f-B----",
    DO_FENCE_ENABLE: "H------",
    mav.MAV_CMD_DO_PARACHUTE: "H------",
    mav.MAV_CMD_DO_GRIPPER: "BB-----",
    mav.MAV_CMD_DO_SPRAYER: "H------",
    mav.MAV_CMD_DO_AUX_FUNCTION: "HB-----",
    mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: "bhbbB-B",
    mav.MAV_CMD_IMAGE_START_CAPTURE: "BfHH---",
    mav.MAV_CMD_IMAGE_STOP_CAPTURE: "H------",
    mav.MAV_CMD_SET_CAMERA_ZOOM: "Bf-----",
    mav.MAV_CMD_SET_CAMERA_FOCUS: "Bf-----",
    mav.MAV_CMD_VIDEO_START_CAPTURE: "B------",
    mav.MAV_CMD_VIDEO_STOP_CAPTURE: "H------",
    mav.MAV_CMD_DO_WINCH: "BBff---",
}
"""What is stored of param1 … param4, x, y and z: integers as `struct` names them, `f` a float, `-` nothing."""

REPORTED: Final = frozenset((mav.MAV_CMD_DO_MOUNT_CONTROL, DO_FENCE_ENABLE, mav.MAV_CMD_DO_WINCH))
"""Commands reported with MISSION_ITEM_REACHED (ModeAuto::verify_command); AP_Mission skips the others silently."""


def stored_fields(command: int, values: Sequence[float]) -> tuple[float, ...]:
    """Return the seven numbers of such an item as ArduPilot stores them; a value that is not a number becomes 0."""
    return tuple(_stored_field(kind, value) for kind, value in zip(DEVICE_COMMANDS[command], values, strict=True))


def _stored_field(kind: str, value: float) -> float:
    if kind == "-" or not math.isfinite(value):
        return 0.0
    if kind == "f":
        return float(np.float32(value))
    low, high = _RANGES[kind]
    return float(int(min(max(value, low), high)))
