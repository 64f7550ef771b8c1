"""Commands that ArduPilot stores as plain numbers: what it stores of each, which of them it skips, which it reports.

ArduCopter accepts these items and stores their parameters in its 15 bytes (AP_Mission.cpp `mavlink_int_to_mission_cmd`,
the structures of AP_Mission.h). Most are for devices, and are skipped where there is no camera, gimbal, gripper, servo
or relay: a survey that a ground station planned with camera triggers is flown as a survey.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from skyrange.codec.mavlink import dialect as mav

DO_FENCE_ENABLE: Final = mav.MAV_CMD_DO_FENCE_ENABLE

_RANGES: Final = {"B": (0, 255), "b": (-128, 127), "H": (0, 65_535), "h": (-32_768, 32_767)}

STORED_BY_FIELDS: Final = {
    mav.MAV_CMD_NAV_ALTITUDE_WAIT: "ffB----",
    mav.MAV_CMD_DO_SET_RELAY: "BB-----",
    mav.MAV_CMD_DO_REPEAT_RELAY: "Bhf----",
    mav.MAV_CMD_DO_SET_SERVO: "BH-----",
    mav.MAV_CMD_DO_REPEAT_SERVO: "BHhf---",
    mav.MAV_CMD_DO_PAUSE_CONTINUE: "H------",
    mav.MAV_CMD_DO_SET_REVERSE: "H------",
    mav.MAV_CMD_DO_DIGICAM_CONFIGURE: "BHBHBBf",
    mav.MAV_CMD_DO_DIGICAM_CONTROL: "BBbBBB-",
    mav.MAV_CMD_DO_MOUNT_CONTROL: "fff----",
    mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST: "f-B----",
    DO_FENCE_ENABLE: "H------",
    mav.MAV_CMD_DO_PARACHUTE: "H------",
    mav.MAV_CMD_DO_INVERTED_FLIGHT: "H------",
    mav.MAV_CMD_DO_GRIPPER: "BB-----",
    mav.MAV_CMD_DO_AUTOTUNE_ENABLE: "H------",
    mav.MAV_CMD_NAV_SET_YAW_SPEED: "ffB----",
    mav.MAV_CMD_DO_SPRAYER: "H------",
    mav.MAV_CMD_DO_SEND_SCRIPT_MESSAGE: "Hfff---",
    mav.MAV_CMD_DO_AUX_FUNCTION: "HB-----",
    mav.MAV_CMD_DO_GUIDED_LIMITS: "Hfff---",
    mav.MAV_CMD_DO_ENGINE_CONTROL: "??c1---",
    mav.MAV_CMD_JUMP_TAG: "H------",
    mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: "bhbbB-B",
    mav.MAV_CMD_IMAGE_START_CAPTURE: "BfHH---",
    mav.MAV_CMD_IMAGE_STOP_CAPTURE: "H------",
    mav.MAV_CMD_SET_CAMERA_ZOOM: "Bf-----",
    mav.MAV_CMD_SET_CAMERA_FOCUS: "Bf-----",
    mav.MAV_CMD_SET_CAMERA_SOURCE: "BBB----",
    mav.MAV_CMD_VIDEO_START_CAPTURE: "B------",
    mav.MAV_CMD_VIDEO_STOP_CAPTURE: "H------",
    mav.MAV_CMD_DO_VTOL_TRANSITION: "B------",
    mav.MAV_CMD_DO_WINCH: "BBff---",
    mav.MAV_CMD_NAV_SCRIPT_TIME: "BBeehh-",
    mav.MAV_CMD_NAV_ATTITUDE_TIME: "Hrpyh--",
}
"""What is stored of param1 … param4, x, y and z: integers as `struct` names them, `e` and `f` floats, `-` nothing.

`?` is whether it is above 0, `1` its lowest bit, `c` metres in whole centimetres; `r`, `p` and `y` are whole
degrees of roll, pitch and yaw, 0 where they are beyond 180, 90 and -180…360.
"""

SKIPPED: Final = frozenset(
    (
        mav.MAV_CMD_DO_GO_AROUND,
        mav.MAV_CMD_DO_PAUSE_CONTINUE,
        mav.MAV_CMD_DO_SET_REVERSE,
        mav.MAV_CMD_DO_INVERTED_FLIGHT,
        mav.MAV_CMD_DO_AUTOTUNE_ENABLE,
        mav.MAV_CMD_DO_ENGINE_CONTROL,
        mav.MAV_CMD_DO_VTOL_TRANSITION,
    )
)
"""DO commands that AP_Mission stores and ArduCopter passes over with a text, and reports (ModeAuto::verify_command)."""

SILENT: Final = frozenset(
    (
        mav.MAV_CMD_DO_SET_RELAY,
        mav.MAV_CMD_DO_REPEAT_RELAY,
        mav.MAV_CMD_DO_SET_SERVO,
        mav.MAV_CMD_DO_REPEAT_SERVO,
        mav.MAV_CMD_DO_DIGICAM_CONFIGURE,
        mav.MAV_CMD_DO_DIGICAM_CONTROL,
        mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
        mav.MAV_CMD_DO_PARACHUTE,
        mav.MAV_CMD_DO_GRIPPER,
        mav.MAV_CMD_DO_SPRAYER,
        mav.MAV_CMD_DO_SEND_SCRIPT_MESSAGE,
        mav.MAV_CMD_DO_AUX_FUNCTION,
        mav.MAV_CMD_JUMP_TAG,
        mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
        mav.MAV_CMD_IMAGE_START_CAPTURE,
        mav.MAV_CMD_IMAGE_STOP_CAPTURE,
        mav.MAV_CMD_SET_CAMERA_ZOOM,
        mav.MAV_CMD_SET_CAMERA_FOCUS,
        mav.MAV_CMD_SET_CAMERA_SOURCE,
        mav.MAV_CMD_VIDEO_START_CAPTURE,
        mav.MAV_CMD_VIDEO_STOP_CAPTURE,
    )
)
"""Commands that AP_Mission completes itself, without MISSION_ITEM_REACHED (AP_Mission::verify_command)."""

NO_EFFECT_FUNCTIONS: Final = frozenset(
    (0, 9, 15, 19, 27, 28, 29, 30, 34, 35, 36, 44, 45, 66, 67, 78, 79, 94, 102, 113, 163, 164, 166, 167, 168, 169, 174,
     175, 177)
)  # fmt: skip
"""Auxiliary functions of devices that are not fitted: cameras, gimbals, relays, grippers, sprayers, landing gear,
winches, video, logs, buzzers (RC_Channel.h `AUX_FUNC`)."""
MODE_FUNCTIONS: Final = {4: 6, 16: 3, 18: 9, 33: 17, 55: 4, 56: 5, 68: 0, 70: 2, 99: 27}
"""Auxiliary functions that change the mode, with its number (RC_Channel_Copter::do_aux_function)."""
FENCE_FUNCTION: Final = 11
DISARM_FUNCTION: Final = 81
ARM_DISARM_FUNCTION: Final = 153
_FUNCTIONS: Final = NO_EFFECT_FUNCTIONS | MODE_FUNCTIONS.keys() | {FENCE_FUNCTION, DISARM_FUNCTION, ARM_DISARM_FUNCTION}
_PARACHUTE_ENABLE: Final = 1


def is_modelled(command: int, param1: float) -> bool:
    """Whether such an item does here what it does in ArduCopter: not every auxiliary function and parachute action."""
    if command == mav.MAV_CMD_DO_AUX_FUNCTION:
        return int(param1) in _FUNCTIONS
    return command != mav.MAV_CMD_DO_PARACHUTE or int(param1) != _PARACHUTE_ENABLE


def stored_fields(command: int, values: Sequence[float]) -> tuple[float, ...]:
    """Return the seven numbers of such an item as ArduPilot stores them; a value that is not a number becomes 0."""
    return tuple(_stored_field(kind, value) for kind, value in zip(STORED_BY_FIELDS[command], values, strict=True))


def _stored_field(kind: str, value: float) -> float:
    if kind == "-" or not math.isfinite(value):
        return 0.0
    if kind == "f":
        return float(np.float32(value))
    if kind == "e":
        return float(np.float16(value)) if abs(value) < 65_520.0 else math.copysign(65_504.0, value)
    if kind == "?":
        return float(value > 0.0)
    if kind == "1":
        return float(int(min(max(value, 0.0), 2.0**31)) & 1)
    if kind == "c":
        return int(min(max(value * 100.0, 0.0), 65_535.0)) * 0.01
    if kind in _DEGREES:
        low, high = _DEGREES[kind]
        return float(int(value)) if low <= value <= high else 0.0
    low, high = _RANGES[kind]
    return float(int(min(max(value, low), high)))


_DEGREES: Final = {"r": (-180, 180), "p": (-90, 90), "y": (-180, 360)}
