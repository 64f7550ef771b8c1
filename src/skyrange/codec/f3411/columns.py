"""Batch encoding and decoding of F3411 messages: columns of Location and Basic ID, and packs of them.

Produces the same bytes and numbers as `codec.f3411` does one by one; tests compare the two. Unknown values are NaN.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411 import MAX_PACK_MESSAGES, PROTOCOL_VERSION, SIZE, MessageType, values
from skyrange.codec.f3411.encode import PACK_HEADER
from skyrange.contracts.frames import Bytes, Ints, Payloads
from skyrange.core.compiled import compiled

Floats = NDArray[np.float64]
Codes = NDArray[np.uint8]
Flags = NDArray[np.bool_]
Bodies = NDArray[np.uint8]
"""(n, 25): one message per row."""

NUMBERS: Final = (
    "lat_deg", "lon_deg", "alt_geo_m", "alt_baro_m", "height_m", "speed_mps", "vertical_mps", "track_deg",
    "timestamp_s",
)  # fmt: skip
"""The fields of a Location that are floats, in the order of their rows."""
CODES: Final = (
    "status", "height_type", "horizontal_accuracy", "vertical_accuracy", "baro_accuracy", "speed_accuracy",
    "timestamp_accuracy",
)  # fmt: skip
"""The fields of a Location that are codes."""
_LOCATION: Final = int(MessageType.LOCATION)
_BASIC_ID: Final = int(MessageType.BASIC_ID)
_PACK: Final = int(MessageType.MESSAGE_PACK)
_SPEED_UNKNOWN: Final = values.SPEED_UNKNOWN[0]
_TRACK_UNKNOWN: Final = values.TRACK_UNKNOWN[0]


class LocationColumns(NamedTuple):
    """The Location and the Basic ID of many broadcasts: one row per body, in their order, fields as in
    `f3411.Location`.
    """

    valid: Flags
    """(n,) whether `f3411.decode` would accept the body."""
    has_location: Flags
    """(n,) whether the body holds a Location; where it does not, floats are NaN and codes 0."""
    lat_deg: Floats
    lon_deg: Floats
    alt_geo_m: Floats
    """Above the WGS 84 ellipsoid."""
    alt_baro_m: Floats
    height_m: Floats
    speed_mps: Floats
    vertical_mps: Floats
    track_deg: Floats
    timestamp_s: Floats
    """Since the full hour."""
    status: Codes
    height_type: Codes
    horizontal_accuracy: Codes
    vertical_accuracy: Codes
    baro_accuracy: Codes
    speed_accuracy: Codes
    timestamp_accuracy: Codes
    has_id: Flags
    """(n,) whether the body holds a Basic ID."""
    id_type: Codes
    ua_type: Codes
    uas_id: NDArray[np.bytes_]
    """(n,) S20, from the first Basic ID; b"" if there is none."""


@compiled
def _find_messages(data: Bytes, starts: Ints, sizes: Ints, valid: Flags, located: Ints, named: Ints) -> None:
    """Write where each body's first Location and first Basic ID begin in `data`; -1 if it has none or is malformed."""
    for row in range(starts.shape[0]):
        start, size = starts[row], sizes[row]
        valid[row], located[row], named[row] = False, -1, -1
        first, count = int(start), 0
        if size == SIZE and data[start] >> 4 != _PACK:
            count = 1
        elif size >= PACK_HEADER + SIZE and data[start] >> 4 == _PACK and data[start + 1] == SIZE:
            message_count = int(data[start + 2])
            if message_count <= MAX_PACK_MESSAGES and size == PACK_HEADER + SIZE * message_count:
                first, count = start + PACK_HEADER, message_count
        valid[row] = count > 0
        for place in range(count - 1, -1, -1):  # backwards, so that the first one is kept
            at = first + SIZE * place
            kind = data[at] >> 4
            if kind == _LOCATION:
                located[row] = at
            elif kind == _BASIC_ID:
                named[row] = at


@compiled
def _word(data: Bytes, at: int, size: int) -> int:
    """An unsigned little-endian integer."""
    word = 0
    for place in range(size):
        word |= int(data[at + place]) << (8 * place)
    return word


@compiled
def _altitude(raw: int) -> float:
    return raw * values.ALTITUDE_STEP_M + values.ALTITUDE_MIN_M if raw != 0 else math.nan


@compiled
def _read_values(data: Bytes, located: Ints, named: Ints, numbers: Floats, codes: Codes, names: Bytes) -> None:
    """Fill `numbers`, `codes` (rows in the order of `NUMBERS` and `CODES`, then both types of the Basic ID) and
    `names`.
    """
    for row in range(located.shape[0]):
        numbers[:, row] = math.nan
        codes[:, row] = 0
        at = located[row]
        if at >= 0:
            flags, speed = data[at + 1], np.int64(data[at + 3])
            fast, west = (flags & 1) == 1, (flags >> 1 & 1) == 1
            lat, lon = _word(data, at + 5, 4), _word(data, at + 9, 4)
            if lat != 0 or lon != 0:
                numbers[0, row] = (lat - (lat >> 31 << 32)) / values.UNITS_PER_DEGREE
                numbers[1, row] = (lon - (lon >> 31 << 32)) / values.UNITS_PER_DEGREE
            numbers[2, row] = _altitude(_word(data, at + 15, 2))
            numbers[3, row] = _altitude(_word(data, at + 13, 2))
            numbers[4, row] = _altitude(_word(data, at + 17, 2))
            if not fast:
                numbers[5, row] = speed * values.SPEED_STEP_MPS
            elif speed != _SPEED_UNKNOWN:
                numbers[5, row] = speed * values.SPEED_FAST_STEP_MPS + values.SPEED_KNEE_MPS
            climb = np.int64(data[at + 4])
            if climb != values.VERTICAL_UNKNOWN:
                numbers[6, row] = (climb - (climb >> 7 << 8)) * values.VERTICAL_STEP_MPS
            track = np.int64(data[at + 2])
            if not (west and track == _TRACK_UNKNOWN):
                degrees = track + (180 if west else 0)
                numbers[7, row] = degrees if degrees != 360 else 0
            time = _word(data, at + 21, 2)
            if time != values.TIME_UNKNOWN:
                numbers[8, row] = time / values.TIME_STEPS_PER_S
            codes[0, row], codes[1, row] = flags >> 4, flags >> 2 & 1
            codes[2, row], codes[3, row] = data[at + 19] & 15, data[at + 19] >> 4
            codes[4, row], codes[5, row] = data[at + 20] >> 4, data[at + 20] & 15
            codes[6, row] = data[at + 23] & 15
        at = named[row]
        for place in range(20):
            names[row, place] = data[at + 2 + place] if at >= 0 else 0
        if at >= 0:
            codes[7, row], codes[8, row] = data[at + 1] >> 4, data[at + 1] & 15


def decode_locations(bodies: Payloads) -> LocationColumns:
    """The Location and the first Basic ID of each body, a message or a pack; a malformed body has neither."""
    count = len(bodies)
    valid = np.empty(count, dtype=np.bool_)
    located, named = np.empty((2, count), dtype=np.int64)
    _find_messages(*bodies.arrays, valid, located, named)
    numbers, codes = np.empty((9, count)), np.empty((9, count), dtype=np.uint8)
    names = np.empty((count, 20), dtype=np.uint8)
    _read_values(bodies.arrays[0], located, named, numbers, codes, names)
    texts = names.view("S20")[:, 0]
    return LocationColumns._make((valid, located >= 0, *numbers, *codes[:7], named >= 0, *codes[7:], texts))


@compiled
def _steps(metres: float) -> int:
    """The 16 bits of an altitude: saturating, 0 for unknown."""
    if math.isnan(metres):
        return 0
    least, most = values.ALTITUDE_MIN_M + values.ALTITUDE_STEP_M, values.ALTITUDE_MAX_M
    clamped_m: float = min(max(metres, least), most) - values.ALTITUDE_MIN_M
    return int(np.rint(clamped_m / values.ALTITUDE_STEP_M))


@compiled
def _put_int(out: Bodies, row: int, at: int, size: int, number: int) -> None:
    for place in range(size):
        out[row, at + place] = number >> (8 * place) & 0xFF


@compiled
def _write_locations(numbers: Floats, codes: Codes, out: Bodies) -> int:
    """Fill the messages; returns the index of a column (first `numbers`, then `codes`) that cannot
    be encoded, or -1.
    """
    for row in range(numbers.shape[1]):
        for column in range(codes.shape[0]):
            if codes[column, row] > (1 if column == 1 else 15):
                return len(NUMBERS) + column
        lat, lon, speed, climb = numbers[0, row], numbers[1, row], numbers[5, row], numbers[6, row]
        track, time = numbers[7, row], numbers[8, row]
        out[row] = 0
        out[row, 0] = _LOCATION << 4 | PROTOCOL_VERSION
        if not math.isnan(lat) or not math.isnan(lon):
            lat, lon = np.rint(lat * values.UNITS_PER_DEGREE), np.rint(lon * values.UNITS_PER_DEGREE)
            if not -(2.0**31) <= lat < 2.0**31:
                return 0
            if not -(2.0**31) <= lon < 2.0**31:
                return 1
            _put_int(out, row, 5, 4, int(lat))
            _put_int(out, row, 9, 4, int(lon))
        _put_int(out, row, 13, 2, _steps(numbers[3, row]))
        _put_int(out, row, 15, 2, _steps(numbers[2, row]))
        _put_int(out, row, 17, 2, _steps(numbers[4, row]))
        if speed < 0.0:
            return 5
        fast = not speed <= values.SPEED_SLOW_MPS  # unknown counts as fast: 255 with the multiplier
        if not fast:
            out[row, 3] = min(int(np.rint(speed / values.SPEED_STEP_MPS)), 255)
        elif math.isnan(speed):
            out[row, 3] = _SPEED_UNKNOWN
        else:
            clamped = min(speed, values.SPEED_MAX_MPS) - values.SPEED_KNEE_MPS
            out[row, 3] = int(np.rint(clamped / values.SPEED_FAST_STEP_MPS))
        steps = values.VERTICAL_UNKNOWN
        if not math.isnan(climb):
            clamped = min(max(climb, -values.VERTICAL_MAX_MPS), values.VERTICAL_MAX_MPS)
            steps = int(np.rint(clamped / values.VERTICAL_STEP_MPS))
        out[row, 4] = steps & 0xFF
        if track < 0.0 or track > 360.0:
            return 7
        degrees = 361 if math.isnan(track) else int(np.rint(track)) % 360
        west = degrees >= 180
        out[row, 2] = degrees - 180 if west else degrees
        tenths = values.TIME_UNKNOWN
        if not math.isnan(time):
            rounded = np.rint(time * values.TIME_STEPS_PER_S)
            if not 0.0 <= rounded < values.TIME_UNKNOWN:
                return 8
            tenths = int(rounded)
        _put_int(out, row, 21, 2, tenths)
        out[row, 1] = codes[0, row] << 4 | codes[1, row] << 2 | (2 if west else 0) | (1 if fast else 0)
        out[row, 19] = codes[3, row] << 4 | codes[2, row]
        out[row, 20] = codes[4, row] << 4 | codes[5, row]
        out[row, 23] = codes[6, row]
    return -1


def encode_locations(numbers: Floats, codes: Codes) -> Bodies:
    """(n, 25) Location messages from (9, n) numbers and (7, n) codes, in the order of `NUMBERS` and `CODES`.

    NaN is unknown. Speeds and altitudes saturate as in `f3411.encode`. Raises `ValueError` for a position, track, time
    or code that cannot be encoded.
    """
    out = np.empty((numbers.shape[1], SIZE), dtype=np.uint8)
    wrong = _write_locations(numbers, codes, out)
    if wrong >= 0:
        raise ValueError(f"{(*NUMBERS, *CODES)[wrong]}: a value that a Location cannot encode")
    return out


def stack_messages(bodies: Sequence[bytes]) -> Bodies:
    """(n, 25) rows from messages encoded one by one (`f3411.encode`); raises `ValueError` for other lengths."""
    if any(len(body) != SIZE for body in bodies):
        raise ValueError(f"a message of another length, expected {SIZE} bytes each")
    return np.frombuffer(b"".join(bodies), dtype=np.uint8).reshape(len(bodies), SIZE)


def single_bodies(part: Bodies) -> Payloads:
    """Bodies of one message each, as Bluetooth 4 carries them."""
    starts = np.arange(len(part), dtype=np.int64) * SIZE
    return Payloads(np.ascontiguousarray(part).reshape(-1), starts, np.full(len(part), SIZE, dtype=np.int64))


def pack_bodies(parts: Sequence[Bodies]) -> Payloads:
    """Message packs: pack i holds row i of every part, in the order of the parts (1…9, else `ValueError`)."""
    if not 1 <= len(parts) <= MAX_PACK_MESSAGES:
        raise ValueError(f"{len(parts)} messages in a pack, expected 1…{MAX_PACK_MESSAGES}")
    count, size = len(parts[0]), PACK_HEADER + SIZE * len(parts)
    out = np.empty((count, size), dtype=np.uint8)
    out[:, 0] = MessageType.MESSAGE_PACK << 4 | PROTOCOL_VERSION
    out[:, 1] = SIZE
    out[:, 2] = len(parts)
    for place, part in enumerate(parts):
        out[:, PACK_HEADER + SIZE * place : PACK_HEADER + SIZE * (place + 1)] = part
    return Payloads(out.reshape(-1), np.arange(count, dtype=np.int64) * size, np.full(count, size, dtype=np.int64))
