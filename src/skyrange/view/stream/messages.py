"""Messages of the viewer's stream, and files of them: encoder and decoder."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import DecodeError

VERSION: Final = 1
"""The version of the stream, in its scene."""
MAGIC: Final = b"SKYVIEW1"
SCENE: Final = "S"
POSITIONS: Final = "P"
EVENTS: Final = "E"
MEDIA_TYPE: Final = "application/vnd.skyrange.view"

MAX_BODY_BYTES: Final = 1 << 28
"""A body that would be larger uncompressed is refused."""
_TYPES: Final = {"i8": "<i1", "u8": "<u1", "i16": "<i2", "i32": "<i4", "f32": "<f4"}
_NAMES: Final = {np.dtype(code): name for name, code in _TYPES.items()}
_LENGTH: Final = struct.Struct("<I")

Head = dict[str, Any]
Array = NDArray[Any]


@dataclass(frozen=True)
class Message:
    """One message: its kind, the head and the arrays of its record."""

    kind: str
    head: Head
    arrays: Mapping[str, Array] = field(default_factory=dict)

    def encode(self) -> bytes:
        """The message as bytes; the arrays have types of the stream."""
        listed = [[name, _NAMES[array.dtype], array.size] for name, array in self.arrays.items()]
        head = json.dumps(self.head | {"arrays": listed}, separators=(",", ":"), allow_nan=False).encode()
        parts = [_fill(_LENGTH.pack(len(head)) + head), *(_fill(array.tobytes()) for array in self.arrays.values())]
        return self.kind.encode() + zlib.compress(b"".join(parts), 6)


def decode_message(data: bytes) -> Message:
    """Read one message; raises `DecodeError` for anything else."""
    try:
        inflater = zlib.decompressobj()
        body = inflater.decompress(data[1:], MAX_BODY_BYTES)
        if not inflater.eof:
            raise DecodeError("viewer stream: a body that ends early, or is too long")
        end = _LENGTH.size + _LENGTH.unpack_from(body)[0]
        head = json.loads(body[_LENGTH.size : end])
        arrays = {}
        for name, kind, count in head.pop("arrays"):
            start = _filled(end)
            arrays[str(name)] = np.frombuffer(body, _TYPES[kind], int(count), start)
            end = start + arrays[name].nbytes
    except (zlib.error, struct.error, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DecodeError(f"viewer stream: not a message: {error}") from None
    return Message(chr(data[0]), head, arrays)


@dataclass(frozen=True)
class Part:
    """Messages of one span of time, in seconds."""

    from_s: float
    until_s: float
    messages: Sequence[Message]


def encode_file(scene: Message, parts: Sequence[Part]) -> bytes:
    """A file of the stream; `parts` of the scene's head is filled in."""
    blobs = [b"".join(_with_length(message.encode()) for message in part.messages) for part in parts]
    offsets = np.cumsum([0, *(len(blob) for blob in blobs)]).tolist()
    listed = [
        [offset, len(blob), part.from_s, part.until_s]
        for offset, blob, part in zip(offsets, blobs, parts, strict=False)
    ]
    head = Message(scene.kind, scene.head | {"parts": listed}, scene.arrays)
    return b"".join([MAGIC, _with_length(head.encode()), *blobs])


def decode_file(data: bytes) -> Iterator[Message]:
    """The messages of a file, the scene first; raises `DecodeError` for another file and one that was cut short."""
    return map(decode_message, split_file(data))


def split_file(data: bytes) -> Iterator[bytes]:
    """The messages of a file as bytes; raises as `decode_file`."""
    if not data.startswith(MAGIC):
        raise DecodeError(f"viewer stream: a file does not begin with {MAGIC.decode()}")
    at = len(MAGIC)
    if at == len(data):
        raise DecodeError("viewer stream: a file without a scene")
    while at < len(data):
        if at + _LENGTH.size > len(data):
            raise DecodeError("viewer stream: a file that ends early")
        (length,) = _LENGTH.unpack_from(data, at)
        at += _LENGTH.size
        if not 0 < length <= len(data) - at:
            raise DecodeError("viewer stream: a file that ends early")
        yield data[at : at + length]
        at += length


def _with_length(message: bytes) -> bytes:
    return _LENGTH.pack(len(message)) + message


def _filled(size: int) -> int:
    """The next multiple of 4."""
    return -(-size // 4) * 4


def _fill(data: bytes) -> bytes:
    return data.ljust(_filled(len(data)), b"\0")
