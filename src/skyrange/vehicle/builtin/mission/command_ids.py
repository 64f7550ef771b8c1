"""Mission commands that are supported, by group, and ArduPilot's names of them."""

from __future__ import annotations

from typing import Final

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.mission.stored_commands import STORED_BY_FIELDS
from skyrange.vehicle.builtin.modes import GUIDED_COMMANDS, NAV_GUIDED_ENABLE, NAV_SCRIPT_TIME

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
