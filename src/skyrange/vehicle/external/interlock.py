"""Safety interlock for external vehicles: frames that could cause motion are not sent unless motion is permitted.

Closed, it passes only frames that read data or request telemetry, by a list of harmless ones; open, it passes every
frame to this one vehicle. In both states, anything that is not a whole frame of the dialect, or is addressed to
another system, is refused.

Three rules are less obvious than arming:

- A ground station's HEARTBEAT is refused too: an autopilot takes its end for a lost link, and returns or lands
  (FS_GCS_ENABLE), and while it is sent it hides that the real ground station's has ended.
- A frame must not contain another one: if a radio loses a byte, the receiver looks for the next frame inside what
  follows. So no position in all that was sent may begin a frame that would not have passed by itself.
- MAVLink 1 makes some autopilots answer in it, signatures are 13 free bytes, and a MAVLink 2 frame may be longer than
  its definition. None of these is needed for a request.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from skyrange.codec.mavlink import Message, decode, message_name
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.deframer import Deframer
from skyrange.codec.mavlink.frames import CHECKSUM, HEADER_V2, LAYOUTS, MAGIC_V1, MAGIC_V2, SIGNATURE, SIGNED
from skyrange.core.errors import DecodeError

MAX_HZ: Final = 50.0
"""Highest rate at which a message may be requested while closed: the telemetry radio is shared with the vehicle's
pilot."""
MAX_FRAME_BYTES: Final = HEADER_V2 + 255 + CHECKSUM + SIGNATURE
_AUTOPILOT: Final = (0, int(mav.MAV_COMP_ID_AUTOPILOT1))
_OTHERS: Final = "for another system"
_NOT_ASKING: Final = "more than asking"


def _rate(interval_us: float) -> bool:
    return interval_us == 0.0 or (math.isfinite(interval_us) and interval_us >= 1e6 / MAX_HZ)


def _always(_: Message) -> bool:
    return True


PERMITTED_COMMANDS: Final[Mapping[int, Callable[[Message], bool]]] = {
    mav.MAV_CMD_GET_HOME_POSITION: _always,
    mav.MAV_CMD_GET_MESSAGE_INTERVAL: _always,
    mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _always,
    mav.MAV_CMD_REQUEST_MESSAGE: _always,
    mav.MAV_CMD_REQUEST_PROTOCOL_VERSION: _always,
    mav.MAV_CMD_SET_MESSAGE_INTERVAL: lambda command: _rate(command.param2),
}
"""Commands permitted in COMMAND_LONG while closed, and the condition on their parameters."""

PERMITTED_MESSAGES: Final[Mapping[int, Callable[[Message], bool]]] = {
    mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION_REQUEST: _always,
    mav.MAVLINK_MSG_ID_COMMAND_LONG: lambda decoded: PERMITTED_COMMANDS.get(decoded.command, lambda _: False)(decoded),
    mav.MAVLINK_MSG_ID_MISSION_ACK: _always,
    mav.MAVLINK_MSG_ID_MISSION_REQUEST: _always,
    mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT: _always,
    mav.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: _always,
    mav.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: _always,
    mav.MAVLINK_MSG_ID_PARAM_REQUEST_READ: _always,
    mav.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: lambda decoded: decoded.req_message_rate <= MAX_HZ,
}
"""Messages permitted to the vehicle while closed."""
UNADDRESSED: Final = frozenset((mav.MAVLINK_MSG_ID_PING, mav.MAVLINK_MSG_ID_TIMESYNC))
"""Also permitted, to the vehicle or to all."""


class Refusal(NamedTuple):
    """Why a frame was refused; all three are words of our own, of which there are few."""

    message: str
    """Its name, "unknown" for one outside the dialect, "" for anything but a frame."""
    command: str
    why: str


class Interlock:
    """Between the range and one vehicle of MAVLink system `system_id`; `open_` lets motion through."""

    def __init__(self, system_id: int, *, open_: bool = False) -> None:
        self.system_id = system_id
        self.open = open_
        self.passed = 0
        self.refused: dict[Refusal, int] = {}
        """Number of refused frames, by reason."""
        self._sent = b""
        """The last bytes that were sent."""

    def check(self, payload: bytes) -> Refusal | None:
        """Why `payload` must not be sent; `None` if it may. A permitted payload counts as sent in later checks."""
        refusal = self._check_alone(payload) or self._check_embedded(payload)
        if refusal is None:
            self.passed += 1
            self._sent = (self._sent + payload)[-MAX_FRAME_BYTES:]
        else:
            self.refused[refusal] = self.refused.get(refusal, 0) + 1
        return refusal

    def _check_alone(self, payload: bytes) -> Refusal | None:
        try:
            decoded = decode(payload)
        except DecodeError:
            return Refusal("", "", "not a whole frame of the dialect")
        number = int(type(decoded).id)
        refusal = Refusal(str(decoded.get_type()), _command(decoded), "")
        targets = _targets(decoded)
        if any(target not in (0, self.system_id) for target in targets):
            return refusal._replace(why=_OTHERS)
        if self.open:
            addressed = number in UNADDRESSED or not targets or self.system_id in targets
            return None if addressed else refusal._replace(why="for all systems")
        if payload[0] == MAGIC_V1:
            return refusal._replace(why="MAVLink 1")
        if payload[2] & SIGNED:
            return refusal._replace(why="signed")
        if payload[1] > LAYOUTS[number].size:
            return refusal._replace(why="longer than its definition")
        if number in UNADDRESSED:
            return None
        if number == mav.MAVLINK_MSG_ID_HEARTBEAT:
            is_own = decoded.get_srcSystem() == self.system_id and decoded.get_srcComponent() not in _AUTOPILOT
            harmless = is_own and decoded.type == mav.MAV_TYPE_ONBOARD_CONTROLLER
            return None if harmless else refusal._replace(why="heartbeats of a ground station arm its failsafe")
        allowed = PERMITTED_MESSAGES.get(number)
        if allowed is None or not allowed(decoded):
            return refusal._replace(why=_NOT_ASKING)
        if targets != [self.system_id] or decoded.target_component not in _AUTOPILOT:
            return refusal._replace(why="for another component" if self.system_id in targets else "for all systems")
        return None

    def _check_embedded(self, payload: bytes) -> Refusal | None:
        """Whether a receiver that starts at any other byte would find a frame that is not permitted."""
        stream, begins = self._sent + payload, len(self._sent)
        for at, byte in enumerate(stream):
            if byte not in (MAGIC_V1, MAGIC_V2) or at == begins:
                continue
            pieces = Deframer().feed(stream[at:])
            if pieces and not pieces[0].garbage and self._check_alone(pieces[0].data):
                return Refusal(message_name(payload) or "", "", "another frame is hidden in it")
        return None


def _targets(decoded: Message) -> list[int]:
    """The target system of a message, if it has one; 0 is all systems."""
    fields: Any = LAYOUTS[type(decoded).id].fields
    return [getattr(decoded, name) for name, *_ in fields if name in ("target_system", "target")]


def _command(decoded: Message) -> str:
    number = getattr(decoded, "command", None)
    if not isinstance(number, int):
        return ""
    entry = mav.enums["MAV_CMD"].get(number)
    return str(entry.name) if entry is not None else "unknown"
