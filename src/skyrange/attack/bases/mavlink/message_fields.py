"""Fields of whole MAVLink 2 frames: read as a record, written with a checksum that fits."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any, TypeAlias

import numpy as np

from skyrange.codec.mavlink.frames import CHECKSUM, HEADER_V2, LAYOUTS, MAGIC_V2, SIGNATURE, SIGNED, checksum
from skyrange.codec.mavlink.message_columns import payload_dtype
from skyrange.core.geodesy import Origin

Fields: TypeAlias = Any
"""The fields of a MAVLink message as a record: `fields["lat"]` is that field in the units of MAVLink; see `put`."""


def read_fields(payload: bytes, number: int) -> Fields | None:
    """The fields of a whole MAVLink 2 frame with a correct checksum, as a writable record; `None` for anything else."""
    layout = LAYOUTS.get(number)
    if layout is None or len(payload) < HEADER_V2 + CHECKSUM or payload[0] != MAGIC_V2 or payload[2] & ~SIGNED:
        return None
    end = HEADER_V2 + payload[1]
    if len(payload) != end + CHECKSUM + (SIGNATURE if payload[2] else 0):
        return None
    crc = payload[end : end + CHECKSUM] if end + CHECKSUM <= len(payload) else b""
    if int.from_bytes(crc, "little") != checksum(payload[1:end], layout.crc_extra):
        return None
    body = bytearray(payload[HEADER_V2:end][: layout.size].ljust(layout.size, b"\0"))
    return np.frombuffer(body, dtype=payload_dtype(number))[0]


def write_fields(payload: bytes, number: int, fields: Fields, length: int = 0) -> bytes:
    """The frame with other fields: trailing zeros cut, but not below `length` bytes; a signed one keeps its length.

    Sequence number and signature stay.
    """
    whole: bytes = fields.tobytes()
    size = payload[1] if payload[2] else max(len(whole.rstrip(b"\0")), length, 1)
    end = HEADER_V2 + payload[1]
    covered = bytes([size]) + payload[2:HEADER_V2] + whole[:size].ljust(size, b"\0")
    crc = checksum(covered, LAYOUTS[number].crc_extra).to_bytes(CHECKSUM, "little")
    return payload[:1] + covered + crc + payload[end + CHECKSUM :]


def write_alteration(payload: bytes, number: int, true: Fields, false: Fields, *, sham: bool) -> bytes:
    """The frame with its false fields; that of a sham with the true ones, and with as many bytes."""
    length = max(len(true.tobytes().rstrip(b"\0")), len(false.tobytes().rstrip(b"\0")))
    return write_fields(payload, number, true if sham else false, length)


def put(fields: Fields, name: str, value: float) -> None:
    """Set a field of a record; an integer is rounded and clipped to its range, and not set to NaN or infinity."""
    kind = fields.dtype[name]
    if kind.kind in "iu":
        if not isfinite(value):
            return
        limits = np.iinfo(kind)
        value = min(max(round(value), int(limits.min)), int(limits.max))
    fields[name] = value


def put_bits(fields: Fields, name: str, bits: int, *, value: bool) -> None:
    """Set some bits of a field, or clear them."""
    true = int(fields[name])
    put(fields, name, true | bits if value else true & ~bits)


def move_place(fields: Fields, lat: str, lon: str, by_m: Sequence[float], origin: Origin) -> None:
    """Move latitude and longitude, fields in 1e-7 degrees, by the first two of `by_m`: metres east and north."""
    east_m, north_m = origin.enu_of(fields[lat] * 1e-7, fields[lon] * 1e-7)
    lat_deg, lon_deg = origin.geodetic_of(east_m + by_m[0], north_m + by_m[1])
    put(fields, lat, lat_deg * 1e7)
    put(fields, lon, lon_deg * 1e7)
