"""The packed parameters of @PARAM/param.pck, as they are downloaded and uploaded.

After libraries/AP_Filesystem/AP_Filesystem_Param.cpp of ArduPilot 4.6 (`pack_param`, `param_upload_parse`): a header,
then for each parameter its type and flags, how many characters of its name are those of the one before, the other
characters, and the value, which is little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from skyrange.codec.mavlink import dialect
from skyrange.core.errors import DecodeError

PATH: Final = "@PARAM/param.pck"
MAX_UPLOAD_BYTES: Final = 0xFFFF
"""The header of an upload has its length in 16 bits."""
MAX_NAME: Final = 16
"""Characters of a name (AP_MAX_NAME_SIZE)."""
TYPES: Final = {
    dialect.MAV_PARAM_TYPE_INT8: 1,
    dialect.MAV_PARAM_TYPE_INT16: 2,
    dialect.MAV_PARAM_TYPE_INT32: 3,
    dialect.MAV_PARAM_TYPE_REAL32: 4,
}
"""AP_Param's `ap_var_type` by MAV_PARAM_TYPE."""
_FLOAT: Final = 4
_MAGIC, _MAGIC_WITH_DEFAULTS = 0x671B, 0x671C
_HEADER: Final = struct.Struct("<HHH")
"""Magic, number of parameters in the file, number of parameters; in an upload the last is the length of the file."""
_LAYOUTS: Final = {1: struct.Struct("<b"), 2: struct.Struct("<h"), 3: struct.Struct("<i"), 4: struct.Struct("<f")}
_ENTRY_HEAD: Final = 2
"""Bytes before the name."""
_MAX_COMMON: Final = 15


class PackedParameter(NamedTuple):
    """A parameter with its value, and with its default where that is packed too; `kind` is a MAV_PARAM_TYPE."""

    name: str
    value: float
    kind: int
    default: float | None = None


def pack_download(
    parameters: Sequence[PackedParameter], total: int, read_bytes: int, *, defaults: bool = False
) -> bytes:
    """The file as it is read in pieces of `read_bytes`: zeros keep a value from the boundary of two pieces.

    `total` is the number of all parameters. With `defaults`, a default that differs from its value is packed too.
    """
    out = bytearray(_HEADER.pack(_MAGIC_WITH_DEFAULTS if defaults else _MAGIC, len(parameters), total))
    last = ""
    for name, value, mavlink_type, default in parameters:
        kind = TYPES[mavlink_type]
        size = _LAYOUTS[kind].size
        numbers = [value] if default is None or not defaults or value == default else [value, default]
        head = _pack_head(kind, len(numbers) - 1, last, name)
        if size > 1:
            over = (len(out) + len(head) + size * len(numbers)) % read_bytes
            if 0 < over < size:
                out += bytes(size - over)
        out += head
        for number in numbers:
            out += _LAYOUTS[kind].pack(number if kind == _FLOAT else int(number))
        last = name
    return bytes(out)


def pack_upload(values: Mapping[str, float]) -> bytes:
    """A file that sets these parameters, as single-precision numbers; the autopilot converts them to its types."""
    body, last = bytearray(), ""
    for name, value in values.items():
        body += _pack_head(_FLOAT, 0, last, name) + _LAYOUTS[_FLOAT].pack(value)
        last = name
    return _HEADER.pack(_MAGIC, len(values), _HEADER.size + len(body)) + bytes(body)


def stated_length(data: bytes) -> int:
    """The length of an upload by its header, 0 where the data have none."""
    if len(data) < _HEADER.size:
        return 0
    magic, _, length = _HEADER.unpack_from(data)
    return int(length) if magic == _MAGIC else 0


def read_download(data: bytes) -> list[tuple[str, float]]:
    """Names and values of a file that was downloaded, and of the beginning of one as far as it goes.

    Raises `DecodeError` for what is not such a file.
    """
    magic, count, _ = _read_header(data)
    if magic not in (_MAGIC, _MAGIC_WITH_DEFAULTS):
        raise DecodeError(f"packed parameters: magic {magic:#06x}, expected {_MAGIC:#06x}")
    at, last = _HEADER.size, b""
    parameters: list[tuple[str, float]] = []
    while len(parameters) < count:
        while at < len(data) and data[at] == 0:
            at += 1
        if len(data) - at < _ENTRY_HEAD:
            break
        layout, flags, common, size = _read_entry_head(data, at)
        if layout is None or common > len(last):
            raise DecodeError(f"packed parameters: entry {len(parameters)} is malformed")
        values = at + _ENTRY_HEAD + size
        at = values + layout.size * (1 + (flags & 1))
        if at > len(data):
            break
        last = last[:common] + data[values - size : values]
        parameters.append((last.decode("ascii", "replace"), float(layout.unpack_from(data, values)[0])))
    return parameters


def read_upload(data: bytes) -> Iterator[tuple[str, float]]:
    """Names and values of a file that was uploaded, in order.

    Raises `DecodeError` at what is malformed, after what precedes it.
    """
    magic, count, length = _read_header(data)
    if magic != _MAGIC or length != len(data):
        raise DecodeError(f"packed parameters: magic {magic:#06x} and length {length} of {len(data)} bytes")
    at, last = _HEADER.size, b""
    for number in range(count):
        if len(data) - at < _ENTRY_HEAD:
            raise DecodeError(f"packed parameters: entry {number} of {count} is missing")
        layout, flags, common, size = _read_entry_head(data, at)
        if layout is None or flags or common > len(last) or common + size > MAX_NAME:
            raise DecodeError(f"packed parameters: entry {number} is malformed")
        values = at + _ENTRY_HEAD + size
        at = values + layout.size
        if at > len(data):
            raise DecodeError(f"packed parameters: entry {number} is cut")
        last = (last[:common] + data[values - size : values]).split(b"\0", 1)[0]
        yield last.decode("ascii", "replace"), float(layout.unpack_from(data, values)[0])


def _read_header(data: bytes) -> tuple[int, int, int]:
    """Magic, number of parameters, and the third number of the file's header. Raises `DecodeError`."""
    if len(data) < _HEADER.size:
        raise DecodeError(f"packed parameters: {len(data)} bytes, expected a header of {_HEADER.size}")
    magic, count, third = _HEADER.unpack_from(data)
    return magic, count, third


def _read_entry_head(data: bytes, at: int) -> tuple[struct.Struct | None, int, int, int]:
    """Layout of the value (`None` for an unknown type), flags, characters shared with the last name, further ones."""
    kind, name = data[at], data[at + 1]
    return _LAYOUTS.get(kind & 15), kind >> 4, name & 15, (name >> 4) + 1


def _pack_head(kind: int, flags: int, last: str, name: str) -> bytes:
    """What precedes a value. At least one character of a name is packed."""
    most = min(len(last), len(name) - 1, _MAX_COMMON)
    common = next((place for place in range(most) if last[place] != name[place]), most)
    rest = name[common:].encode()
    return bytes((kind | flags << 4, common | (len(rest) - 1) << 4)) + rest
