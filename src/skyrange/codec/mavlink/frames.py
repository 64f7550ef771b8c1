"""MAVLink frames: layout of both protocol versions, decoding, packing, and header fields without decoding.

Writes MAVLink 2 and reads MAVLink 2 and 1, by pymavlink's ardupilotmega dialect. Signatures are accepted on input and
**not verified**; `codec.mavlink.signing` verifies them for those who hold a key. Output is unsigned, which is
ArduPilot's default.

Messages that `decode` returns are memoised by payload and therefore shared: treat them as immutable. `decode_anew`,
which plugins are given, returns one of the caller's own. Arrays are tuples.

Sources of the layout: https://mavlink.io/en/guide/serialization.html (frame, payload truncation, CRC with extra) and
https://mavlink.io/en/guide/message_signing.html (13-byte signature). The payload tables are pymavlink's own, of its
ardupilotmega dialect, so that field offsets are not stated a second time.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from operator import attrgetter
from typing import Any, NamedTuple, TypeAlias, cast

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyrange.core.errors import DecodeError

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
HEADER_V1 = 6
HEADER_V2 = 10
CHECKSUM = 2
SIGNATURE = 13
SIGNED = 0x01
"""The only incompatibility flag defined so far (MAVLINK_IFLAG_SIGNED)."""
MIN_FRAME = HEADER_V1 + CHECKSUM

unpack_header_v1 = struct.Struct("<xBBBBB").unpack_from
"""length, sequence, system, component, message id — after the magic byte."""
unpack_header_v2 = struct.Struct("<xBBBBBBHB").unpack_from
"""length, incompat, compat, sequence, system, component, message id low 16 bits, high 8 bits."""
pack_header_v2 = struct.Struct("<BBBBBBBHB").pack


class Field(NamedTuple):
    """One field of a message in the order of its constructor: values `start:stop` of the unpacked payload."""

    name: str
    start: int
    stop: int
    kind: str  # "scalar" | "text" | "array"


class Layout(NamedTuple):
    """The wire format of one message id. Wire order differs from the constructor's order (largest type first)."""

    cls: Any
    """The pymavlink message class."""
    crc_extra: bytes
    """One byte, mixed into the checksum, that both ends derive from the message's definition."""
    size: int
    """Bytes of the whole payload, extensions included."""
    unpack: Callable[[bytes], tuple[Any, ...]]
    pack: Callable[..., bytes]
    fields: tuple[Field, ...]
    scalar_order: tuple[int, ...] | None
    """For a message of scalars only: the index of each constructor argument in the unpacked payload."""
    wire_values: Callable[[Any], Any]
    """Returns the message's values in wire order, arrays nested; a bare value if there is one field."""
    array_fields: tuple[Field, ...]
    """For a message with arrays: its fields in wire order."""


def _start(field: Field) -> int:
    return field.start


def _layout(cls: Any) -> Layout:
    fields = []
    for name, kind, order in zip(cls.fieldnames, cls.fieldtypes, cls.orders, strict=True):
        start = sum(cls.lengths[:order])
        length = cls.lengths[order]
        sort = "text" if kind == "char" else "array" if cls.array_lengths[order] else "scalar"
        fields.append(Field(name, start, start + length, sort))
    texts = {field.name for field in fields if field.kind == "text"}
    wire_names = [f"_{name}_raw" if name in texts else name for name in cls.ordered_fieldnames]
    scalars_only = all(field.kind == "scalar" for field in fields)
    return Layout(
        cls=cls,
        crc_extra=bytes([cls.crc_extra]),
        size=cls.unpacker.size,
        unpack=cls.unpacker.unpack,
        pack=cls.unpacker.pack,
        fields=tuple(fields),
        scalar_order=tuple(field.start for field in fields) if scalars_only else None,
        wire_values=attrgetter(*wire_names),
        array_fields=tuple(sorted(fields, key=_start)) if any(field.kind == "array" for field in fields) else (),
    )


LAYOUTS: dict[int, Layout] = {number: _layout(cls) for number, cls in dialect.mavlink_map.items()}
"""The layout of every message id of the dialect."""


def checksum(covered: bytes, crc_extra: bytes) -> int:
    """CRC-16/MCRF4XX of the frame from its second byte to the end of its payload, then `crc_extra`."""
    crc: int = mcrf4xx(covered + crc_extra)
    return crc


__all__ = [
    "Message",
    "Packer",
    "decode",
    "decode_anew",
    "dialect",
    "encode_payload",
    "message_fields",
    "message_id",
    "message_name",
    "sender_system",
]

Message: TypeAlias = Any
"""A pymavlink `MAVLink_message`: fields as attributes, `get_msgId()`, `get_type()`, `get_srcSystem()`, `get_seq()`.

The message id is `type(message).id`: in STATUSTEXT and others `id` is a field."""

MEMO_FRAMES = 16_384
"""Distinct payloads kept decoded (about 1.3 kB each): enough for what a thousand aircraft send during a few hops."""


def decode_anew(payload: bytes) -> Message:
    """Decode `payload`, which must be exactly one valid frame of MAVLink 2 or 1; raises `DecodeError` otherwise.

    Checked: magic, length against the header's, incompatibility flags, a message id of the dialect, checksum. A
    MAVLink 2 payload may lack trailing zeros. Bytes beyond the known definition (extensions of a newer sender) are
    ignored. The message is the caller's own: to alter it alters nothing else.
    """
    size = len(payload)
    if size < MIN_FRAME:
        raise DecodeError(f"{size} bytes, a MAVLink frame has at least {MIN_FRAME}")
    magic = payload[0]
    incompat = compat = 0
    tail = CHECKSUM
    if magic == MAGIC_V2:
        if size < HEADER_V2 + CHECKSUM:
            raise DecodeError(f"{size} bytes, a MAVLink 2 frame has at least {HEADER_V2 + CHECKSUM}")
        length, incompat, compat, sequence, system, component, low, high = unpack_header_v2(payload)
        number = low | high << 16
        start = HEADER_V2
        if incompat:
            if incompat & ~SIGNED:
                raise DecodeError(f"incompatibility flags 0x{incompat:02x}, only 0x01 (signed) is known")
            tail += SIGNATURE
    elif magic == MAGIC_V1:
        length, sequence, system, component, number = unpack_header_v1(payload)
        start = HEADER_V1
    else:
        raise DecodeError(f"first byte 0x{magic:02x}, MAVLink frames begin with 0xfd or 0xfe")
    end = start + length
    if size != end + tail:
        raise DecodeError(f"{size} bytes, but the header announces {end + tail}")
    layout = LAYOUTS.get(number)
    if layout is None:
        raise DecodeError(f"message id {number} is not in the ardupilotmega dialect")
    cls, crc_extra, full, unpack, _, fields, scalar_order, _, _ = layout
    crc = checksum(payload[1:end], crc_extra)
    if payload[end] | payload[end + 1] << 8 != crc:
        raise DecodeError(f"{cls.msgname} checksum 0x{payload[end] | payload[end + 1] << 8:04x}, expected 0x{crc:04x}")
    body = payload[start:end]
    values = unpack(body if length == full else body[:full].ljust(full, b"\0"))
    if scalar_order is not None:
        message = cls(*[values[place] for place in scalar_order])
    else:
        arguments: list[Any] = []
        for _, first, stop, kind in fields:
            if kind == "scalar":
                arguments.append(values[first])
            elif kind == "text":
                arguments.append(values[first].rstrip(b"\0"))
            else:
                arguments.append(values[first:stop])
        message = cls(*arguments)
    message._msgbuf = payload
    message._payload = body
    message._crc = crc
    header = message._header
    header.mlen = length
    header.seq = sequence
    header.srcSystem = system
    header.srcComponent = component
    header.incompat_flags = incompat
    header.compat_flags = compat
    return message


decode = cast("Callable[[bytes], Message]", lru_cache(maxsize=MEMO_FRAMES)(decode_anew))
"""`decode_anew` with the results of the last `MEMO_FRAMES` payloads, which all callers share."""


class Packer:
    """Packs one component's messages as MAVLink 2 frames, with its own rolling sequence number.

    Frames are unsigned; trailing zeros of the payload are cut. The state is three integers, so copies continue alike.
    """

    __slots__ = ("component", "sequence", "system")

    def __init__(self, system: int, component: int) -> None:
        """`system` and `component` are 0…255, else `ValueError`."""
        if not (0 <= system <= 255 and 0 <= component <= 255):
            raise ValueError(f"system {system}, component {component}: both must be in 0…255")
        self.system = system
        self.component = component
        self.sequence = 0

    def take_sequence(self) -> int:
        """Take the next sequence number for a frame that is packed elsewhere."""
        sequence = self.sequence
        self.sequence = (sequence + 1) & 0xFF
        return sequence

    def pack(self, message: Message) -> bytes:
        """The frame of `message`, which is not modified; raises `ValueError` naming a field that does not fit."""
        number: int = type(message).id  # not message.id, which is a field of STATUSTEXT, BATTERY_STATUS and others
        layout = LAYOUTS[number]
        body = encode_payload(message)
        body = body.rstrip(b"\0") or b"\0"  # the first byte is always kept (serialization, "payload truncation")
        sequence = self.take_sequence()
        covered = (
            pack_header_v2(
                MAGIC_V2, len(body), 0, 0, sequence, self.system, self.component, number & 0xFFFF, number >> 16
            )
            + body
        )
        return covered + checksum(covered[1:], layout.crc_extra).to_bytes(2, "little")


def alter(payload: bytes, /, **fields: object) -> bytes:
    """The MAVLink 2 frame of a message whose `fields` have other values, with its sender and sequence number.

    The frame is unsigned. Raises `DecodeError` for what is no MAVLink frame, and `ValueError` for a field that the
    message does not have, and for a value that does not fit.
    """
    message = decode_anew(payload)
    names = message.get_fieldnames()
    for name, value in fields.items():
        if name not in names:
            raise ValueError(f"{message.get_type()} has no field {name!r}, only {', '.join(names)}")
        setattr(message, name, value)
    packer = Packer(message.get_srcSystem(), message.get_srcComponent())
    packer.sequence = message.get_seq()
    return packer.pack(message)


def encode_payload(message: Message) -> bytes:
    """The whole payload of `message`, extensions and trailing zeros included; raises `ValueError` for a value that
    does not fit.
    """
    layout = LAYOUTS[type(message).id]
    values = layout.wire_values(message)
    if layout.array_fields:
        values = _flat(layout, values)
    elif len(layout.fields) == 1:
        values = (values,)
    try:
        return layout.pack(*values)
    except (struct.error, OverflowError, TypeError) as error:
        raise ValueError(f"{layout.cls.msgname} {message_fields(message)}: {error}") from error


def _flat(layout: Layout, values: Any) -> list[Any]:
    """Values in wire order with every array flattened to its defined length."""
    if len(layout.fields) == 1:
        values = (values,)
    flat: list[Any] = []
    for (name, start, stop, kind), value in zip(layout.array_fields, values, strict=True):
        if kind == "array":
            if len(value) < stop - start:
                raise ValueError(f"{layout.cls.msgname} {name}: {len(value)} values, expected {stop - start}")
            flat += value[: stop - start]
        else:
            flat.append(value)
    return flat


def message_fields(message: Message) -> dict[str, int | float | str]:
    """Field name → value, in the order of the definition; texts as `str`, an array as `name[0]`, `name[1]`, …."""
    row: dict[str, int | float | str] = {}
    for name, _, _, kind in LAYOUTS[type(message).id].fields:
        value = getattr(message, name)
        if kind == "array":
            for place, element in enumerate(value):
                row[f"{name}[{place}]"] = element
        else:
            row[name] = value
    return row


def message_id(payload: bytes) -> int | None:
    """The message id in the header, known or not; `None` if `payload` cannot be a MAVLink frame."""
    if len(payload) < MIN_FRAME:
        return None
    magic = payload[0]
    if magic == MAGIC_V2:
        return payload[7] | payload[8] << 8 | payload[9] << 16 if len(payload) >= HEADER_V2 + CHECKSUM else None
    return payload[5] if magic == MAGIC_V1 else None


def message_name(payload: bytes) -> str | None:
    """The message's name by its header; `None` for an id outside the dialect and for anything but MAVLink."""
    number = message_id(payload)
    layout = LAYOUTS.get(number) if number is not None else None
    return layout.cls.msgname if layout else None


def sender_system(payload: bytes) -> int | None:
    """The sender's system id as the header claims; `None` if `payload` cannot be a MAVLink frame."""
    if len(payload) < MIN_FRAME:
        return None
    magic = payload[0]
    if magic == MAGIC_V2:
        return payload[5] if len(payload) >= HEADER_V2 + CHECKSUM else None
    return payload[3] if magic == MAGIC_V1 else None
