"""Does the firewall pass what real ground stations send in flight, and only that?

The sessions are frames made by hand, as the public sources of the stations make them (`defence.station_profiles` names
the files). The numbers of fields are what these functions set.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import pytest

from skyrange.attack.bases.mavlink.params import COMMANDS
from skyrange.attack.contract import Aircraft, AttackContext
from skyrange.attack.tapped_links import MESSAGE_NUMBERS
from skyrange.codec.mavlink import Message, Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.alerts import Alert
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Drop
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch
from skyrange.defence.contract import DefencePlugin
from skyrange.defence.station_profiles import PROFILES
from skyrange.study.matrix.model import read_matrix

KIND: Final = DefencePlugin.find("mavlink.firewall")
SYSTEM: Final = 7
STATION, AUTOPILOT = Packer(255, 190), Packer(SYSTEM, 1)
LAT, LON = 400_010_000, -740_010_000
FAR: Final = 410_000_000
REAL: Final = ("qgroundcontrol", "mission_planner", "mavproxy")
INT_MIN: Final = -(2**31)
"""NaN * 1e7 as an int32 on x86: `cmd.x` of Vehicle::_sendMavCommandFromList for a command without a place."""


class Wall:
    """A firewall at the companion of an aircraft that flies."""

    def __init__(self, armed: bool = True, **params: Any) -> None:
        context = AttackContext(
            "wall",
            {"blue/b1": Aircraft((0.0, 0.0, 0.0), "1", SYSTEM)},
            ["gcs:blue/b1"],
            Origin(40.0, -74.0, 20.0),
            Epoch(0),
            Chance(3),
            90 * NS_PER_S,
            Schedule(),
        )
        (placed,) = KIND(KIND.params.model_validate(params), context).taps
        self.tap, self.now = placed.make("gcs:blue/b1"), 0
        flag = mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, flag, 3, 4, 3)
        self.tap.on_frame(0, Frame("gcs:blue/b1", "rev", "a", 0, "a", "b", sent_ns=0, payload=AUTOPILOT.pack(beat)))

    def finds(self, message: Message) -> str:
        """The kind of alert about a message that is dropped, "" for one that passes."""
        self.now += 2 * NS_PER_S
        frame = Frame("gcs:blue/b1", "fwd", "a", 0, "a", "b", sent_ns=0, payload=STATION.pack(message))
        verdicts = self.tap.on_frame(self.now, frame)
        kinds = [one.kind for one in verdicts if isinstance(one, Alert)]
        assert bool(kinds) == any(isinstance(one, Drop) for one in verdicts)
        return "".join(kinds)


def long(name: str, *values: float) -> Message:
    return mav.MAVLink_command_long_message(SYSTEM, 1, COMMANDS[name], 0, *(*values, *[0.0] * (7 - len(values))))


def placed(name: str, x: int, y: int, frame: int = mav.MAV_FRAME_GLOBAL) -> Message:
    return mav.MAVLink_command_int_message(SYSTEM, 1, frame, COMMANDS[name], 0, 0, -1, 1, 0, math.nan, x, y, 30)


def item(current: int, x: int = LAT, y: int = LON) -> Message:
    return mav.MAVLink_mission_item_int_message(
        SYSTEM, 1, 0, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_CMD_NAV_WAYPOINT, current, 1, 0, 0, 0, 0, x, y, 30
    )


def float_item(current: int, x: float = LAT / 1e7, y: float = LON / 1e7) -> Message:
    return mav.MAVLink_mission_item_message(
        SYSTEM, 1, 0, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_CMD_NAV_WAYPOINT, current, 1, 0, 0, 0, 0, x, y, 30
    )


def ftp(operation: int) -> Message:
    payload = [1, 0, 0, operation, 10, 0, 0, 0, 0, 0, 0, 0, *b"@PARAM/par"]
    return mav.MAVLink_file_transfer_protocol_message(0, SYSTEM, 1, payload + [0] * (251 - len(payload)))


def parameter(name: bytes = b"BARO_GND_TEMP") -> Message:
    return mav.MAVLink_param_set_message(SYSTEM, 1, name, 21.0, mav.MAV_PARAM_TYPE_REAL32)


def stick() -> Message:
    return mav.MAVLink_manual_control_message(SYSTEM, 0, 0, 500, 0, 0)


HEARTBEAT: Final = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
TRANSFER: Final = (
    mav.MAVLink_mission_request_list_message(SYSTEM, 1, 0),
    mav.MAVLink_mission_request_int_message(SYSTEM, 1, 0, 0),
    mav.MAVLink_mission_ack_message(SYSTEM, 1, 0, 0),
    mav.MAVLink_mission_request_list_message(SYSTEM, 1, 1),  # the fence
    mav.MAVLink_param_request_list_message(SYSTEM, 1),
    mav.MAVLink_param_request_read_message(SYSTEM, 1, b"", 17),
)
QGROUNDCONTROL: Final = (
    HEARTBEAT,
    long("REQUEST_MESSAGE", mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION),
    *TRANSFER,
    ftp(4), ftp(15), ftp(1),  # APMFirmwarePlugin: parameters by @PARAM/param.pck
    mav.MAVLink_system_time_message(1_700_000_000_000_000, 0),
    mav.MAVLink_request_data_stream_message(SYSTEM, 1, 6, 3, 1),
    long("SET_MESSAGE_INTERVAL", 33, 100_000),
    parameter(),  # APMFirmwarePlugin::_setBaroGndTemp
    long("DO_SET_MODE", 1, 4),
    long("COMPONENT_ARM_DISARM", 1),
    long("NAV_TAKEOFF", 0, 0, 0, 0, 0, 0, 10),
    placed("DO_REPOSITION", LAT, LON),
    mav.MAVLink_set_position_target_local_ned_message(0, SYSTEM, 1, 7, 0xFFF8, 0, 0, -5, 0, 0, 0, 0, 0, 0, 0, 0),
    long("CONDITION_YAW", 30, 0, 1, 1),
    long("DO_CHANGE_SPEED", 1, 5, -1, 0, math.nan, math.nan, math.nan),
    placed("DO_ORBIT", LAT, LON),
    placed("DO_SET_ROI_LOCATION", LAT, LON),
    placed("DO_SET_ROI_NONE", INT_MIN, INT_MIN),
    long("DO_SET_HOME", 0, 0, 0, math.nan, LAT / 1e7, LON / 1e7, 20),
    long("DO_SET_MISSION_CURRENT", 2),
    mav.MAVLink_mission_set_current_message(SYSTEM, 1, 2),
    float_item(2),  # MissionManager::writeArduPilotGuidedMissionItem
    stick(),
    long("DO_GIMBAL_MANAGER_PITCHYAW", -45, 0, math.nan, math.nan, 12, 0, 1),
    long("DO_GIMBAL_MANAGER_CONFIGURE", 255, 190, -1, -1, math.nan, math.nan, 1),
    long("SET_CAMERA_ZOOM", 1, 1),
    long("IMAGE_START_CAPTURE", 0, 0, 1),
    mav.MAVLink_gimbal_manager_set_attitude_message(SYSTEM, 1, 12, 0, [math.nan] * 4, math.nan, 0.1, 0.0),
    mav.MAVLink_terrain_data_message(LAT, LON, 100, 3, [10] * 16),
    mav.MAVLink_gps_rtcm_data_message(0, 3, [1] * 180),
    mav.MAVLink_global_position_int_message(1000, LAT, LON, 20_000, 0, 0, 0, 0, 0),  # sendGCSMotionReport
    mav.MAVLink_open_drone_id_system_message(SYSTEM, 1, [0] * 20, 0, 0, LAT, LON, 1, 0, -1000, -1000, 0, 0, 20, 0),
    long("DO_SET_MODE", 1, 6),
)  # fmt: skip
MISSION_PLANNER: Final = (
    HEARTBEAT,
    *TRANSFER,
    mav.MAVLink_mission_request_message(SYSTEM, 1, 0, 0),
    ftp(3), ftp(4), ftp(5), ftp(2),
    mav.MAVLink_request_data_stream_message(SYSTEM, 1, 10, 4, 1),
    mav.MAVLink_timesync_message(1_700_000_000_000_000, 123),
    mav.MAVLink_autopilot_version_request_message(SYSTEM, 1),
    long("DO_SEND_BANNER"),
    parameter(b"WP_LOITER_RAD"),
    long("DO_SET_MODE", 1, 4), mav.MAVLink_set_mode_message(SYSTEM, 1, 4), mav.MAVLink_set_mode_message(SYSTEM, 1, 4),
    long("NAV_TAKEOFF", 0, 0, 0, 0, 0, 0, 10),
    item(2), item(3),  # setGuidedModeWP and setNewWPAlt
    placed("DO_SET_HOME", LAT, LON), placed("DO_SET_ROI", LAT, LON),
    mav.MAVLink_set_position_target_global_int_message(
        0, SYSTEM, 1, 6, 0xFF8, LAT, LON, 30, 0, 0, 0, 0, 0, 0, 0, 0
    ),
    mav.MAVLink_rc_channels_override_message(SYSTEM, 1, *[1500] * 8),
    stick(),
    long("DO_MOUNT_CONTROL", -45, 0, 0, 0, 0, 0, 2),
    long("DO_GIMBAL_MANAGER_PITCHYAW", -45, 0, math.nan, math.nan, 12, 0, 1),
    long("DO_SET_SERVO", 9, 1900),
    long("DO_SET_RELAY", 0, 1),
    mav.MAVLink_gps_rtcm_data_message(0, 3, [1] * 180),
    mav.MAVLink_terrain_data_message(LAT, LON, 100, 3, [10] * 16),
    mav.MAVLink_mission_set_current_message(SYSTEM, 1, 2),
    long("DO_SET_MODE", 1, 6),
)  # fmt: skip
MAVPROXY: Final = (
    HEARTBEAT,
    *TRANSFER,
    ftp(4), ftp(15),
    mav.MAVLink_request_data_stream_message(SYSTEM, 1, 0, 4, 1),
    mav.MAVLink_timesync_message(0, 1_700_000_000_000_000),
    parameter(b"WPNAV_SPEED"),
    mav.MAVLink_set_mode_message(SYSTEM, 1, 5),  # pymavlink, set_mode_apm of older versions
    long("DO_SET_MODE", 1, 5),
    placed("DO_REPOSITION", LAT, LON),
    item(2),
    mav.MAVLink_rc_channels_override_message(SYSTEM, 1, *[1500] * 8),
    mav.MAVLink_set_position_target_global_int_message(
        0, SYSTEM, 1, 6, 0xFF8, LAT, LON, 30, 0, 0, 0, 0, 0, 0, 0, 0
    ),
    long("DO_CHANGE_ALTITUDE", 30, 3),
    long("CONDITION_YAW", 30, 0, 1, 1),
    long("DO_PAUSE_CONTINUE", 0),
    mav.MAVLink_terrain_data_message(LAT, LON, 100, 3, [10] * 16),
    mav.MAVLink_statustext_message(6, b"hello"),
)  # fmt: skip


@pytest.mark.parametrize(
    ("profile", "session"),
    [("qgroundcontrol", QGROUNDCONTROL), ("mission_planner", MISSION_PLANNER), ("mavproxy", MAVPROXY)],
)
def test_a_session_in_flight_passes_the_profile_of_its_station_and_not_that_of_the_range(
    profile: str, session: tuple[Message, ...]
) -> None:
    wall, range_wall = Wall(profile=profile), Wall()
    assert [(one.get_type(), found) for one in session if (found := wall.finds(one))] == []
    dropped = sum(bool(range_wall.finds(message)) for message in session)
    assert dropped > len(session) / 2


@pytest.mark.parametrize("profile", [*REAL, "range"])
@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (long("DO_FLIGHTTERMINATION", 1), "firewall.command"),
        (long("COMPONENT_ARM_DISARM", 0, 21196), "firewall.command"),  # the emergency stop of QGroundControl
        (long("PREFLIGHT_REBOOT_SHUTDOWN", 1), "firewall.command"),
        (long("DO_MOTOR_TEST", 1), "firewall.command"),
        (long("DO_SET_MODE", 1, COPTER_MODE_NUMBERS["FLIP"]), "firewall.mode"),
        (mav.MAVLink_mission_count_message(SYSTEM, 1, 3, 0), "firewall.mission"),
        (item(0), "firewall.mission"),
        (mav.MAVLink_set_gps_global_origin_message(SYSTEM, LAT, LON, 0), "firewall.message"),
        (mav.MAVLink_setup_signing_message(SYSTEM, 1, [0] * 32, 0), "firewall.message"),
    ],
)
def test_what_no_profile_passes_in_flight(profile: str, message: Message, kind: str) -> None:
    assert Wall(profile=profile).finds(message) == kind


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        ("qgroundcontrol", placed("DO_REPOSITION", FAR, LON)),
        ("qgroundcontrol", long("DO_REPOSITION", -1, 1, 0, 0, FAR / 1e7, LON / 1e7, 30)),
        ("qgroundcontrol", long("DO_SET_HOME", 0, 0, 0, 0, FAR / 1e7, LON / 1e7, 30)),
        ("qgroundcontrol", long("DO_SET_HOME", 0, 0, 0, 0, math.inf, math.inf, 30)),
        ("qgroundcontrol", long("DO_SET_HOME", 0, 0, 0, 0, math.nan, LON / 1e7, 30)),
        ("qgroundcontrol", long("DO_SET_HOME", 0, 0, 0, 0, 91.0, LON / 1e7, 30)),
        ("qgroundcontrol", float_item(2, FAR / 1e7)),
        ("mission_planner", item(2, FAR)),
        ("mavproxy", item(3, FAR)),
    ],
)
def test_a_place_out_of_reach_is_dropped_whatever_carries_it(profile: str, message: Message) -> None:
    assert Wall(profile=profile).finds(message) == "firewall.place"


def test_a_mode_is_judged_in_the_old_message_too() -> None:
    wall = Wall(profile="mission_planner")
    assert wall.finds(mav.MAVLink_set_mode_message(SYSTEM, 1, COPTER_MODE_NUMBERS["LOITER"])) == ""
    assert wall.finds(mav.MAVLink_set_mode_message(SYSTEM, 1, COPTER_MODE_NUMBERS["FLIP"])) == "firewall.mode"


@pytest.mark.parametrize("profile", REAL)
def test_a_mission_is_not_altered_in_flight_and_is_on_the_ground(profile: str) -> None:
    clear = mav.MAVLink_mission_clear_all_message(SYSTEM, 1, 0)
    assert Wall(profile=profile).finds(clear) == "firewall.mission"
    assert Wall(profile=profile, mission_in_flight=True).finds(clear) == ""
    for message in (clear, item(0), float_item(0)):
        assert Wall(armed=False, profile=profile).finds(message) == ""


@pytest.mark.parametrize("profile", REAL)
def test_parameters_and_files_can_be_locked_in_flight(profile: str) -> None:
    locked, on_ground = Wall(profile=profile, parameters_in_flight=False), Wall(armed=False, profile=profile)
    for message in (parameter(), ftp(6), ftp(7), ftp(8), ftp(11), ftp(13)):
        assert Wall(profile=profile).finds(message) == ""
        assert locked.finds(message) == "firewall.parameter"
        assert on_ground.finds(message) == ""
    assert [locked.finds(ftp(operation)) for operation in (1, 2, 3, 4, 5, 14, 15)] == [""] * 7


def test_lists_replace_those_of_the_profile() -> None:
    wall = Wall(profile="qgroundcontrol", messages=["COMMAND_LONG"], commands=["DO_GRIPPER"])
    assert (wall.finds(long("DO_GRIPPER", 0, 1)), wall.finds(long("DO_CHANGE_SPEED", 1, 5))) == ("", "firewall.command")
    assert wall.finds(stick()) == "firewall.message"
    with pytest.raises((InputError, ValueError), match="profile"):
        KIND.params.model_validate({"profile": "qgc"})


def test_profiles_have_names_of_the_dialect_and_each_once() -> None:
    for profile in PROFILES.values():
        for names, known in (
            (profile.messages, MESSAGE_NUMBERS),
            (profile.commands, COMMANDS),
            (profile.modes, COPTER_MODE_NUMBERS),
        ):
            assert len(set(names)) == len(names)
            assert set(names) <= set(known)


def test_the_matrix_of_the_page_has_every_profile() -> None:
    matrix = read_matrix(Path(__file__).parents[2] / "docs/reference/firewall-profiles.toml")
    params = [defence.params for column in matrix.columns for defence in column.defences]
    assert {one.get("profile") for one in params} == set(PROFILES)
