"""Command firewall: frames towards an aircraft pass if their message, command, mode, place and rate are allowed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.attack.bases.mavlink_orders import read
from skyrange.attack.bases.mavlink_params import COMMANDS
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import Messages, TapMaker
from skyrange.codec.mavlink import Message, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number, Whole, items, refuse
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.errors import Problem, nearest
from skyrange.core.geodesy import Origin
from skyrange.core.ids import link_name
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.contract import Defence, DefenceContext, DefencePlugin
from skyrange.defence.path_rules import Passes, ends_at
from skyrange.defence.placement import Alarm, DefenceTap, Protected, find_protected, inspects_forward, place_taps

_SCALE: Final = 1e7
"""Degrees of latitude and longitude are sent as whole numbers of 1e-7 degrees."""
_OF_COMPANION: Final = ("OPEN_DRONE_ID_ARM_STATUS",)
"""What a companion tells the autopilot about Remote ID; it passes no end of a gcs link."""
_BURST_S: Final = 1.0
"""A burst of as many frames as the rate allows in this time passes."""


def _commands(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if name not in COMMANDS:
            expected = "a command such as 'DO_SET_MODE', as in MAV_CMD"
            raise refuse(Problem(str(place), name, expected, nearest(name, COMMANDS)))
    return names


def _modes(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if name not in COPTER_MODE_NUMBERS:
            raise refuse(Problem(str(place), name, "a flight mode such as 'AUTO'", nearest(name, COPTER_MODE_NUMBERS)))
    return names


_Texts = Annotated[tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str])]


class FirewallRules(Protected):
    """What passes towards the aircraft; the defaults are what a ground station needs to fly a plan and to end it."""

    at: Literal["companion", "proxy"] = Field(
        default="companion",
        description="Where it is: companion, at its end of the gcs link, or proxy, at its end of the autopilot link, "
        "where commands of the companion pass too.",
    )
    messages: Annotated[Messages, Field(min_length=1)] = Field(
        default=(
            "HEARTBEAT", "COMMAND_LONG", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_REQUEST_LIST",
            "MISSION_REQUEST_INT", "MISSION_ACK", "SET_POSITION_TARGET_GLOBAL_INT", "TIMESYNC", "TUNNEL",
        ),
        description="Messages that pass; at the proxy also OPEN_DRONE_ID_ARM_STATUS, which the companion sends. "
        "mission.hash sends its hashes as TUNNEL.",
    )  # fmt: skip
    commands: Annotated[_Texts, AfterValidator(_commands)] = Field(
        default=(
            "SET_MESSAGE_INTERVAL", "REQUEST_MESSAGE", "DO_SET_MODE", "COMPONENT_ARM_DISARM", "MISSION_START",
            "NAV_RETURN_TO_LAUNCH", "NAV_LAND", "NAV_TAKEOFF", "DO_CHANGE_SPEED",
        ),
        description="Commands that pass in COMMAND_LONG and COMMAND_INT, by the names of MAV_CMD without MAV_CMD_.",
    )  # fmt: skip
    modes: Annotated[_Texts, AfterValidator(_modes)] = Field(
        default=("GUIDED", "AUTO", "RTL", "SMART_RTL", "LAND", "BRAKE"), description="Flight modes that may be set."
    )
    disarm_in_flight: bool = Field(
        default=False, strict=True, description="Whether a command to disarm passes while the aircraft is armed."
    )
    mission_in_flight: bool = Field(
        default=False, strict=True, description="Whether mission items pass while the aircraft is armed."
    )
    reach_m: Number = Field(
        default=2_000.0,
        gt=0,
        le=1_000_000,
        description="Largest horizontal distance in metres from the aircraft's start of a place that is commanded.",
    )
    frames_per_s: Whole = Field(
        default=50, ge=1, le=1_000_000, description="Largest number of frames a second; a burst of one second passes."
    )


@dataclass(slots=True)
class Firewall(DefenceTap):
    """Drops what the rules do not allow."""

    rules: FirewallRules
    messages: frozenset[int]
    commands: frozenset[int]
    modes: frozenset[int]
    origin: Origin
    start_m: tuple[float, float]
    alarm: Alarm
    _armed: bool = field(default=False, init=False)
    _allowance: float = field(default=0.0, init=False)
    _filled_ns: Time = field(default=-NS_PER_S, init=False)

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Let it pass or drop it; of frames from the aircraft, learn from heartbeats whether it is armed."""
        number = message_id(frame.payload)
        if frame.direction == "rev":
            if number == mav.MAVLINK_MSG_ID_HEARTBEAT:
                self._learn(frame.payload)
            return ()
        problem = self._find_excess(now) or self._find_problem(number, frame.payload)
        if not problem:
            return ()
        kind, what = problem
        return [Drop(), *self.alarm.raise_at(now, kind, 1.0, what=what)]

    def _learn(self, payload: bytes) -> None:
        message = read(payload)
        if message is not None and message.autopilot != mav.MAV_AUTOPILOT_INVALID:
            self._armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)

    def _find_excess(self, now: Time) -> tuple[str, str] | None:
        """A token bucket of one second of the allowed rate."""
        rate = float(self.rules.frames_per_s)
        self._allowance = min(rate * _BURST_S, self._allowance + rate * (now - self._filled_ns) / NS_PER_S)
        self._filled_ns = now
        if self._allowance < 1.0:
            return "firewall.rate", f"more than {self.rules.frames_per_s} frames a second"
        self._allowance -= 1.0
        return None

    def _find_problem(self, number: int | None, payload: bytes) -> tuple[str, str] | None:
        if number is None:
            return "firewall.message", "no MAVLink frame"
        if number not in self.messages:
            return "firewall.message", f"message {number}"
        message = read(payload)
        if message is None:
            return "firewall.message", f"malformed message {number}"
        if number in (mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT):
            return self._find_command_problem(message)
        uploads = number in (mav.MAVLINK_MSG_ID_MISSION_ITEM_INT, mav.MAVLINK_MSG_ID_MISSION_COUNT)
        if uploads and self._armed and not self.rules.mission_in_flight:
            return "firewall.mission", "a mission while armed"
        if number == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT and message.frame != mav.MAV_FRAME_MISSION:
            return self._find_reach_problem(message.x, message.y)
        if number == mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT:
            return self._find_reach_problem(message.lat_int, message.lon_int)
        return None

    def _find_command_problem(self, message: Message) -> tuple[str, str] | None:
        command = message.command
        if command not in self.commands:
            return "firewall.command", f"command {command}"
        if command == mav.MAV_CMD_DO_SET_MODE and message.param2 not in self.modes:
            return "firewall.mode", f"mode {message.param2:g}"
        if (
            command == mav.MAV_CMD_COMPONENT_ARM_DISARM
            and not message.param1
            and self._armed
            and not self.rules.disarm_in_flight
        ):
            return "firewall.command", "disarm while armed"
        if message.get_msgId() == mav.MAVLINK_MSG_ID_COMMAND_INT:
            return self._find_reach_problem(message.x, message.y)
        return None

    def _find_reach_problem(self, latitude_e7: int, longitude_e7: int) -> tuple[str, str] | None:
        if not latitude_e7 and not longitude_e7:  # no place: as of a command at the aircraft's own
            return None
        east_m, north_m = self.origin.enu_of(latitude_e7 / _SCALE, longitude_e7 / _SCALE)
        away_m = hypot(east_m - self.start_m[0], north_m - self.start_m[1])
        if away_m <= self.rules.reach_m:
            return None
        return "firewall.place", f"a place {away_m:.0f} m away"


def _find_messages(rules: FirewallRules) -> frozenset[int]:
    """Numbers of the messages that pass."""
    numbers = {message.msgname: number for number, message in mav.mavlink_map.items()}
    own = _OF_COMPANION if rules.at == "proxy" else ()
    return frozenset(numbers[name] for name in (*rules.messages, *own))


@dataclass(frozen=True, slots=True)
class _Maker:
    """Makes the firewall of a link."""

    rules: FirewallRules
    origin: Origin
    starts: tuple[tuple[str, tuple[str, float, float]], ...]

    def __call__(self, link: str) -> Firewall:
        vehicle, east_m, north_m = dict(self.starts)[link]
        return Firewall(
            link,
            self.rules,
            _find_messages(self.rules),
            frozenset(COMMANDS[name] for name in self.rules.commands),
            frozenset(COPTER_MODE_NUMBERS[name] for name in self.rules.modes),
            self.origin,
            (east_m, north_m),
            Alarm(vehicle),
        )


def make(params: FirewallRules, context: DefenceContext) -> Defence:
    """The parts. Raises `InputError` for aircraft that the scenario does not have."""
    role = "gcs" if params.at == "companion" else "autopilot"
    vehicles = find_protected(params, context)
    starts = tuple((link_name(role, one), (one, *context.vehicles[one].start_enu_m[:2])) for one in vehicles)
    maker = TapMaker(_Maker(params, context.origin, starts))
    messages, commands = _find_messages(params), frozenset(COMMANDS[name] for name in params.commands)
    return Defence(
        taps=place_taps(role, params.at, vehicles, context, maker, inspects_forward),
        exclusive=[Exclusive(f"allow list of {params.at} of {vehicle}") for vehicle in vehicles],
        path_rules=[Passes(end, "fwd", messages, commands) for end in ends_at(role, params.at, vehicles)],
    )


FIREWALL = DefencePlugin(
    FirewallRules,
    make,
    "Drops frames towards the aircraft whose message, command, mode, place or rate is not allowed.",
    surface=("gcs", "autopilot"),
    place="the companion's end of the gcs link, or the proxy's end of the autopilot link; knows the frames that pass",
    effect="drops what is not allowed, so that the autopilot never sees it",
    alerts=("firewall.message", "firewall.command", "firewall.mode", "firewall.mission", "firewall.place",
            "firewall.rate"),
    against=("mavlink.*", "link.flood", "identity.*", "companion.takeover", "signing.*"),
    evasion="commands what is allowed: AUTO, RTL, or a place within reach",
    cost="reads each frame once; no frame and no delay is added",
)  # fmt: skip
