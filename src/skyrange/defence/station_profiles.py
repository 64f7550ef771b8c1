"""Profiles of ground stations: messages, commands and modes that a station sends in flight, for allow lists.

Read in the public sources of the stations. What a station sends on the ground alone, such as calibration, a test of
motors, a reboot, formatting of a card, new firmware or a signing key, is left out: allow it by name, or set up without
the firewall.

- QGroundControl (`mavlink/qgroundcontrol`, master of 2025): `Vehicle.cc` (`setFlightMode`, `setArmed`,
  `requestDataStream`, `_sendQGCTimeToVehicle`, `guidedModeOrbit`, `guidedModeROI`, `setCurrentMissionSequence`,
  `doSetHome`, `sendJoystickDataThreadSafe`, `requestMessage`, `_ackMavlinkLogData`), `APMFirmwarePlugin.cc`
  (`guidedModeGotoLocation`, `guidedModeChangeAltitude`, `guidedModeChangeHeading`, `sendGCSMotionReport`),
  `InitialConnectStateMachine.cc`, `ParameterManager.cc` (`_sendParamSetToVehicle`), `FTPManager.cc`
  (`_sendRequestExpectAck`), `PlanManager.cc`, `MissionManager.cc` (`writeArduPilotGuidedMissionItem`),
  `GimbalController.cc`, `VehicleCameraControl.cc`, `TerrainProtocolHandler.cc` (`_sendTerrainData`),
  `RemoteIDManager.cc`, `MultiVehicleManager.cc` (`_sendGCSHeartbeat`).
- Mission Planner (`ArduPilot/MissionPlanner` a2fcd74d): `ExtLibs/ArduPilot/Mavlink/MAVLinkInterface.cs` (`setMode`,
  which sends DO_SET_MODE and SET_MODE; `setParam`, `getDatastream`, `setWP`, `doCommandAsync`, `doCommandIntAsync`,
  `setPositionTargetGlobalInt`, `InjectGpsData`, the answer to TIMESYNC), `MAVFtp.cs`, `CameraProtocol.cs`,
  `GimbalManagerProtocol.cs`, `ExtLibs/ArduPilot/Joystick/JoystickBase.cs`, `GCSViews/FlightData.cs`.
- MAVProxy (`ArduPilot/MAVProxy` f76c4d3d), without what its command `long` sends by any name: `mavproxy.py` (heartbeat,
  REQUEST_DATA_STREAM), `mavproxy_link.py` (TIMESYNC), `mavproxy_mode.py`, `mavproxy_arm.py`, `mavproxy_cmdlong.py`,
  `mavproxy_param.py`, `mavproxy_ftp.py`, `mavproxy_rc.py`, `mavproxy_wp.py`, `lib/mission_item_protocol.py`,
  `mavproxy_terrain.py`, `mavproxy_misc.py`.

Modes are an operator's choice: a station offers all that the autopilot has. Those of a pilot at a stick are in the
three profiles, and ACRO, SPORT, FLIP, THROW, TURTLE and others that nobody flies a mission in are not (*assumed*).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class StationProfile:
    """What a ground station sends to an aircraft in flight."""

    messages: tuple[str, ...]
    commands: tuple[str, ...]
    """In COMMAND_LONG and COMMAND_INT, without MAV_CMD_."""
    modes: tuple[str, ...]
    guided_items: bool = False
    """Whether it sends the aircraft to a place in GUIDED by a mission item with `current` 2, or 3 for its altitude."""


_MISSION: Final = (
    "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_REQUEST_LIST", "MISSION_REQUEST_INT", "MISSION_ACK",
)  # fmt: skip
_STATION: Final = (
    "HEARTBEAT", "COMMAND_LONG", "COMMAND_INT", *_MISSION, "MISSION_ITEM", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT",
    "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET", "FILE_TRANSFER_PROTOCOL", "REQUEST_DATA_STREAM",
    "MANUAL_CONTROL", "GPS_RTCM_DATA", "TERRAIN_DATA", "GIMBAL_MANAGER_SET_ATTITUDE",
    "OPEN_DRONE_ID_BASIC_ID", "OPEN_DRONE_ID_OPERATOR_ID", "OPEN_DRONE_ID_SELF_ID", "OPEN_DRONE_ID_SYSTEM",
)  # fmt: skip
"""What all three send."""
_COMMANDS: Final = (
    "SET_MESSAGE_INTERVAL", "REQUEST_MESSAGE", "REQUEST_AUTOPILOT_CAPABILITIES", "DO_SET_MODE", "COMPONENT_ARM_DISARM",
    "MISSION_START", "NAV_TAKEOFF", "DO_CHANGE_SPEED", "DO_SET_HOME", "DO_GO_AROUND", "RUN_PREARM_CHECKS",
)  # fmt: skip
_CAMERA: Final = (
    "REQUEST_CAMERA_INFORMATION", "REQUEST_CAMERA_SETTINGS", "REQUEST_STORAGE_INFORMATION",
    "REQUEST_CAMERA_CAPTURE_STATUS", "REQUEST_VIDEO_STREAM_INFORMATION", "SET_CAMERA_MODE", "SET_CAMERA_ZOOM",
    "IMAGE_START_CAPTURE", "IMAGE_STOP_CAPTURE", "VIDEO_START_CAPTURE", "VIDEO_STOP_CAPTURE",
    "VIDEO_START_STREAMING", "VIDEO_STOP_STREAMING", "CAMERA_TRACK_POINT", "CAMERA_TRACK_RECTANGLE",
    "DO_DIGICAM_CONTROL", "DO_GIMBAL_MANAGER_PITCHYAW", "DO_SET_ROI_LOCATION", "DO_SET_ROI_NONE",
)  # fmt: skip
_MODES: Final = ("GUIDED", "AUTO", "RTL", "SMART_RTL", "LAND", "BRAKE")
_PILOT: Final = ("LOITER", "POSHOLD", "ALT_HOLD", "STABILIZE", "CIRCLE", "FOLLOW", "AUTO_RTL")

PROFILES: Final[Mapping[str, StationProfile]] = {
    "range": StationProfile(
        messages=("HEARTBEAT", "COMMAND_LONG", *_MISSION, "SET_POSITION_TARGET_GLOBAL_INT", "TIMESYNC", "TUNNEL"),
        commands=(
            "SET_MESSAGE_INTERVAL", "REQUEST_MESSAGE", "DO_SET_MODE", "COMPONENT_ARM_DISARM", "MISSION_START",
            "NAV_RETURN_TO_LAUNCH", "NAV_LAND", "NAV_TAKEOFF", "DO_CHANGE_SPEED",
        ),
        modes=_MODES,
    ),
    "qgroundcontrol": StationProfile(
        messages=(
            *_STATION, "SYSTEM_TIME", "SET_POSITION_TARGET_LOCAL_NED", "GLOBAL_POSITION_INT", "LOGGING_ACK",
            "PARAM_EXT_REQUEST_LIST", "PARAM_EXT_REQUEST_READ", "PARAM_EXT_SET",
        ),
        commands=(
            *_COMMANDS, *_CAMERA, "DO_REPOSITION", "CONDITION_YAW", "DO_ORBIT", "DO_SET_MISSION_CURRENT",
            "REQUEST_PROTOCOL_VERSION", "DO_GIMBAL_MANAGER_CONFIGURE", "SET_CAMERA_FOCUS", "DO_GRIPPER",
            "LOGGING_START", "LOGGING_STOP",
        ),
        modes=(*_MODES, *_PILOT),
        guided_items=True,
    ),
    "mission_planner": StationProfile(
        messages=(
            *_STATION, "COMMAND_ACK", "SET_MODE", "TIMESYNC", "RC_CHANNELS_OVERRIDE", "MISSION_REQUEST",
            "MISSION_WRITE_PARTIAL_LIST", "SET_POSITION_TARGET_GLOBAL_INT", "GPS_INJECT_DATA", "DIGICAM_CONTROL",
            "AUTOPILOT_VERSION_REQUEST", "STATUSTEXT", "LOG_REQUEST_LIST", "LOG_REQUEST_DATA",
        ),
        commands=(
            *_COMMANDS, *_CAMERA, "DO_SET_ROI", "DO_SET_ROI_SYSID", "DO_MOUNT_CONTROL", "DO_MOUNT_CONFIGURE",
            "DO_SET_SERVO", "DO_REPEAT_SERVO", "DO_SET_RELAY", "DO_REPEAT_RELAY", "DO_AUX_FUNCTION", "DO_JUMP_TAG",
            "DO_SEND_BANNER", "GET_HOME_POSITION",
        ),
        modes=(*_MODES, *_PILOT),
        guided_items=True,
    ),
    "mavproxy": StationProfile(
        messages=(
            *_STATION, "COMMAND_ACK", "SET_MODE", "TIMESYNC", "SYSTEM_TIME", "RC_CHANNELS_OVERRIDE",
            "MISSION_REQUEST", "MISSION_WRITE_PARTIAL_LIST", "SET_POSITION_TARGET_GLOBAL_INT",
            "SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET", "GPS_INJECT_DATA", "DIGICAM_CONTROL", "STATUSTEXT",
            "LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_REQUEST_END", "OPEN_DRONE_ID_SYSTEM_UPDATE",
        ),
        commands=(
            *_COMMANDS, "DO_REPOSITION", "DO_CHANGE_ALTITUDE", "CONDITION_YAW", "DO_PAUSE_CONTINUE",
            "DO_SET_MISSION_CURRENT", "DO_SET_ROI", "DO_SET_ROI_LOCATION", "DO_DIGICAM_CONFIGURE",
            "DO_DIGICAM_CONTROL", "GET_HOME_POSITION", "GET_MESSAGE_INTERVAL",
        ),
        modes=(*_MODES, *_PILOT),
        guided_items=True,
    ),
}  # fmt: skip
"""By name. `range` is the station of this project, which flies plans and nothing else."""
