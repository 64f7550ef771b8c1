"""Events of an ArduPilot that answer what it was sent: stored missions, fences, rally points, parameters and homes.

A frame to the autopilot says what is asked for, and its answer on the same link that this was done: MISSION_ACK to the
sender of an upload (MissionItemProtocol.cpp), PARAM_VALUE with the value that was set (AP_Param.cpp, `set_float`),
HOME_POSITION at each change of home (AP_AHRS.cpp, `set_home`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final

from skyrange.codec.mavlink import Message, dialect
from skyrange.core.geodesy import Origin
from skyrange.vehicle.mavlink_state.status_texts import Event

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

    def on_answer(self, message: Message, landed: bool) -> Iterator[Event]:
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
            yield from self._on_home(message, landed)
        elif message.command == dialect.MAV_CMD_DO_SET_HOME and message.result != dialect.MAV_RESULT_ACCEPTED:
            self._home_asked = False

    def _on_mission_ack(self, message: Message) -> Iterator[Event]:
        """A list is stored when the sender of its items, or of its clearing, is told so."""
        list_type = message.mission_type
        key = list_type, (message.target_system, message.target_component)
        if message.type == dialect.MAV_MISSION_ACCEPTED and key in self._announced and list_type in _LISTS:
            self._stored[list_type] = self._announced.pop(key)
            yield _LISTS[list_type], {"items": self._stored[list_type]}

    def _on_home(self, message: Message, landed: bool) -> Iterator[Event]:
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
    told = float(message.param_value)
    if message.param_type not in _INTEGERS:
        return told == wanted
    least, most = _INTEGERS[message.param_type]
    return abs(told - min(max(wanted, least), most)) < 1.0
