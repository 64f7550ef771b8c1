"""Events aboard an ArduPilot, read from its messages and noted as those of the builtin autopilot.

`AUTOPILOT_EVENTS` lists them. A few reports are requested on the private port ten times a second, so an event is
detected within 0.1 s; others are read from its texts and from its answers. No message gives the reason for a change of
mode, and causes are not known.

Events of an ArduPilot that its STATUSTEXT messages report: fence, battery, estimator. Texts of ArduCopter 4.6 and 4.7:
AC_Fence.cpp (`get_fence_names`, `print_fence_message`), ArduCopter/fence.cpp (`fence_checks_async`), AP_BattMonitor.cpp
(`check_failsafes`), ArduCopter/ekf_check.cpp, AP_NavEKF3_Control.cpp. None of them is longer than a STATUSTEXT, so none
comes in chunks.

Events of an ArduPilot that answer what it was sent: stored missions, fences, rally points, parameters and homes. A
frame to the autopilot says what is asked for, and its answer on the same link that this was done: MISSION_ACK to the
sender of an upload (MissionItemProtocol.cpp), PARAM_VALUE with the value that was set (AP_Param.cpp, `set_float`),
HOME_POSITION at each change of home (AP_AHRS.cpp, `set_home`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Final

from skyrange.codec.mavlink import Message, decode, dialect, message_id
from skyrange.codec.mavlink.flight_modes import mode_name
from skyrange.core import elementary, elementary_python
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

REQUESTS: Final = frozenset(
    (
        dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT,
        dialect.MAVLINK_MSG_ID_MISSION_ITEM,
        dialect.MAVLINK_MSG_ID_MISSION_COUNT,
        dialect.MAVLINK_MSG_ID_MISSION_CLEAR_ALL,
        dialect.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST,
        dialect.MAVLINK_MSG_ID_PARAM_SET,
        dialect.MAVLINK_MSG_ID_COMMAND_LONG,
        dialect.MAVLINK_MSG_ID_COMMAND_INT,
    )
)
"""Ids of the messages to an autopilot that are read."""
ANSWERS: Final = frozenset(
    (
        dialect.MAVLINK_MSG_ID_MISSION_ACK,
        dialect.MAVLINK_MSG_ID_MISSION_ITEM_REACHED,
        dialect.MAVLINK_MSG_ID_PARAM_VALUE,
        dialect.MAVLINK_MSG_ID_COMMAND_ACK,
        dialect.MAVLINK_MSG_ID_HOME_POSITION,
    )
)
"""Ids of the messages from it that are read."""
MAX_UNANSWERED: Final = 2_000
"""Parameters that were set and not answered: a flood of names that no firmware has forgets the oldest."""
_LISTS: Final[Mapping[int, str]] = {
    dialect.MAV_MISSION_TYPE_MISSION: "event.mission",
    dialect.MAV_MISSION_TYPE_FENCE: "event.fence",
    dialect.MAV_MISSION_TYPE_RALLY: "event.rally",
}
_INTEGERS: Final[Mapping[int, tuple[int, int]]] = {
    dialect.MAV_PARAM_TYPE_INT8: (-(1 << 7), (1 << 7) - 1),
    dialect.MAV_PARAM_TYPE_INT16: (-(1 << 15), (1 << 15) - 1),
    dialect.MAV_PARAM_TYPE_INT32: (-(1 << 31), (1 << 31) - 1),
}
"""Range of the types that a value is truncated to."""
Peer = tuple[int, int]
"""System and component of a sender."""


class AnsweredRequests:
    """What the autopilot of one MAVLink system was asked for, until it answers."""

    def __init__(self, system_id: int, origin: Origin) -> None:
        self._system_id = system_id
        self._origin = origin
        self._commands: dict[int, int] = {}
        """Command of each uploaded mission item, by its sequence number."""
        self._announced: dict[tuple[int, Peer], int] = {}
        """Items that a list of a mission type will have, by type and sender."""
        self._stored: dict[int, int] = {}
        """Items of each list that was stored."""
        self._wanted: dict[str, float] = {}
        """Values of PARAM_SET, by name."""
        self._home: tuple[int, int, int] | None = None
        self._home_asked = False

    def on_request(self, message: Message) -> None:
        """A message to an autopilot; one to another system is ignored."""
        if message.target_system not in (0, self._system_id):
            return
        kind = message.get_type()
        peer = message.get_srcSystem(), message.get_srcComponent()
        if kind.startswith("MISSION_ITEM"):
            if message.mission_type == dialect.MAV_MISSION_TYPE_MISSION:
                self._commands[message.seq] = message.command
        elif kind == "MISSION_COUNT":
            self._announced[message.mission_type, peer] = message.count
        elif kind == "MISSION_CLEAR_ALL":
            self._announced[message.mission_type, peer] = 0
        elif kind == "MISSION_WRITE_PARTIAL_LIST":
            known = self._stored.get(message.mission_type, 0)
            self._announced[message.mission_type, peer] = max(known, message.end_index + 1)
        elif kind == "PARAM_SET":
            self._on_param_set(message.param_id.upper(), message.param_value)
        elif message.command == dialect.MAV_CMD_DO_SET_HOME:
            self._home_asked = True

    def _on_param_set(self, name: str, value: float) -> None:
        """A value that is not finite is ignored, as ArduPilot does (`handle_param_set`)."""
        if math.isfinite(value):
            self._wanted.pop(name, None)
            self._wanted[name] = value
            if len(self._wanted) > MAX_UNANSWERED:
                del self._wanted[next(iter(self._wanted))]

    def on_answer(self, message: Message, *, landed: bool) -> Iterator[Event]:
        """The events in a message from the autopilot."""
        kind = message.get_type()
        if kind == "MISSION_ITEM_REACHED":
            yield "event.item_reached", {"seq": message.seq, "command": self._commands.get(message.seq, 0)}
        elif kind == "MISSION_ACK":
            yield from self._on_mission_ack(message)
        elif kind == "PARAM_VALUE":
            wanted = self._wanted.get(message.param_id)
            if wanted is not None and _is_stored(message, wanted):
                del self._wanted[message.param_id]
                yield "event.parameter", {"name": message.param_id, "value": float(message.param_value)}
        elif kind == "HOME_POSITION":
            yield from self._on_home(message, landed=landed)
        elif message.command == dialect.MAV_CMD_DO_SET_HOME and message.result != dialect.MAV_RESULT_ACCEPTED:
            self._home_asked = False

    def _on_mission_ack(self, message: Message) -> Iterator[Event]:
        """A list is stored when the sender of its items, or of its clearing, is told so."""
        list_type = message.mission_type
        key = list_type, (message.target_system, message.target_component)
        if message.type == dialect.MAV_MISSION_ACCEPTED and key in self._announced and list_type in _LISTS:
            self._stored[list_type] = self._announced.pop(key)
            yield _LISTS[list_type], {"items": self._stored[list_type]}

    def _on_home(self, message: Message, *, landed: bool) -> Iterator[Event]:
        """Home was set by a command, or has moved in the air, as by an item of a mission. Arming moves it too, on the
        ground; that is no event, as it is none of the builtin autopilot.
        """
        home = message.latitude, message.longitude, message.altitude
        moved = self._home is not None and home != self._home
        if self._home_asked or (moved and not landed):
            east_m, north_m = self._origin.enu_of(home[0] * 1e-7, home[1] * 1e-7)
            up_m = home[2] * 1e-3 - self._origin.alt_msl_m
            yield "event.home", {"east_m": east_m, "north_m": north_m, "up_m": up_m}
        self._home, self._home_asked = home, False


def _is_stored(message: Message, wanted: float) -> bool:
    """Whether a PARAM_VALUE has the value that was set; a refused PARAM_SET is answered with the old value."""
    reported = float(message.param_value)
    if message.param_type not in _INTEGERS:
        return reported == wanted
    least, most = _INTEGERS[message.param_type]
    return abs(reported - min(max(wanted, least), most)) < 1.0


Event = tuple[str, Mapping[str, str | int | float | bool]]
"""Kind and data of a note about the aircraft."""

_TEXTS: Final[Mapping[str, Event]] = {
    "EKF variance": ("event.ekf_failsafe", {"on": True}),
    "EKF Failsafe Cleared": ("event.ekf_failsafe", {"on": False}),
    "EKF3 IMU0 stopped aiding": ("event.estimator", {"aiding": "none"}),
    "EKF3 IMU0 is using GPS": ("event.estimator", {"aiding": "gnss"}),
}
_BREACHED: Final = re.compile(r"((?:Max Alt|Min Alt|Circle|Polygon)\b.* fences?) breached")
_CLEARED: Final = "Fence breach cleared"
_BATTERY: Final = re.compile(r"Battery (\d+) is (low|critical|missing)(?:, last:)? (-?\d+\.\d+)V used (-?\d+) mAh")
_BREACH_NAMES: Final[Mapping[int, str]] = {
    dialect.FENCE_BREACH_MINALT: "Min Alt fence",
    dialect.FENCE_BREACH_MAXALT: "Max Alt fence",
    dialect.FENCE_BREACH_BOUNDARY: "Circle or Polygon fence",
}


class FenceState:
    """What is known of a fence: a text reports a breach and its end, except on the ground; FENCE_STATUS always.

    The two come in any order, and one breach is one event, with the names of the text where it comes first.
    """

    def __init__(self) -> None:
        self._known = ""
        """What said last that the fence is breached, "text" or "status"; "cleared" if FENCE_STATUS said that it is
        over and the text has not, "" if it is not breached."""
        self._reports = 0
        """Consecutive FENCE_STATUS with a breach of which no text was received."""

    def on_breach_text(self, fences: str) -> Iterator[Event]:
        """A breach, or one 20 m farther out, of the types that the text names."""
        if self._known != "status":
            yield "event.fence_breach", {"fence": fences}
        self._known, self._reports = "text", 0

    def on_cleared_text(self) -> Iterator[Event]:
        """The end of a breach."""
        if self._known != "cleared":
            yield "event.fence_cleared", {}
        self._known, self._reports = "", 0

    def on_status(self, message: Message, *, armed: bool, landed: bool) -> Iterator[Event]:
        """FENCE_STATUS: what the texts do not report. A text in the air may still come, so one report there waits."""
        breached = self._known in ("text", "status")
        if not message.breach_status:
            self._reports = 0
            if breached:
                self._known = "cleared"
                yield "event.fence_cleared", {}
        elif armed and not breached:
            self._reports += 1
            if landed or self._reports > 1:
                self._known, self._reports = "status", 0
                yield "event.fence_breach", {"fence": _BREACH_NAMES.get(message.breach_type, "")}


def read_status_text(text: str, fence: FenceState) -> Iterator[Event]:
    """The events that a text reports."""
    if text in _TEXTS:
        yield _TEXTS[text]
    elif text == _CLEARED:
        yield from fence.on_cleared_text()
    elif breach := _BREACHED.fullmatch(text):
        yield from fence.on_breach_text(breach[1])
    elif power := _BATTERY.fullmatch(text):
        number, level, volts, used = power.groups()
        yield (
            "event.battery",
            {"level": level, "voltage_v": float(volts), "used_mah": float(used), "battery": int(number)},
        )


REPORTS: Final = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 10.0,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 10.0,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 10.0,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
}
"""The reports requested on the private port, in Hz."""
GLITCH_FLAG: Final = 1 << 15
"""EKF_STATUS_REPORT.flags (AP_NavEKF/AP_Nav_Common.h, `gps_glitching`)."""
POSITION_VALID_FLAG: Final = int(dialect.EKF_POS_HORIZ_ABS)
JUMP_M: Final = 1.5
"""A step of the estimate beyond its velocity between two reports counts as a reset."""
_GROUND: Final = int(dialect.MAV_LANDED_STATE_ON_GROUND)
_ARMED: Final = int(dialect.MAV_MODE_FLAG_SAFETY_ARMED)
_DEGREE_M: Final = math.radians(6_378_137.0)
_PUBLIC: Final = ANSWERS | {dialect.MAVLINK_MSG_ID_STATUSTEXT, dialect.MAVLINK_MSG_ID_FENCE_STATUS}


class EventDetector:
    """The known state of one aircraft; every change of it is an event."""

    def __init__(self, system_id: int, origin: Origin) -> None:
        """Of the aircraft with this MAVLink system id, in a range with this origin."""
        self.mode = -1
        self.armed = False
        self.landed = True
        self.flags = 0
        """Of the estimator's last report."""
        self._glitching = False
        self._of = system_id, origin
        self._requests = AnsweredRequests(system_id, origin)
        self._fence = FenceState()
        self._place: tuple[Time, float, float, float, float, float, float] | None = None

    def renew(self) -> EventDetector:
        """Return a detector of the same aircraft that knows nothing yet, as after a reboot."""
        return EventDetector(*self._of)

    def on_upload(self, payload: bytes) -> None:
        """Process a frame to the autopilot: its answer may be an event."""
        if message_id(payload) in REQUESTS:
            try:
                self._requests.on_request(decode(payload))
            except DecodeError:
                return

    def on_public_frame(self, payload: bytes) -> Iterator[Event]:
        """The events in a frame from its public port."""
        number = message_id(payload)
        if number not in _PUBLIC:
            return
        message = decode(payload)
        if number == dialect.MAVLINK_MSG_ID_STATUSTEXT:
            yield from read_status_text(message.text, self._fence)
        elif number == dialect.MAVLINK_MSG_ID_FENCE_STATUS:
            yield from self._fence.on_status(message, armed=self.armed, landed=self.landed)
        else:
            yield from self._requests.on_answer(message, landed=self.landed)

    def on_report(self, message: Message) -> Iterator[Event]:
        """The events in a message from its private port."""
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.autopilot != dialect.MAV_AUTOPILOT_INVALID:
            if message.custom_mode != self.mode:
                first, self.mode = self.mode < 0, message.custom_mode
                if not first:
                    name = mode_name(message.type, message.autopilot, self.mode)
                    yield "event.mode", {"mode": name, "number": self.mode, "reason": ""}
            armed = bool(message.base_mode & _ARMED)
            if armed != self.armed:
                self.armed = armed
                yield ("event.armed", {"forced": False}) if armed else ("event.disarmed", {"reason": ""})
        elif kind == "EXTENDED_SYS_STATE":
            landed = message.landed_state == _GROUND
            if landed != self.landed:
                self.landed = landed
                yield ("event.landed" if landed else "event.takeoff"), {}
        elif kind == "EKF_STATUS_REPORT":
            self.flags = message.flags
            glitching = bool(message.flags & GLITCH_FLAG)
            if glitching != self._glitching:
                self._glitching = glitching
                yield "event.glitch", {"on": glitching}
        elif kind == "GLOBAL_POSITION_INT":
            yield from self._moved(message)

    def _moved(self, message: Message) -> Iterator[Event]:
        """A jump of the reported position is a reset of the estimator."""
        now = message.time_boot_ms * NS_PER_MS
        lat, lon, up = message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3
        velocity = (message.vx * 1e-2, message.vy * 1e-2, -message.vz * 1e-2)
        before, self._place = self._place, (now, lat, lon, up, *velocity)
        if before is None or not self.flags & POSITION_VALID_FLAG:
            return
        north = (lat - before[1]) * _DEGREE_M
        east = (lon - before[2]) * _DEGREE_M * elementary.cos(math.radians(lat))
        seconds = (now - before[0]) / NS_PER_S
        jump = [
            moved_m - 0.5 * seconds * (speed + was)
            for moved_m, speed, was in zip((north, east, up - before[3]), velocity, before[4:], strict=True)
        ]
        if elementary_python.distance(jump, (0.0,) * len(jump)) >= JUMP_M:
            yield "event.estimator", {"reset": "position", "east_m": jump[1], "north_m": jump[0], "up_m": jump[2]}
