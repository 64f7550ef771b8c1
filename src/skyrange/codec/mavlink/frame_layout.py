"""MAVLink frame layout: header, payload table and checksum of both protocol versions.

Sources: https://mavlink.io/en/guide/serialization.html (frame, payload truncation, CRC with extra) and
https://mavlink.io/en/guide/message_signing.html (13-byte signature). The payload tables are pymavlink's own, of its
ardupilotmega dialect, so that field offsets are not stated a second time.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from operator import attrgetter
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import ardupilotmega as dialect

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
