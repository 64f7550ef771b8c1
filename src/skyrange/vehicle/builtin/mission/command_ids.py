"""Mission commands that are supported, what ArduPilot stores of them, and its names of them.

Commands that ArduPilot stores as plain numbers: what it stores of each, which of them it skips, which it reports.
ArduCopter accepts these items and stores their parameters in its 15 bytes (AP_Mission.cpp `mavlink_int_to_mission_cmd`,
the structures of AP_Mission.h). Most are for devices, and are skipped where there is no camera, gimbal, gripper, servo
or relay: a survey that a ground station planned with camera triggers is flown as a survey.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.modes import GUIDED_COMMANDS, NAV_GUIDED_ENABLE, NAV_SCRIPT_TIME

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


NAV_WAYPOINT: Final = dialect.MAV_CMD_NAV_WAYPOINT
NAV_SPLINE_WAYPOINT: Final = dialect.MAV_CMD_NAV_SPLINE_WAYPOINT
NAV_LOITER_UNLIM: Final = dialect.MAV_CMD_NAV_LOITER_UNLIM
NAV_LOITER_TURNS: Final = dialect.MAV_CMD_NAV_LOITER_TURNS
NAV_LOITER_TIME: Final = dialect.MAV_CMD_NAV_LOITER_TIME
NAV_LOITER_TO_ALT: Final = dialect.MAV_CMD_NAV_LOITER_TO_ALT
NAV_DELAY: Final = dialect.MAV_CMD_NAV_DELAY
NAV_RETURN_TO_LAUNCH: Final = dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
NAV_LAND: Final = dialect.MAV_CMD_NAV_LAND
NAV_TAKEOFF: Final = dialect.MAV_CMD_NAV_TAKEOFF
NAV_VTOL_TAKEOFF: Final = dialect.MAV_CMD_NAV_VTOL_TAKEOFF
NAV_VTOL_LAND: Final = dialect.MAV_CMD_NAV_VTOL_LAND
NAV_ATTITUDE_TIME: Final = dialect.MAV_CMD_NAV_ATTITUDE_TIME
TAKEOFFS: Final = frozenset((NAV_TAKEOFF, NAV_VTOL_TAKEOFF))
LANDINGS: Final = frozenset((NAV_LAND, NAV_VTOL_LAND))
"""ArduCopter treats the VTOL commands as the others (ModeAuto::start_command)."""
SKIPPED_NAV: Final = frozenset(
    (
        dialect.MAV_CMD_NAV_CONTINUE_AND_CHANGE_ALT,
        dialect.MAV_CMD_NAV_ALTITUDE_WAIT,
        dialect.MAV_CMD_NAV_SET_YAW_SPEED,
    )
)
"""Navigation commands that AP_Mission stores and ArduCopter does not start: the next one follows at once."""
NAV_COMMANDS: Final = (
    frozenset(
        (
            NAV_WAYPOINT,
            NAV_SPLINE_WAYPOINT,
            NAV_LOITER_UNLIM,
            NAV_LOITER_TURNS,
            NAV_LOITER_TIME,
            NAV_LOITER_TO_ALT,
            NAV_DELAY,
            NAV_RETURN_TO_LAUNCH,
            NAV_ATTITUDE_TIME,
        )
    )
    | TAKEOFFS
    | LANDINGS
    | GUIDED_COMMANDS
    | SKIPPED_NAV
)
"""Commands that take time and are flown one after another (AP_Mission::is_nav_cmd)."""

DO_JUMP: Final = dialect.MAV_CMD_DO_JUMP
DO_JUMP_TAG: Final = dialect.MAV_CMD_DO_JUMP_TAG
JUMP_TAG: Final = dialect.MAV_CMD_JUMP_TAG
JUMPS: Final = frozenset((DO_JUMP, DO_JUMP_TAG))
DO_GUIDED_LIMITS: Final = dialect.MAV_CMD_DO_GUIDED_LIMITS
DO_AUX_FUNCTION: Final = dialect.MAV_CMD_DO_AUX_FUNCTION
DO_CHANGE_SPEED: Final = dialect.MAV_CMD_DO_CHANGE_SPEED
DO_SET_HOME: Final = dialect.MAV_CMD_DO_SET_HOME
DO_LAND_START: Final = dialect.MAV_CMD_DO_LAND_START
DO_PARACHUTE: Final = dialect.MAV_CMD_DO_PARACHUTE
DO_SET_ROI: Final = dialect.MAV_CMD_DO_SET_ROI
DO_SET_ROI_LOCATION: Final = dialect.MAV_CMD_DO_SET_ROI_LOCATION
DO_SET_ROI_NONE: Final = dialect.MAV_CMD_DO_SET_ROI_NONE
CONDITION_DELAY: Final = dialect.MAV_CMD_CONDITION_DELAY
CONDITION_DISTANCE: Final = dialect.MAV_CMD_CONDITION_DISTANCE
CONDITION_YAW: Final = dialect.MAV_CMD_CONDITION_YAW
CONDITION_COMMANDS: Final = frozenset((CONDITION_DELAY, CONDITION_DISTANCE, CONDITION_YAW))
"""Commands that delay those behind them."""

STORED_IN_LOCATION: Final = frozenset(
    (
        NAV_WAYPOINT,
        NAV_SPLINE_WAYPOINT,
        NAV_LOITER_UNLIM,
        NAV_LOITER_TURNS,
        NAV_LOITER_TIME,
        NAV_LOITER_TO_ALT,
        NAV_LAND,
        NAV_TAKEOFF,
        NAV_VTOL_TAKEOFF,
        NAV_VTOL_LAND,
        NAV_GUIDED_ENABLE,
        dialect.MAV_CMD_NAV_CONTINUE_AND_CHANGE_ALT,
        DO_SET_HOME,
        DO_LAND_START,
        dialect.MAV_CMD_DO_GO_AROUND,
        DO_SET_ROI,
        DO_SET_ROI_LOCATION,
    )
)
"""Commands that are stored with a place (AP_Mission::stored_in_location)."""
SUPPORTED: Final = (
    STORED_IN_LOCATION
    | CONDITION_COMMANDS
    | JUMPS
    | {NAV_DELAY, NAV_RETURN_TO_LAUNCH, DO_CHANGE_SPEED, DO_SET_ROI_NONE}
    | STORED_BY_FIELDS.keys()
)
"""Commands that a mission may contain; all others are refused when they are uploaded."""

COMMAND_NAMES: Final = {
    NAV_WAYPOINT: "WP",
    NAV_SPLINE_WAYPOINT: "SplineWP",
    NAV_RETURN_TO_LAUNCH: "RTL",
    NAV_LOITER_UNLIM: "LoitUnlim",
    NAV_LOITER_TIME: "LoitTime",
    NAV_LOITER_TURNS: "LoitTurns",
    NAV_LOITER_TO_ALT: "LoitAltitude",
    NAV_TAKEOFF: "Takeoff",
    NAV_LAND: "Land",
    NAV_DELAY: "Delay",
    NAV_VTOL_TAKEOFF: "VTOLTakeoff",
    NAV_VTOL_LAND: "VTOLLand",
    NAV_GUIDED_ENABLE: "GuidedEnable",
    NAV_SCRIPT_TIME: "NavScriptTime",
    NAV_ATTITUDE_TIME: "NavAttitudeTime",
    dialect.MAV_CMD_NAV_CONTINUE_AND_CHANGE_ALT: "ContinueAndChangeAlt",
    dialect.MAV_CMD_NAV_ALTITUDE_WAIT: "AltitudeWait",
    dialect.MAV_CMD_NAV_SET_YAW_SPEED: "SetYawSpd",
    JUMP_TAG: "Tag",
    DO_GUIDED_LIMITS: "GuidedLimits",
    dialect.MAV_CMD_DO_GO_AROUND: "Go Around",
    dialect.MAV_CMD_DO_PAUSE_CONTINUE: "PauseContinue",
    dialect.MAV_CMD_DO_SET_REVERSE: "SetReverse",
    dialect.MAV_CMD_DO_INVERTED_FLIGHT: "InvertedFlight",
    dialect.MAV_CMD_DO_AUTOTUNE_ENABLE: "AutoTuneEnable",
    dialect.MAV_CMD_DO_SEND_SCRIPT_MESSAGE: "Scripting",
    dialect.MAV_CMD_DO_ENGINE_CONTROL: "EngineControl",
    dialect.MAV_CMD_SET_CAMERA_SOURCE: "SetCameraSource",
    dialect.MAV_CMD_DO_VTOL_TRANSITION: "VTOLTransition",
    CONDITION_DELAY: "CondDelay",
    CONDITION_DISTANCE: "CondDist",
    CONDITION_YAW: "CondYaw",
    DO_CHANGE_SPEED: "ChangeSpeed",
    DO_SET_HOME: "SetHome",
    DO_SET_ROI: "SetROI",
    DO_SET_ROI_LOCATION: "SetROILocation",
    DO_SET_ROI_NONE: "SetROINone",
    DO_LAND_START: "LandStart",
    dialect.MAV_CMD_DO_SET_RELAY: "SetRelay",
    dialect.MAV_CMD_DO_REPEAT_RELAY: "RepeatRelay",
    dialect.MAV_CMD_DO_SET_SERVO: "SetServo",
    dialect.MAV_CMD_DO_REPEAT_SERVO: "RepeatServo",
    dialect.MAV_CMD_DO_DIGICAM_CONFIGURE: "DigiCamCfg",
    dialect.MAV_CMD_DO_DIGICAM_CONTROL: "DigiCamCtrl",
    dialect.MAV_CMD_DO_MOUNT_CONTROL: "MountControl",
    dialect.MAV_CMD_DO_SET_CAM_TRIGG_DIST: "SetCamTrigDst",
    dialect.MAV_CMD_DO_FENCE_ENABLE: "FenceEnable",
    DO_PARACHUTE: "Parachute",
    dialect.MAV_CMD_DO_GRIPPER: "Gripper",
    dialect.MAV_CMD_DO_SPRAYER: "Sprayer",
    DO_AUX_FUNCTION: "AuxFunction",
    dialect.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: "GimbalPitchYaw",
    dialect.MAV_CMD_IMAGE_START_CAPTURE: "ImageStartCapture",
    dialect.MAV_CMD_IMAGE_STOP_CAPTURE: "ImageStopCapture",
    dialect.MAV_CMD_SET_CAMERA_ZOOM: "SetCameraZoom",
    dialect.MAV_CMD_SET_CAMERA_FOCUS: "SetCameraFocus",
    dialect.MAV_CMD_VIDEO_START_CAPTURE: "VideoStartCapture",
    dialect.MAV_CMD_VIDEO_STOP_CAPTURE: "VideoStopCapture",
    dialect.MAV_CMD_DO_WINCH: "Winch",
}
"""ArduPilot's name of a command in the text sent when it starts (AP_Mission.cpp `Mission_Command::type`)."""
