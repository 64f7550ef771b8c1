"""The files @MISSION/mission.dat, fence.dat and rally.dat: a header and MISSION_ITEM_INT after MISSION_ITEM_INT.

After libraries/AP_Filesystem/AP_Filesystem_Mission.cpp and .h of ArduPilot 4.6.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

from skyrange.codec.mavlink import Message, dialect
from skyrange.core.errors import DecodeError

DIRECTORY: Final = "@MISSION/"
TYPES: Final = {
    "mission.dat": int(dialect.MAV_MISSION_TYPE_MISSION),
    "fence.dat": int(dialect.MAV_MISSION_TYPE_FENCE),
    "rally.dat": int(dialect.MAV_MISSION_TYPE_RALLY),
}
"""MAV_MISSION_TYPE by name of the file."""
_MAGIC: Final = 0x763D
_HEADER: Final = struct.Struct("<HHHHH")
"""Magic, MAV_MISSION_TYPE, options, number of the first item, number of items."""
_MOST: Final = 0xFFFF
NO_CLEAR: Final = 1
"""Option: what is there stays, and items are replaced or added."""
_ITEM: Final = struct.Struct("<4f2ifHHBBBBBB")
"""MISSION_ITEM_INT as it is sent: parameters, x, y, z, seq, command, target, frame, current, autocontinue, type."""


class MissionUpload(NamedTuple):
    """What a file says: options, the number of the first item, and the items."""

    options: int
    start: int
    items: list[Message]


def pack(items: Sequence[Message], mission_type: int) -> bytes:
    """The file with these MISSION_ITEM_INT, which as an upload replaces all items of that MAV_MISSION_TYPE."""
    head = _HEADER.pack(_MAGIC, mission_type, 0, 0, len(items))
    return head + b"".join(_pack_item(item) for item in items)


def stated_length(data: bytes) -> int:
    """The length of an upload by its header, 0 where the data have none (ArduPilot does not read the magic here)."""
    if len(data) < _HEADER.size:
        return 0
    count: int = _HEADER.unpack_from(data)[4]
    return _HEADER.size + count * _ITEM.size if count < _MOST else 0


def read(data: bytes, mission_type: int) -> MissionUpload:
    """What a file says. Raises `DecodeError` for another length than it says, and for an item of zeros alone."""
    if len(data) < _HEADER.size:
        raise DecodeError(f"packed mission: {len(data)} bytes, expected a header of {_HEADER.size}")
    magic, _, options, start, count = _HEADER.unpack_from(data)
    body = data[_HEADER.size :]
    if magic != _MAGIC or len(body) // _ITEM.size != count:
        raise DecodeError(f"packed mission: magic {magic:#06x} and {count} items in {len(data)} bytes")
    rows = [body[at : at + _ITEM.size] for at in range(0, count * _ITEM.size, _ITEM.size)]
    if any(not any(row) for row in rows):
        raise DecodeError("packed mission: an item of zeros, which the client has not filled in")
    return MissionUpload(options, start, [_read_item(row, mission_type) for row in rows])


def _pack_item(item: Message) -> bytes:
    return _ITEM.pack(
        item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z, item.seq, item.command,
        item.target_system, item.target_component, item.frame, item.current, item.autocontinue, item.mission_type,
    )  # fmt: skip


def _read_item(row: bytes, mission_type: int) -> Message:
    a, b, c, d, x, y, z, seq, command, system, component, frame, current, autocontinue, _ = _ITEM.unpack(row)
    return dialect.MAVLink_mission_item_int_message(
        system, component, seq, frame, command, current, autocontinue, a, b, c, d, x, y, z, mission_type
    )
