"""Mission commands that are supported, by group, and ArduPilot's names of them."""

from __future__ import annotations

from typing import Final

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.mission_fittings import FITTINGS

WAYPOINT: Final = dialect.MAV_CMD_NAV_WAYPOINT
SPLINE: Final = dialect.MAV_CMD_NAV_SPLINE_WAYPOINT
UNLIM: Final = dialect.MAV_CMD_NAV_LOITER_UNLIM
TURNS: Final = dialect.MAV_CMD_NAV_LOITER_TURNS
TIME: Final = dialect.MAV_CMD_NAV_LOITER_TIME
TO_ALT: Final = dialect.MAV_CMD_NAV_LOITER_TO_ALT
DELAY: Final = dialect.MAV_CMD_NAV_DELAY
RTL: Final = dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
LAND: Final = dialect.MAV_CMD_NAV_LAND
TAKEOFF: Final = dialect.MAV_CMD_NAV_TAKEOFF
NAVIGATION: Final = frozenset((WAYPOINT, SPLINE, UNLIM, TURNS, TIME, TO_ALT, DELAY, RTL, LAND, TAKEOFF))
"""Commands that take time and are flown one after another."""

JUMP: Final = dialect.MAV_CMD_DO_JUMP
SPEED: Final = dialect.MAV_CMD_DO_CHANGE_SPEED
SET_HOME: Final = dialect.MAV_CMD_DO_SET_HOME
LAND_START: Final = dialect.MAV_CMD_DO_LAND_START
PARACHUTE: Final = dialect.MAV_CMD_DO_PARACHUTE
ROI: Final = dialect.MAV_CMD_DO_SET_ROI
ROI_LOCATION: Final = dialect.MAV_CMD_DO_SET_ROI_LOCATION
ROI_NONE: Final = dialect.MAV_CMD_DO_SET_ROI_NONE
WAIT: Final = dialect.MAV_CMD_CONDITION_DELAY
NEAR: Final = dialect.MAV_CMD_CONDITION_DISTANCE
YAW: Final = dialect.MAV_CMD_CONDITION_YAW
CONDITIONS: Final = frozenset((WAIT, NEAR, YAW))
"""Commands that delay those behind them."""

LOCATED: Final = frozenset(
    (WAYPOINT, SPLINE, UNLIM, TURNS, TIME, TO_ALT, LAND, TAKEOFF, SET_HOME, LAND_START, ROI, ROI_LOCATION, ROI_NONE)
)
"""Commands that are stored with a place (AP_Mission::stored_in_location)."""
SUPPORTED: Final = LOCATED | CONDITIONS | {DELAY, RTL, JUMP, SPEED} | FITTINGS.keys()

NAMES: Final = {
    WAYPOINT: "WP",
    SPLINE: "SplineWP",
    RTL: "RTL",
    UNLIM: "LoitUnlim",
    TIME: "LoitTime",
    TURNS: "LoitTurns",
    TO_ALT: "LoitAltitude",
    TAKEOFF: "Takeoff",
    LAND: "Land",
    DELAY: "Delay",
    WAIT: "CondDelay",
    NEAR: "CondDist",
    YAW: "CondYaw",
    SPEED: "ChangeSpeed",
    SET_HOME: "SetHome",
    ROI: "SetROI",
    ROI_LOCATION: "SetROILocation",
    ROI_NONE: "SetROINone",
    LAND_START: "LandStart",
    dialect.MAV_CMD_DO_SET_RELAY: "SetRelay",
    dialect.MAV_CMD_DO_REPEAT_RELAY: "RepeatRelay",
    dialect.MAV_CMD_DO_SET_SERVO: "SetServo",
    dialect.MAV_CMD_DO_REPEAT_SERVO: "RepeatServo",
    dialect.MAV_CMD_DO_DIGICAM_CONFIGURE: "DigiCamCfg",
    dialect.MAV_CMD_DO_DIGICAM_CONTROL: "DigiCamCtrl",
    dialect.MAV_CMD_DO_MOUNT_CONTROL: "MountControl",
    dialect.MAV_CMD_DO_SET_CAM_TRIGG_DIST: "SetCamTrigDst",
    dialect.MAV_CMD_DO_FENCE_ENABLE: "FenceEnable",
    PARACHUTE: "Parachute",
    dialect.MAV_CMD_DO_GRIPPER: "Gripper",
    dialect.MAV_CMD_DO_SPRAYER: "Sprayer",
    dialect.MAV_CMD_DO_AUX_FUNCTION: "AuxFunction",
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
