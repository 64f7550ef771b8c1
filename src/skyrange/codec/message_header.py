"""Header of the messages between skyrange and a simulator that is another program."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final, TypeVar

from skyrange.core.errors import DecodeError

HEADER: Final = struct.Struct("<IHHI")
"""Length of the body in bytes, type, zero, number of the request."""

_Kind = TypeVar("_Kind", bound=IntEnum)


def pack(kind: IntEnum, number: int, body: bytes = b"") -> bytes:
    """A whole message; of `number` the lower 32 bits."""
    return HEADER.pack(len(body), kind, 0, number & 0xFFFF_FFFF) + body


def unpack(header: bytes, kinds: type[_Kind], max_body_bytes: int) -> tuple[int, _Kind, int]:
    """Length of the body, type and number of a message whose 12 first bytes are `header`. Raises `DecodeError`."""
    length, kind, zero, number = HEADER.unpack(header)
    if length > max_body_bytes or zero:
        raise DecodeError(f"a header of {header.hex()}, which is none of this protocol")
    try:
        return length, kinds(kind), number
    except ValueError:
        raise DecodeError(f"a message of the unknown type {kind}") from None
