"""Command firewall: frames towards an aircraft pass if their message, command, mode, place and rate are allowed."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import read
from skyrange.attack.bases.mavlink.params import COMMANDS
from skyrange.attack.tapped_links import MESSAGE_NUMBERS, Messages
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.file_transfer import Opcode, unpack
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.core.elementary import hypot
from skyrange.defence.bases.link_ends import role_of
from skyrange.defence.placement import inspects_forward
from skyrange.defence.station_profiles import PROFILES

_SCALE: Final = 1e7
"""Degrees of latitude and longitude are sent as whole numbers of 1e-7 degrees."""
_OF_COMPANION: Final = ("OPEN_DRONE_ID_ARM_STATUS",)
"""What a companion tells the autopilot about Remote ID; it passes no end of a gcs link."""
_BURST_S: Final = 1.0
"""A burst of as many frames as the rate allows in this time passes."""
_PLACED: Final = frozenset(number for number, entry in mav.enums["MAV_CMD"].items() if entry.has_location)
"""Commands whose parameters 5 and 6 are a latitude and a longitude (`hasLocation` of the dialect's XML)."""
_UPLOADS: Final = frozenset(
    {
        mav.MAVLINK_MSG_ID_MISSION_COUNT,
        mav.MAVLINK_MSG_ID_MISSION_ITEM,
        mav.MAVLINK_MSG_ID_MISSION_ITEM_INT,
        mav.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST,
        mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL,
    }
)
_GUIDED: Final = (2, 3)
"""`current` of a mission item that is flown to at once and not stored (GCS_MAVLINK::handle_mission_item)."""
_FTP_READS: Final = frozenset(
    {
        Opcode.NONE, Opcode.TERMINATE_SESSION, Opcode.RESET_SESSIONS, Opcode.LIST_DIRECTORY, Opcode.OPEN_FILE_RO,
        Opcode.READ_FILE, Opcode.CALC_FILE_CRC32, Opcode.BURST_READ_FILE,
    }
)  # fmt: skip
"""Operations of MAVFTP that change no file."""


def _commands(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if name not in COMMANDS:
            expected = "a command such as 'DO_SET_MODE', as in MAV_CMD"
            raise sky.refuse(sky.Problem(str(place), name, expected, sky.nearest(name, COMMANDS)))
    return names


def _modes(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if name not in COPTER_MODE_NUMBERS:
            raise sky.refuse(
                sky.Problem(str(place), name, "a flight mode such as 'AUTO'", sky.nearest(name, COPTER_MODE_NUMBERS))
            )
    return names


_Texts = Annotated[tuple[str, ...], BeforeValidator(sky.items, json_schema_input_type=list[str])]


@sky.defence(
    "mavlink.firewall",
    surface=("gcs", "autopilot"),
    place="the companion's end of the gcs link, or the proxy's end of the autopilot link; knows the frames that pass",
    effect="drops what is not allowed, so that the autopilot never sees it",
    alerts=(
        "firewall.message",
        "firewall.command",
        "firewall.mode",
        "firewall.mission",
        "firewall.parameter",
        "firewall.place",
        "firewall.rate",
    ),
    against=("mavlink.*", "link.flood", "identity.*", "companion.takeover", "signing.*"),
    evasion="commands what is allowed: AUTO, RTL, or a place within reach; with the profile of a real station also "
    "sets parameters or home, or moves sticks",
    cost="reads each frame once; no frame and no delay is added",
)
class Firewall(sky.EndTap):
    """Drops frames towards the aircraft whose message, command, mode, place or rate is not allowed.

    `profile` is the ground station whose messages, commands and modes pass; without it these are what the station of
    the range needs to fly a plan and to end it. Lists that are given replace those of the profile.
    """

    inspects = staticmethod(inspects_forward)

    at: Literal["companion", "proxy"] = sky.param(
        "Where it is: companion, at its end of the gcs link, or proxy, at its end of the autopilot link, where "
        "commands of the companion pass too.",
        default="companion",
    )
    profile: Literal["range", "qgroundcontrol", "mission_planner", "mavproxy"] = sky.param(
        "Ground station whose messages, commands and modes pass: that of the range, or what QGroundControl, Mission "
        "Planner or MAVProxy send in flight.",
        default="range",
    )
    messages: Annotated[Messages, Field(min_length=1)] | None = sky.param(
        "Messages that pass, instead of those of the profile; at the proxy also OPEN_DRONE_ID_ARM_STATUS, which the "
        "companion sends. mission.hash sends its hashes as TUNNEL.",
        default=None,
    )
    commands: Annotated[_Texts, AfterValidator(_commands)] | None = sky.param(
        "Commands that pass in COMMAND_LONG and COMMAND_INT, instead of those of the profile, by the names of MAV_CMD "
        "without MAV_CMD_.",
        default=None,
    )
    modes: Annotated[_Texts, AfterValidator(_modes)] | None = sky.param(
        "Flight modes that may be set, instead of those of the profile.", default=None
    )
    disarm_in_flight: bool = sky.param(
        "Whether a command to disarm passes while the aircraft is armed.", default=False, strict=True
    )
    mission_in_flight: bool = sky.param(
        "Whether mission items pass while the aircraft is armed.", default=False, strict=True
    )
    parameters_in_flight: bool = sky.param(
        "Whether PARAM_SET, and operations of MAVFTP that change files, pass while the aircraft is armed.",
        default=True, strict=True,
    )  # fmt: skip
    reach_m: sky.Number = sky.param(
        "Largest horizontal distance in metres from the aircraft's start of a place that is commanded.",
        default=2_000.0, gt=0, le=1_000_000,
    )  # fmt: skip
    frames_per_s: sky.Whole = sky.param(
        "Largest number of frames a second; a burst of one second passes.", default=50, ge=1, le=1_000_000
    )
    numbers: frozenset[int]
    """Of the messages that pass."""
    allowed: frozenset[int]
    """Numbers of the commands that pass."""
    mode_numbers: frozenset[int]
    origin: sky.Origin
    start_m: tuple[float, float]
    allowance: float = 0.0
    filled_ns: sky.Time = -sky.NS_PER_S

    def prepare(self, context: sky.DefenceContext) -> None:
        station = PROFILES[self.profile]
        messages = station.messages if self.messages is None else self.messages
        commands = station.commands if self.commands is None else self.commands
        modes = station.modes if self.modes is None else self.modes
        names = (*messages, *(_OF_COMPANION if self.at == "proxy" else ()))
        self.numbers = frozenset(MESSAGE_NUMBERS[name] for name in names)
        self.allowed = frozenset(COMMANDS[name] for name in commands)
        self.mode_numbers = frozenset(COPTER_MODE_NUMBERS[name] for name in modes)
        self.origin = context.origin

    def find_end(self) -> tuple[str, str]:
        """See `EndTap`."""
        return role_of(self.at), self.at

    def find_exclusive(self, vehicle: str) -> list[sky.Exclusive]:
        """The list of this place."""
        return [sky.Exclusive(f"allow list of {self.at} of {vehicle}")]

    def find_rules(self, end: sky.PathEnd) -> Sequence[sky.PathRule]:
        """What passes."""
        return [sky.Passes(end, "fwd", self.numbers, self.allowed)]

    def begin(self, aircraft: sky.Aircraft) -> None:
        self.start_m = aircraft.start_enu_m[0], aircraft.start_enu_m[1]

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        """Let it pass or drop it; of frames from the aircraft, learn from heartbeats whether it is armed."""
        number = sky.message_id(frame.payload)
        if frame.direction == "rev":
            if number == mav.MAVLINK_MSG_ID_HEARTBEAT:
                self.learn_armed(frame.payload)
            return ()
        problem = self._find_excess(now) or self._find_problem(number, frame.payload)
        if not problem:
            return ()
        kind, what = problem
        return [sky.Drop(), *self.alarm.raise_at(now, kind, 1.0, what=what)]

    def _find_excess(self, now: sky.Time) -> tuple[str, str] | None:
        """A token bucket of one second of the allowed rate."""
        rate = float(self.frames_per_s)
        self.allowance = min(rate * _BURST_S, self.allowance + rate * (now - self.filled_ns) / sky.NS_PER_S)
        self.filled_ns = now
        if self.allowance < 1.0:
            return "firewall.rate", f"more than {self.frames_per_s} frames a second"
        self.allowance -= 1.0
        return None

    def _find_problem(self, number: int | None, payload: bytes) -> tuple[str, str] | None:
        if number is None:
            return "firewall.message", "no MAVLink frame"
        if number not in self.numbers:
            return "firewall.message", f"message {number}"
        message = read(payload)
        if message is None:
            return "firewall.message", f"malformed message {number}"
        if number in (mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT):
            return self._find_command_problem(message)
        if number in _UPLOADS:
            return self._find_upload_problem(message)
        if number == mav.MAVLINK_MSG_ID_SET_MODE:
            return self._find_mode_problem(message.custom_mode)
        if number == mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT:
            return self._find_reach_problem(message.lat_int / _SCALE, message.lon_int / _SCALE)
        if self.armed and not self.parameters_in_flight:
            return _find_setting(number, message)
        return None

    def _find_upload_problem(self, message: sky.MavlinkMessage) -> tuple[str, str] | None:
        number = message.get_msgId()
        is_item = number in (mav.MAVLINK_MSG_ID_MISSION_ITEM, mav.MAVLINK_MSG_ID_MISSION_ITEM_INT)
        at_once = is_item and PROFILES[self.profile].guided_items and message.current in _GUIDED
        if self.armed and not self.mission_in_flight and not at_once:
            return "firewall.mission", "a mission while armed"
        if not is_item or message.frame == mav.MAV_FRAME_MISSION:
            return None
        scale = _SCALE if number == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT else 1.0
        return self._find_reach_problem(message.x / scale, message.y / scale)

    def _find_mode_problem(self, mode: float) -> tuple[str, str] | None:
        return None if mode in self.mode_numbers else ("firewall.mode", f"mode {mode:g}")

    def _find_command_problem(self, message: sky.MavlinkMessage) -> tuple[str, str] | None:
        command = message.command
        if command not in self.allowed:
            return "firewall.command", f"command {command}"
        if command == mav.MAV_CMD_DO_SET_MODE and (problem := self._find_mode_problem(message.param2)):
            return problem
        disarms = command == mav.MAV_CMD_COMPONENT_ARM_DISARM and not message.param1
        if disarms and self.armed and not self.disarm_in_flight:
            return "firewall.command", "disarm while armed"
        if command not in _PLACED:  # QGroundControl sends NaN times 1e7 where a command has no place
            return None
        if message.get_msgId() == mav.MAVLINK_MSG_ID_COMMAND_INT:
            return self._find_reach_problem(message.x / _SCALE, message.y / _SCALE)
        return self._find_reach_problem(message.param5, message.param6)

    def _find_reach_problem(self, latitude: float, longitude: float) -> tuple[str, str] | None:
        if not latitude and not longitude:  # no place: as of a command at the aircraft's own
            return None
        if isfinite(latitude) != isfinite(longitude) or abs(latitude) > 90.0 or abs(longitude) > 180.0:
            return "firewall.place", f"a place at {latitude:g}, {longitude:g}"
        if not isfinite(latitude):
            return None
        east_m, north_m = self.origin.enu_of(latitude, longitude)
        away_m = hypot(east_m - self.start_m[0], north_m - self.start_m[1])
        if away_m <= self.reach_m:
            return None
        return "firewall.place", f"a place {away_m:.0f} m away"


def _find_setting(number: int, message: sky.MavlinkMessage) -> tuple[str, str] | None:
    """What a message alters that is stored: a parameter, or a file by MAVFTP."""
    if number == mav.MAVLINK_MSG_ID_PARAM_SET:
        return "firewall.parameter", "a parameter while armed"
    if number != mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL:
        return None
    opcode = unpack(bytes(message.payload)).opcode
    return None if opcode in _FTP_READS else ("firewall.parameter", f"a file while armed, by operation {opcode}")
