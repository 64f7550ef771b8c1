"""Harmless frames: what a sham sends in place of hostile ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from skyrange.codec.mavlink import Message, dialect, message_id
from skyrange.codec.mavlink.frames import CHECKSUM, HEADER_V2, LAYOUTS, MAGIC_V2, checksum

Receiver = tuple[int, int]
"""System and component id."""
IGNORED_CHANNEL: Final = 65535
"""RC_CHANNELS_OVERRIDE leaves a channel with it as it is (GCS_Common.cpp, `handle_rc_channels_override`)."""
IGNORED_AXIS: Final = 32767
"""MANUAL_CONTROL has no value for an axis with it (mavlink.io, MANUAL_CONTROL)."""


def harmless_message(message: Message) -> Message | None:
    """A message to the same receiver, as long as `message` when it is packed, that changes nothing and that an
    autopilot answers where it answers `message`; `None` where there is none.

    By ArduPilot: a command becomes REQUEST_MESSAGE of a HEARTBEAT, which is accepted (GCS_Common.cpp,
    `handle_command_request_message`); sticks leave all channels as they are (`handle_rc_channels_override`); the count
    of an upload becomes a request of the first item, and the removal of a mission a request of its count (mavlink.io,
    Mission protocol).
    """
    name = message.get_type()
    if name == "MANUAL_CONTROL":
        return dialect.MAVLink_manual_control_message(message.target, *[IGNORED_AXIS] * 4, 0)
    make = _HARMLESS.get(name)
    return None if make is None else make((message.target_system, message.target_component), message)


_REQUEST: Final = int(dialect.MAV_CMD_REQUEST_MESSAGE)
_HARMLESS: Final[dict[str, Callable[[Receiver, Message], Message]]] = {
    "COMMAND_LONG": lambda to, _: dialect.MAVLink_command_long_message(*to, _REQUEST, 0, *[0.0] * 7),
    "COMMAND_INT": lambda to, message: dialect.MAVLink_command_int_message(
        *to, message.frame, _REQUEST, 0, 0, *[0.0] * 4, 0, 0, 0.0
    ),
    "RC_CHANNELS_OVERRIDE": lambda to, _: dialect.MAVLink_rc_channels_override_message(*to, *[IGNORED_CHANNEL] * 8),
    "MISSION_COUNT": lambda to, message: dialect.MAVLink_mission_request_int_message(*to, 0, message.mission_type),
    "MISSION_CLEAR_ALL": lambda to, message: dialect.MAVLink_mission_request_list_message(*to, message.mission_type),
}
"""By name of a message: what has its length and changes nothing. REQUEST_MESSAGE of message 0 is of a HEARTBEAT."""


def benign_payload(payload: bytes) -> bytes:
    """Bytes of the same length that ask for nothing and report nothing: what a sham sends instead of `payload`.

    In place of a MAVLink frame that is an ENCAPSULATED_DATA with the same sender and sequence number, which no
    component of the range reads, as far as its payload of at most 255 bytes is long enough; else zeros.
    """
    size = len(payload) - HEADER_V2 - CHECKSUM
    if message_id(payload) is None or not 1 <= size <= 255:
        return bytes(len(payload))
    sender = payload[4:7] if payload[0] == MAGIC_V2 else payload[2:5]
    return mavlink_frame(dialect.MAVLINK_MSG_ID_ENCAPSULATED_DATA, sender, bytes(size - 1) + b"\1")


def mavlink_frame(number: int, sender: bytes, body: bytes) -> bytes:
    """A MAVLink 2 frame of a payload as it is; `sender` has sequence number, system id and component id."""
    header = bytes([MAGIC_V2, len(body), 0, 0]) + sender + number.to_bytes(3, "little")
    covered = header + body
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(CHECKSUM, "little")
