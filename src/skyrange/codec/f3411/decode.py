"""Decoder of F3411-22a: 25 bytes → a message, 3 + 25 n bytes → a pack.

Any 25 bytes are a valid message unless their type is that of a pack. Values outside the standard are decoded as they
are and named by `deviations`; a reserved message type becomes `Reserved`. Only a body with an inconsistent length is
refused.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from skyrange.codec.f3411 import values
from skyrange.codec.f3411.encode import AUTH_0, LOCATION, MAX_PACK_MESSAGES, PACK_HEADER, SIZE, SYSTEM
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
from skyrange.core.errors import DecodeError


def decode(body: bytes) -> Message:
    """Decode the message or pack that is the whole of `body`; raises `DecodeError` if its length is wrong."""
    if not body:
        raise DecodeError("no bytes, an F3411 message has 25 and a pack 3 + 25 n")
    if body[0] >> 4 == MessageType.MESSAGE_PACK:
        return _pack(body)
    if len(body) != SIZE:
        raise DecodeError(f"{len(body)} bytes, an F3411 message has {SIZE}")
    return _single(body)


def _pack(body: bytes) -> MessagePack:
    if len(body) < PACK_HEADER:
        raise DecodeError(f"{len(body)} bytes, a message pack has at least {PACK_HEADER + SIZE}")
    size, count = body[1], body[2]
    if size != SIZE:
        raise DecodeError(f"a pack of messages of {size} bytes, expected {SIZE}")
    if not 1 <= count <= MAX_PACK_MESSAGES:
        raise DecodeError(f"a pack of {count} messages, expected 1…{MAX_PACK_MESSAGES}")
    if len(body) != PACK_HEADER + SIZE * count:
        raise DecodeError(f"{len(body)} bytes, a pack of {count} messages has {PACK_HEADER + SIZE * count}")
    starts = range(PACK_HEADER, len(body), SIZE)
    return MessagePack(tuple(_single(body[at : at + SIZE]) for at in starts), body[0] & 15)


def _single(body: bytes) -> SingleMessage:
    decoder = _DECODERS.get(body[0] >> 4)
    version = body[0] & 15
    return decoder(body, version) if decoder else Reserved(body[0] >> 4, body[1:], version)


def _text(raw: bytes) -> str:
    return raw.rstrip(b"\0").decode("latin-1")


def _basic_id(body: bytes, version: int) -> BasicId:
    return BasicId(body[1] >> 4, body[1] & 15, _text(body[2:22]), version)


def _location(body: bytes, version: int) -> Location:
    flags, track, speed, vertical, lat, lon, baro, geo, height, first, second, time, third = LOCATION.unpack(body)
    lat_deg, lon_deg = values.decode_position(lat, lon)
    return Location(
        flags >> 4, lat_deg, lon_deg, values.decode_altitude(geo), values.decode_altitude(baro),
        values.decode_altitude(height), flags >> 2 & 1, values.decode_speed(speed, flags & 1),
        values.decode_vertical(vertical), values.decode_track(track, flags >> 1 & 1),
        first & 15, first >> 4, second >> 4, second & 15, third & 15, values.decode_time(time), version,
    )  # fmt: skip


def _authentication(body: bytes, version: int) -> Authentication:
    auth_type, page = body[1] >> 4, body[1] & 15
    if page:
        return Authentication(auth_type, page, body[2:], version=version)
    _, last_page, length, timestamp_s, data = AUTH_0.unpack(body)
    return Authentication(auth_type, page, data, last_page, length, timestamp_s, version)


def _self_id(body: bytes, version: int) -> SelfId:
    return SelfId(body[1], _text(body[2:]), version)


def _system(body: bytes, version: int) -> System:
    flags, lat, lon, count, radius, ceiling, floor, kinds, altitude, timestamp_s = SYSTEM.unpack(body)
    lat_deg, lon_deg = values.decode_position(lat, lon)
    return System(
        flags & 3, lat_deg, lon_deg, values.decode_altitude(altitude), count, float(radius * values.RADIUS_STEP_M),
        values.decode_altitude(ceiling), values.decode_altitude(floor), flags >> 2 & 7, kinds >> 4, kinds & 15,
        timestamp_s, version,
    )  # fmt: skip


def _operator_id(body: bytes, version: int) -> OperatorId:
    return OperatorId(body[1], _text(body[2:22]), version)


_DECODERS: Final[dict[int, Callable[[bytes, int], SingleMessage]]] = {
    MessageType.BASIC_ID: _basic_id, MessageType.LOCATION: _location, MessageType.AUTHENTICATION: _authentication,
    MessageType.SELF_ID: _self_id, MessageType.SYSTEM: _system, MessageType.OPERATOR_ID: _operator_id,
}  # fmt: skip
