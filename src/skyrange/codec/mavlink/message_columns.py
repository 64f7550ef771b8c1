"""Batch encoding and decoding of MAVLink 2: arrays of messages to columns of frames and back, and fleets' numbers.

Produces and reads the same bytes as `codec.mavlink` does one by one, from the same tables
(`codec.mavlink.frames.LAYOUTS`); tests compare the two. Only MAVLink 2 frames are decoded in batches, signed or
not (`codec.mavlink.signing` verifies signatures). All other payloads are left to the single decoder.

A fleet has one rolling sequence number per aircraft, shared by single and batch packing.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink.frames import (
    CHECKSUM,
    HEADER_V2,
    LAYOUTS,
    MAGIC_V1,
    MAGIC_V2,
    MIN_FRAME,
    SIGNATURE,
    SIGNED,
    Packer,
)
from skyrange.contracts.frames import Bytes, Ints, Payloads
from skyrange.core.compiled import compiled

MessageTable = Any
"""A structured array: one row per message, fields under pymavlink's names in the units of the wire format."""

_TYPES: Final = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4",
    "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8",
}  # fmt: skip
_MAGIC: Final = int(MAGIC_V2)
_MAGIC_V1: Final = int(MAGIC_V1)
_MIN_FRAME: Final = int(MIN_FRAME)
_HEADER: Final = int(HEADER_V2)
_CHECKSUM: Final = int(CHECKSUM)
_SIGNATURE: Final = int(SIGNATURE)
_SIGNED: Final = int(SIGNED)


def _crc_table() -> NDArray[np.uint16]:
    """CRC-16/MCRF4XX table for one byte: polynomial 0x1021 reflected, start 0xFFFF (mavlink.io, serialization)."""
    table = np.zeros(256, dtype=np.uint16)
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ (0x8408 if value & 1 else 0)
        table[byte] = value
    return table


_CRC: Final = _crc_table()
_IDS: Final = np.array(sorted(LAYOUTS), dtype=np.int64)
"""Every message id of the dialect; the index of an id in this array is its *kind*."""
_EXTRA: Final = np.array([LAYOUTS[number].crc_extra[0] for number in _IDS.tolist()], dtype=np.int64)
_KIND: Final = np.full(int(_IDS[-1]) + 1, -1, dtype=np.int32)
_KIND[_IDS] = np.arange(len(_IDS))


@cache
def payload_dtype(message_id: int) -> np.dtype[Any]:
    """The layout of a whole payload, extensions included; text is `S<n>`, arrays are subarrays."""
    cls = LAYOUTS[message_id].cls
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    fields: list[Any] = []
    for name, count in zip(cls.ordered_fieldnames, cls.array_lengths, strict=True):
        kind = kinds[name]
        if kind == "char":
            fields.append((name, f"S{max(count, 1)}"))
        else:
            fields.append((name, _TYPES[kind], (count,)) if count else (name, _TYPES[kind]))
    dtype = np.dtype(fields)
    assert dtype.itemsize == LAYOUTS[message_id].size, message_id
    return dtype


@compiled
def _pack(  # noqa: PLR0917
    raw: NDArray[np.uint8], number: int, extra: int, systems: Ints, component: int, sequences: Ints,
    out: Bytes, starts: Ints, sizes: Ints, at: int, crcs: NDArray[np.uint16],
) -> int:  # fmt: skip
    """Write one frame per row of `raw` to `out` from byte `at` on; returns the end of the last frame."""
    for row in range(raw.shape[0]):
        length = raw.shape[1]
        while length > 1 and raw[row, length - 1] == 0:  # MAVLink 2 cuts trailing zeros, but not the first byte
            length -= 1
        start = at
        out[at] = _MAGIC
        out[at + 1] = length
        out[at + 2] = 0
        out[at + 3] = 0
        out[at + 4] = sequences[row]
        out[at + 5] = systems[row]
        out[at + 6] = component
        out[at + 7] = number & 0xFF
        out[at + 8] = number >> 8 & 0xFF
        out[at + 9] = number >> 16 & 0xFF
        at += _HEADER
        for column in range(length):
            out[at + column] = raw[row, column]
        at += length
        crc = 0xFFFF
        for place in range(start + 1, at):
            crc = crc >> 8 ^ int(crcs[(crc ^ int(out[place])) & 0xFF])
        crc = crc >> 8 ^ int(crcs[(crc ^ extra) & 0xFF])
        out[at] = crc & 0xFF
        out[at + 1] = crc >> 8
        at += _CHECKSUM
        starts[row] = start
        sizes[row] = at - start
    return at


def pack_batches(batches: list[tuple[int, MessageTable, Ints, Ints]], component: int) -> Payloads:
    """Encode several batches of messages as frames, in their order.

    A batch is (message id, rows of `payload_dtype` that id, (n,) system ids, (n,) sequence numbers 0…255).
    """
    rows = sum(len(table) for _, table, _, _ in batches)
    room = sum(len(table) * (table.dtype.itemsize + _HEADER + _CHECKSUM) for _, table, _, _ in batches)
    data = np.empty(room, dtype=np.uint8)
    starts, sizes = np.empty(rows, dtype=np.int64), np.empty(rows, dtype=np.int64)
    at = done = 0
    for number, table, systems, sequences in batches:
        count = len(table)
        raw = table.view(np.uint8).reshape(count, table.dtype.itemsize)
        extra = LAYOUTS[number].crc_extra[0]
        part = slice(done, done + count)
        at = _pack(raw, number, extra, systems, component, sequences, data, starts[part], sizes[part], at, _CRC)
        done += count
    return Payloads(data[:at], starts, sizes)


@compiled
def kind_at(data: Bytes, at: int, size: int, kinds: NDArray[np.int32], extras: Ints, crcs: NDArray[np.uint16]) -> int:
    """The kind of the frame in `size` bytes from `at` on; the last three arguments are `KIND_TABLES`.

    -1 if the bytes are not exactly one valid MAVLink 2 frame.
    """
    if size < _HEADER + _CHECKSUM or data[at] != _MAGIC:
        return -1
    length = np.int64(data[at + 1])
    end = at + _HEADER + length
    flags = data[at + 2]
    if flags & ~_SIGNED or size != end - at + _CHECKSUM + (_SIGNATURE if flags else 0):
        return -1
    number = np.int64(data[at + 7]) | np.int64(data[at + 8]) << 8 | np.int64(data[at + 9]) << 16
    if number >= kinds.shape[0] or kinds[number] < 0:
        return -1
    kind = np.int64(kinds[number])
    crc = np.int64(0xFFFF)
    for place in range(at + 1, end):
        crc = crc >> 8 ^ np.int64(crcs[(crc ^ np.int64(data[place])) & 0xFF])
    crc = crc >> 8 ^ np.int64(crcs[(crc ^ extras[kind]) & 0xFF])
    if data[end] == crc & 0xFF and data[end + 1] == crc >> 8:
        return int(kind)
    return -1


KIND_TABLES: Final = (_KIND, _EXTRA, _CRC)
"""The lookup tables that `kind_at` takes after the frame."""


@compiled
def _classify(  # noqa: PLR0917
    data: Bytes, starts: Ints, sizes: Ints, kinds: NDArray[np.int32], extras: Ints, crcs: NDArray[np.uint16],
    out: Ints,
) -> None:  # fmt: skip
    """Write each frame's kind to `found`."""
    for row in range(starts.shape[0]):
        out[row] = kind_at(data, starts[row], sizes[row], kinds, extras, crcs)


@compiled
def _read_ids(data: Bytes, starts: Ints, sizes: Ints, out: Ints) -> None:
    for row in range(starts.shape[0]):
        at = starts[row]
        out[row] = -1
        if sizes[row] >= _MIN_FRAME:
            if data[at] == _MAGIC and sizes[row] >= _HEADER + _CHECKSUM:
                out[row] = np.int64(data[at + 7]) | np.int64(data[at + 8]) << 8 | np.int64(data[at + 9]) << 16
            elif data[at] == _MAGIC_V1:
                out[row] = data[at + 5]


def message_ids(payloads: Payloads) -> Ints:
    """(n,) the message ids in the headers, known or not; -1 for a payload that cannot be a MAVLink frame."""
    ids = np.empty(len(payloads), dtype=np.int64)
    _read_ids(*payloads.arrays, ids)
    return ids


@compiled
def _copy_payloads(data: Bytes, starts: Ints, rows: Ints, head: Ints, raw: NDArray[np.uint8]) -> None:
    """Copy the payloads of some frames, padded with zeros, and their (sequence, system, component)."""
    for place in range(rows.shape[0]):
        row = rows[place]
        at = starts[row]
        for column in range(3):
            head[place, column] = data[at + 4 + column]
        length = min(np.int64(data[at + 1]), raw.shape[1])
        at += _HEADER
        for column in range(length):
            raw[place, column] = data[at + column]
        for column in range(length, raw.shape[1]):
            raw[place, column] = 0


class MessageGroup(NamedTuple):
    """All frames of one message id in a column: their rows, their senders and their decoded values."""

    message_id: int
    rows: Ints
    sequences: Ints
    systems: Ints
    components: Ints
    values: MessageTable


class MessageColumn(NamedTuple):
    """One column of a message in tables: a scalar field, a text, or one element of an array."""

    name: str
    """The field's name, or `name[i]` for an element."""
    field: str
    element: int | None
    kind: str
    """ "int", "float" or "text"."""


@cache
def message_columns(message_id: int) -> tuple[MessageColumn, ...]:
    """The columns of a message, in the order of its fields."""
    cells: list[MessageColumn] = []
    dtype = payload_dtype(message_id)
    for name in LAYOUTS[message_id].cls.fieldnames:
        sub = dtype[name]
        kind = {"S": "text", "f": "float"}.get(sub.base.kind, "int")
        if sub.shape:
            cells += [MessageColumn(f"{name}[{place}]", name, place, kind) for place in range(sub.shape[0])]
        else:
            cells.append(MessageColumn(name, name, None, kind))
    return tuple(cells)


def classify_frames(payloads: Payloads) -> Ints:
    """(n,) the kind of each frame; -1 where only `codec.mavlink.decode` can decide whether it is a frame, and which.

    The column keeps it: the array is read, not altered.
    """
    if payloads.kinds is None:
        payloads.kinds = np.empty(len(payloads), dtype=np.int64)
        _classify(*payloads.arrays, *KIND_TABLES, payloads.kinds)
    return payloads.kinds


def kind_of_message(message_id: int) -> int:
    """The kind of a message id of the dialect."""
    return int(_KIND[message_id])


KIND_COUNT: Final = len(_IDS)


def message_id_of_kind(kind: int) -> int:
    """The message id of a kind."""
    return int(_IDS[kind])


def unpack_group(payloads: Payloads, kind: int, rows: Ints) -> MessageGroup:
    """Decode the messages in `rows`, all of one kind."""
    number = message_id_of_kind(kind)
    dtype = payload_dtype(number)
    raw = np.empty((len(rows), dtype.itemsize), dtype=np.uint8)
    head = np.empty((len(rows), 3), dtype=np.int64)
    _copy_payloads(*payloads.arrays[:2], rows, head, raw)
    return MessageGroup(number, rows, head[:, 0], head[:, 1], head[:, 2], raw.view(dtype).reshape(len(rows)))


class FleetPacker(Packer):
    """A `Packer` whose sequence number is one element of an array that the whole fleet shares."""

    __slots__ = ("_row", "sequences")

    sequences: Ints
    """(n,) the next sequence number of each aircraft."""

    def __init__(self, system: int, component: int, sequences: Ints, row: int) -> None:
        self.sequences = sequences
        self._row = row
        super().__init__(system, component)

    @property
    def sequence(self) -> int:
        """The sequence number of the next frame."""
        return int(self.sequences[self._row])

    @sequence.setter
    def sequence(self, value: int) -> None:
        self.sequences[self._row] = value


@compiled
def assign_sequence_numbers(rows: Ints, sequences: Ints, out: Ints) -> None:
    """Assign sequence numbers to frames in the order given: `rows` names the aircraft of each; advances `sequences`."""
    for place in range(rows.shape[0]):
        row = rows[place]
        out[place] = sequences[row]
        sequences[row] = (sequences[row] + 1) & 0xFF
