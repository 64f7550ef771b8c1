"""Encoder of F3411-22a: messages → 25 bytes, packs → 3 + 25 n bytes.

The first byte of each message is type and protocol version, four bits each; integers are little-endian. Byte offsets
as in the tables of F3411-22a and `libopendroneid/opendroneid.h` (`ODID_*_encoded`).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from skyrange.codec.f3411 import values
from skyrange.codec.f3411.messages import (
    Authentication,
    BasicId,
    Location,
    Message,
    MessagePack,
    MessageType,
    OperatorId,
    Reserved,
    SelfId,
    SingleMessage,
    System,
)

SIZE = 25
"""Bytes of a message."""
PACK_HEADER = 3
MAX_PACK_MESSAGES = 9
"""Messages in a pack: 228 bytes, the capacity of one Bluetooth 5 or Wi-Fi broadcast (F3411-22a, Message Pack)."""
PAGE_0_DATA = 17
PAGE_DATA = 23

LOCATION = struct.Struct("<xBBBbiiHHHBBHBx")
"""flags, track, speed, vertical, lat, lon, baro, geo, height, accuracies ×2, time, time accuracy."""
SYSTEM = struct.Struct("<xBiiHBHHBHIx")
"""flags, lat, lon, count, radius, ceiling, floor, category and class, altitude, time."""
AUTH_0 = struct.Struct("<xBBBI17s")
"""type and page, last page, length, time, data."""


def encode(message: Message) -> bytes:
    """The bytes of `message`; raises `ValueError` naming a value that cannot be encoded.

    Values that the standard forbids but that can be encoded (a latitude of 95°, a reserved status) are written as
    given.
    """
    if isinstance(message, MessagePack):
        return encode_pack([_single(part) for part in message.messages], message.version)
    return _single(message)


def encode_pack(bodies: list[bytes], version: int) -> bytes:
    """The pack of 1…9 messages of 25 bytes each."""
    if not 1 <= len(bodies) <= MAX_PACK_MESSAGES:
        raise ValueError(f"{len(bodies)} messages in a pack, expected 1…{MAX_PACK_MESSAGES}")
    return bytes([_first_byte(MessageType.MESSAGE_PACK, version), SIZE, len(bodies)]) + b"".join(bodies)


def _single(message: SingleMessage) -> bytes:
    try:
        return _ENCODERS[type(message)](message)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{message}: {error}") from error
    except KeyError:
        raise ValueError(f"{type(message).__name__} is not a message of 25 bytes") from None


def _nibbles(high: int, low: int, what: str) -> int:
    if not (0 <= high <= 15 and 0 <= low <= 15):
        raise ValueError(f"{what}: {high} and {low}, both must be in 0…15")
    return high << 4 | low


def _first_byte(message_type: int, version: int) -> int:
    return _nibbles(message_type, version, "message type and version")


def _text(text: str, size: int, what: str) -> bytes:
    try:
        raw = text.encode("latin-1")
    except UnicodeEncodeError:
        raise ValueError(f"{what} {text!r}: one byte per character (latin-1)") from None
    if len(raw) > size:
        raise ValueError(f"{what} {text!r}: {len(raw)} bytes, at most {size}")
    return raw.ljust(size, b"\0")


def _basic_id(message: BasicId) -> bytes:
    kinds = _nibbles(message.id_type, message.ua_type, "id_type and ua_type")
    return (
        bytes([_first_byte(MessageType.BASIC_ID, message.version), kinds])
        + _text(message.uas_id, 20, "uas_id")
        + bytes(3)
    )


def _location(message: Location) -> bytes:
    track, west = values.encode_track(message.track_deg)
    speed, fast = values.encode_speed(message.speed_mps)
    lat, lon = values.encode_position(message.lat_deg, message.lon_deg)
    if message.height_type not in (0, 1):
        raise ValueError(f"height_type {message.height_type}: 0 or 1")
    flags = _nibbles(message.status, message.height_type << 2 | west << 1 | fast, "status and flags")
    body = bytearray(
        LOCATION.pack(
            flags, track, speed, values.encode_vertical(message.vertical_mps), lat, lon,
            values.encode_altitude(message.alt_baro_m), values.encode_altitude(message.alt_geo_m),
            values.encode_altitude(message.height_m),
            _nibbles(message.vertical_accuracy, message.horizontal_accuracy, "vertical and horizontal accuracy"),
            _nibbles(message.baro_accuracy, message.speed_accuracy, "baro and speed accuracy"),
            values.encode_time(message.timestamp_s), _nibbles(0, message.timestamp_accuracy, "timestamp accuracy"),
        )
    )  # fmt: skip
    body[0] = _first_byte(MessageType.LOCATION, message.version)
    return bytes(body)


def _authentication(message: Authentication) -> bytes:
    first = _first_byte(MessageType.AUTHENTICATION, message.version)
    kinds = _nibbles(message.auth_type, message.page, "auth_type and page")
    size = PAGE_DATA if message.page else PAGE_0_DATA
    if len(message.data) > size:
        raise ValueError(f"{len(message.data)} bytes of data on page {message.page}, at most {size}")
    if message.page:
        return bytes([first, kinds]) + message.data.ljust(size, b"\0")
    last, length, time = (value or 0 for value in (message.last_page, message.length, message.timestamp_s))
    return bytes([first]) + AUTH_0.pack(kinds, last, length, time, message.data)[1:]


def _self_id(message: SelfId) -> bytes:
    head = struct.pack("BB", _first_byte(MessageType.SELF_ID, message.version), message.description_type)
    return head + _text(message.text, 23, "text")


def _system(message: System) -> bytes:
    lat, lon = values.encode_position(message.operator_lat_deg, message.operator_lon_deg)
    if not (0 <= message.operator_location_type <= 3 and 0 <= message.classification <= 7):
        raise ValueError(
            f"operator_location_type {message.operator_location_type} of 0…3,"
            f" classification {message.classification} of 0…7"
        )
    radius = round(min(max(message.area_radius_m, 0.0), values.RADIUS_MAX_M) / values.RADIUS_STEP_M)
    body = SYSTEM.pack(
        message.classification << 2 | message.operator_location_type, lat, lon, message.area_count, radius,
        values.encode_altitude(message.area_ceiling_m), values.encode_altitude(message.area_floor_m),
        _nibbles(message.category, message.ua_class, "category and ua_class"),
        values.encode_altitude(message.operator_alt_geo_m), message.timestamp_s,
    )  # fmt: skip
    return bytes([_first_byte(MessageType.SYSTEM, message.version)]) + body[1:]


def _operator_id(message: OperatorId) -> bytes:
    head = struct.pack("BB", _first_byte(MessageType.OPERATOR_ID, message.version), message.operator_id_type)
    return head + _text(message.operator_id, 20, "operator_id") + bytes(3)


def _reserved(message: Reserved) -> bytes:
    if len(message.data) != SIZE - 1:
        raise ValueError(f"{len(message.data)} bytes of data, expected {SIZE - 1}")
    return bytes([_first_byte(message.message_type, message.version)]) + message.data


_ENCODERS: Final[dict[type, Callable[[Any], bytes]]] = {
    BasicId: _basic_id, Location: _location, Authentication: _authentication, SelfId: _self_id, System: _system,
    OperatorId: _operator_id, Reserved: _reserved,
}  # fmt: skip
