"""Payload format of the links `rid_up` and `rid_down`: a fixed header, then one F3411 body.

The header is 24 bytes, little-endian:

| bytes | field | meaning |
|---|---|---|
| 0 | magic | 0x1D |
| 1 | transport | `Transport` |
| 2 | channel | Wi-Fi channel number or BLE channel index 0…39; 0xFF lets the medium choose (`rid_up`) |
| 3 | counter | the advertiser's message counter (F3411) |
| 4–9 | address | MAC or advertiser address, as claimed |
| 10–11 | rssi | signal strength in 0.01 dBm, signed; −32768 is none (`rid_up`) |
| 12–13 | size | bytes of the body |
| 14–15 | reserved | 0 |
| 16–23 | time | ns of range time, signed: when the message was made (`rid_up`), or the reception's end (`rid_down`) |

The body is a message of 25 bytes or a message pack; `codec.f3411` decodes it. 802.11 and BLE framing are made at the
edge of the medium (`codec.remote_id.wifi`, `codec.remote_id.ble`).
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyrange.contracts.frames import Bytes, Ints, Payloads
from skyrange.core.compiled import compiled
from skyrange.core.errors import DecodeError

MAGIC: Final = 0x1D
HEADER: Final = 24
ANY_CHANNEL: Final = 0xFF
"""The medium chooses the channel."""
NO_RSSI: Final = -32768
"""No signal strength: the payload was not received over the air."""

_HEADER: Final = struct.Struct("<BBBB6shHHq")
_ROW: Final = np.dtype(
    [
        ("magic", "u1"), ("transport", "u1"), ("channel", "u1"), ("counter", "u1"), ("address", "u1", (6,)),
        ("rssi_cdbm", "<i2"), ("size", "<u2"), ("reserved", "<u2"), ("time_ns", "<i8"),
    ]
)  # fmt: skip
assert _ROW.itemsize == _HEADER.size == HEADER


class Transport(IntEnum):
    """The radio technology of a broadcast (F3411-22a, broadcast methods)."""

    BT4 = 1
    """Bluetooth 4 legacy advertising: one message per advertisement."""
    BT5 = 2
    """Bluetooth 5 Long Range extended advertising: a message pack."""
    WIFI_BEACON = 3
    WIFI_NAN = 4


_FIRST: Final = int(min(Transport))
_LAST: Final = int(max(Transport))


class RidHeader(NamedTuple):
    """The fields of the header, in the units of the format."""

    transport: int
    channel: int = ANY_CHANNEL
    counter: int = 0
    address: bytes = bytes(6)
    rssi_cdbm: int = NO_RSSI
    time_ns: int = 0


class RidFrame(NamedTuple):
    """One payload of `rid_up` or `rid_down`."""

    header: RidHeader
    body: bytes


def pack(header: RidHeader, body: bytes) -> bytes:
    """Encode one broadcast; raises `ValueError` if a field does not fit its bytes or the transport is unknown."""
    transport = Transport(header.transport)
    if len(header.address) != 6:
        raise ValueError(f"address of {len(header.address)} bytes, expected 6")
    try:
        head = _HEADER.pack(
            MAGIC, transport, header.channel, header.counter, header.address, header.rssi_cdbm, len(body), 0,
            header.time_ns,
        )  # fmt: skip
    except struct.error as error:
        raise ValueError(f"{header} with a body of {len(body)} bytes: {error}") from error
    return head + body


def unpack(payload: bytes) -> RidFrame:
    """Decode one broadcast, but not its body; raises `DecodeError` for anything that `pack` does not produce."""
    if len(payload) < HEADER:
        raise DecodeError(f"{len(payload)} bytes, a broadcast on rid_up or rid_down has at least {HEADER}")
    magic, transport, channel, counter, address, rssi_cdbm, size, _, time_ns = _HEADER.unpack_from(payload)
    if magic != MAGIC:
        raise DecodeError(f"first byte 0x{magic:02x}, expected 0x{MAGIC:02x}")
    if not _FIRST <= transport <= _LAST:
        raise DecodeError(f"transport {transport}, expected 1…4")
    if size != len(payload) - HEADER:
        raise DecodeError(f"a body of {len(payload) - HEADER} bytes, but the header announces {size}")
    return RidFrame(RidHeader(transport, channel, counter, address, rssi_cdbm, time_ns), payload[HEADER:])


class RidColumns(NamedTuple):
    """Many payloads of `rid_up` or `rid_down`: one row each, in their order, zeros where `valid` is false."""

    valid: NDArray[np.bool_]
    """(n,) whether `unpack` would accept the payload."""
    transport: NDArray[np.uint8]
    channel: NDArray[np.uint8]
    counter: NDArray[np.uint8]
    address: NDArray[np.uint8]
    """(n, 6)"""
    rssi_cdbm: NDArray[np.int16]
    time_ns: Ints
    bodies: Payloads
    """n bodies in the payloads' own buffer, empty where `valid` is false."""


@compiled
def _write_frames(heads: Bytes, data: Bytes, starts: Ints, sizes: Ints, out: Bytes, places: Ints) -> None:
    """Copy row i of `heads` (n*24 bytes) and then body i to `places[i]` of `out`."""
    for row in range(starts.shape[0]):
        at = places[row]
        for offset in range(24):
            out[at + offset] = heads[row * 24 + offset]
        at += 24
        for offset in range(sizes[row]):
            out[at + offset] = data[starts[row] + offset]


def pack_rows(
    *, transport: ArrayLike, channel: ArrayLike, counter: ArrayLike, address: ArrayLike, rssi_cdbm: ArrayLike,
    time_ns: ArrayLike, bodies: Payloads,
) -> Payloads:  # fmt: skip
    """`pack` for many bodies; each other argument is one value for all, or one per body ((n, 6)
    uint8 for `address`).
    """
    count = len(bodies)
    heads = np.zeros(count, dtype=_ROW)
    heads["magic"] = MAGIC
    heads["transport"] = transport
    heads["channel"] = channel
    heads["counter"] = counter
    heads["address"] = address
    heads["rssi_cdbm"] = rssi_cdbm
    heads["size"] = bodies.sizes
    heads["time_ns"] = time_ns
    sizes = bodies.sizes + HEADER
    places = np.cumsum(sizes) - sizes
    out = np.empty(int(sizes.sum()), dtype=np.uint8)
    _write_frames(heads.view(np.uint8), *bodies.arrays, out, places)
    return Payloads(out, places, sizes)


@compiled
def _read_headers(data: Bytes, starts: Ints, sizes: Ints, heads: Bytes, valid: NDArray[np.bool_], bodies: Ints) -> None:
    """Copy the headers that are good (n, 24), and write (2, n) the starts and sizes of the bodies."""
    for row in range(starts.shape[0]):
        at, size = starts[row], sizes[row]
        valid[row] = (
            size >= HEADER
            and data[at] == MAGIC
            and _FIRST <= data[at + 1] <= _LAST
            and np.int64(data[at + 12]) | np.int64(data[at + 13]) << 8 == size - HEADER
        )
        bodies[0, row], bodies[1, row] = (at + HEADER, size - HEADER) if valid[row] else (at, 0)
        for offset in range(HEADER):
            heads[row, offset] = data[at + offset] if valid[row] else 0


def unpack_rows(payloads: Payloads) -> RidColumns:
    """`unpack` for many payloads; a malformed one is marked in `valid` and does not affect the others."""
    count = len(payloads)
    heads, valid = np.empty((count, HEADER), dtype=np.uint8), np.empty(count, dtype=np.bool_)
    bodies = np.empty((2, count), dtype=np.int64)
    _read_headers(*payloads.arrays, heads, valid, bodies)
    rows: NDArray[Any] = heads.view(_ROW)[:, 0]
    return RidColumns(
        valid, rows["transport"], rows["channel"], rows["counter"], rows["address"], rows["rssi_cdbm"],
        rows["time_ns"], Payloads(payloads.arrays[0], bodies[0], bodies[1]),
    )  # fmt: skip
