"""Batch decoding of whole broadcasts: every message of F3411 in columns, one row per body.

`codec.f3411.columns` decodes what receivers track, the Location and the first Basic ID. This module adds the rest, with
the same numbers as `codec.f3411.decode` gives one by one; a test compares the two.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411 import MAX_PACK_MESSAGES, SIZE, MessageType, values
from skyrange.codec.f3411.columns import Codes, Flags, Floats, LocationColumns, decode_locations
from skyrange.codec.f3411.encode import PACK_HEADER, PAGE_0_DATA
from skyrange.contracts.frames import Bytes, Ints, Payloads

Texts = NDArray[np.bytes_]
"""Text of a message without its trailing zeros, one character per byte (latin-1)."""

NO_MESSAGE: Final = 255
"""In `BroadcastColumns.kinds`: there is no message at this place of the body."""

_BASIC_ID: Final = np.dtype([("head", "u1"), ("types", "u1"), ("text", "S20"), ("reserved", "u1", (3,))])
_SELF_ID: Final = np.dtype([("head", "u1"), ("type", "u1"), ("text", "S23")])
_OPERATOR_ID: Final = np.dtype([("head", "u1"), ("type", "u1"), ("text", "S20"), ("reserved", "u1", (3,))])
_AUTH_0: Final = np.dtype(
    [("head", "u1"), ("types", "u1"), ("last_page", "u1"), ("length", "u1"), ("time", "<u4"), ("data", "u1", (17,))]
)
_SYSTEM: Final = np.dtype(
    [
        ("head", "u1"), ("flags", "u1"), ("lat", "<i4"), ("lon", "<i4"), ("count", "<u2"), ("radius", "u1"),
        ("ceiling", "<u2"), ("floor", "<u2"), ("kinds", "u1"), ("altitude", "<u2"), ("time", "<u4"), ("reserved", "u1"),
    ]
)  # fmt: skip
assert {_BASIC_ID.itemsize, _SELF_ID.itemsize, _OPERATOR_ID.itemsize, _AUTH_0.itemsize, _SYSTEM.itemsize} == {SIZE}


class BroadcastColumns(NamedTuple):
    """Many broadcasts, one row per body in their order; of several messages of a type the first counts.

    Where a message is absent, its `has_…` is false, floats are NaN, numbers 0 and texts b"". Fields are those of
    `f3411.Location`, `BasicId`, `Authentication`, `SelfId`, `System` and `OperatorId`.
    """

    location: LocationColumns
    """The Location and the first Basic ID; `location.valid` says whether `f3411.decode` would accept the body."""
    version: Codes
    """(n,) protocol version of the message, or of the pack."""
    kinds: Codes
    """(n, 9) the type of each message of the body (`MessageType` or a reserved number), or `NO_MESSAGE`."""
    has_second_id: Flags
    second_id_type: Ints
    second_uas_id: Texts
    has_authentication: Flags
    auth_type: Ints
    auth_page: Ints
    auth_last_page: Ints
    """As `auth_length` and `auth_timestamp_s`: on page 0 only, elsewhere 0."""
    auth_length: Ints
    auth_timestamp_s: Ints
    """Since 2019-01-01T00:00:00Z (`f3411.EPOCH_2019_S`)."""
    auth_data: list[bytes]
    """Data of all pages in the body, in the order in which the body has them."""
    has_self_id: Flags
    description_type: Ints
    self_id: Texts
    has_system: Flags
    operator_location_type: Ints
    operator_lat_deg: Floats
    operator_lon_deg: Floats
    operator_alt_geo_m: Floats
    area_count: Ints
    area_radius_m: Floats
    area_ceiling_m: Floats
    area_floor_m: Floats
    classification: Ints
    category: Ints
    ua_class: Ints
    system_timestamp_s: Ints
    """Since 2019-01-01T00:00:00Z (`f3411.EPOCH_2019_S`)."""
    has_operator_id: Flags
    operator_id_type: Ints
    operator_id: Texts


def decode_broadcasts(bodies: Payloads) -> BroadcastColumns:
    """Every message of each body, a message or a pack; a malformed body has none."""
    location = decode_locations(bodies)
    kinds, starts = _find_messages(bodies, location.valid)
    version = np.zeros(len(bodies), dtype=np.uint8)
    version[location.valid] = bodies.data[bodies.starts[location.valid]] & 15
    second = _gather(bodies.data, *_place_of(kinds, starts, MessageType.BASIC_ID, after=1), _BASIC_ID)
    auth = _gather(bodies.data, *_place_of(kinds, starts, MessageType.AUTHENTICATION), _AUTH_0)
    self_id = _gather(bodies.data, *_place_of(kinds, starts, MessageType.SELF_ID), _SELF_ID)
    system = _gather(bodies.data, *_place_of(kinds, starts, MessageType.SYSTEM), _SYSTEM)
    operator = _gather(bodies.data, *_place_of(kinds, starts, MessageType.OPERATOR_ID), _OPERATOR_ID)
    rows, flags, types = system.rows, system.rows["flags"], auth.rows["types"]
    first_page = types & 15 == 0
    unplaced = ~system.found | ((rows["lat"] == 0) & (rows["lon"] == 0))
    return BroadcastColumns(
        location=location,
        version=version,
        kinds=kinds,
        has_second_id=second.found,
        second_id_type=_bits(second.rows["types"], 4),
        second_uas_id=second.rows["text"],
        has_authentication=auth.found,
        auth_type=_bits(types, 4),
        auth_page=_bits(types, 0),
        auth_last_page=np.where(first_page, auth.rows["last_page"], 0).astype(np.int64),
        auth_length=np.where(first_page, auth.rows["length"], 0).astype(np.int64),
        auth_timestamp_s=np.where(first_page, auth.rows["time"], 0).astype(np.int64),
        auth_data=_join_pages(bodies.data, kinds, starts),
        has_self_id=self_id.found,
        description_type=_bits(self_id.rows["type"], 0, 255),
        self_id=self_id.rows["text"],
        has_system=system.found,
        operator_location_type=_bits(flags, 0, 3),
        operator_lat_deg=np.where(unplaced, np.nan, rows["lat"] / values.UNITS_PER_DEGREE),
        operator_lon_deg=np.where(unplaced, np.nan, rows["lon"] / values.UNITS_PER_DEGREE),
        operator_alt_geo_m=_altitude(rows["altitude"]),
        area_count=rows["count"].astype(np.int64),
        area_radius_m=np.where(system.found, rows["radius"] * float(values.RADIUS_STEP_M), np.nan),
        area_ceiling_m=_altitude(rows["ceiling"]),
        area_floor_m=_altitude(rows["floor"]),
        classification=_bits(flags, 2, 7),
        category=_bits(rows["kinds"], 4),
        ua_class=_bits(rows["kinds"], 0),
        system_timestamp_s=rows["time"].astype(np.int64),
        has_operator_id=operator.found,
        operator_id_type=_bits(operator.rows["type"], 0, 255),
        operator_id=operator.rows["text"],
    )


class _Found(NamedTuple):
    """One message of each body: whether it has one, and its bytes in the message's layout, zeros without one."""

    found: Flags
    rows: NDArray[Any]


def _find_messages(bodies: Payloads, valid: Flags) -> tuple[Codes, Ints]:
    """(n, 9) the types of each body's messages and where they begin in the buffer; none in a malformed body."""
    kinds = np.full((len(bodies), MAX_PACK_MESSAGES), NO_MESSAGE, dtype=np.uint8)
    starts = np.zeros((len(bodies), MAX_PACK_MESSAGES), dtype=np.int64)
    rows = np.flatnonzero(valid)
    if not len(rows):
        return kinds, starts
    begin = bodies.starts[rows]
    packed = bodies.data[begin] >> 4 == MessageType.MESSAGE_PACK
    count = np.ones(len(rows), dtype=np.int64)
    count[packed] = bodies.data[begin[packed] + PACK_HEADER - 1]
    begin = np.where(packed, begin + PACK_HEADER, begin)
    at = begin[:, None] + SIZE * np.arange(MAX_PACK_MESSAGES)
    present = np.arange(MAX_PACK_MESSAGES) < count[:, None]
    at = np.where(present, at, begin[:, None])
    starts[rows] = at
    kinds[rows] = np.where(present, bodies.data[at] >> 4, NO_MESSAGE)
    return kinds, starts


def _place_of(kinds: Codes, starts: Ints, kind: MessageType, after: int = 0) -> tuple[Flags, Ints]:
    """(n,) whether a body has a message of a type after the first `after` of them, and where it begins."""
    same = kinds == kind
    wanted = same & (np.cumsum(same, axis=1) == after + 1)
    place = wanted.argmax(axis=1)
    return wanted.any(axis=1), starts[np.arange(len(kinds)), place]


def _gather(data: Bytes, has_message: Flags, starts: Ints, layout: np.dtype[Any]) -> _Found:
    raw = np.zeros((len(has_message), SIZE), dtype=np.uint8)
    raw[has_message] = data[starts[has_message][:, None] + np.arange(SIZE)]
    return _Found(has_message, raw.view(layout)[:, 0])


def _join_pages(data: Bytes, kinds: Codes, starts: Ints) -> list[bytes]:
    pages: list[bytes] = [b""] * len(kinds)
    for row, place in np.argwhere(kinds == MessageType.AUTHENTICATION).tolist():
        at = int(starts[row, place])
        skipped = SIZE - PAGE_0_DATA if data[at + 1] & 15 == 0 else 2
        pages[row] += data[at + skipped : at + SIZE].tobytes()
    return pages


def _bits(raw: NDArray[np.uint8], shift: int, mask: int = 15) -> Ints:
    return raw.astype(np.int64) >> shift & mask


def _altitude(raw: NDArray[np.uint16]) -> Floats:
    return np.where(raw == 0, np.nan, raw * values.ALTITUDE_STEP_M + values.ALTITUDE_MIN_M)
