"""How are many Remote ID broadcasts read and written at once? Columns of Location and Basic ID, and packs of them.

The same bytes and numbers as `codec.f3411`, one by one; tests hold the two against each other. Unknown is NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyrange.agent.payloads import Ints, Payloads
from skyrange.codec.f3411 import PACK_MOST, PROTOCOL_VERSION, SIZE, MessageType, values
from skyrange.codec.f3411.encode import PACK_HEADER

Floats = NDArray[np.float64]
Codes = NDArray[np.uint8]
Bodies = NDArray[np.uint8]
"""(n, 25): one message per row."""

_LOCATION: Final = np.dtype(
    [
        ("kind", "u1"), ("flags", "u1"), ("track", "u1"), ("speed", "u1"), ("vertical", "i1"), ("lat", "<i4"),
        ("lon", "<i4"), ("baro", "<u2"), ("geo", "<u2"), ("height", "<u2"), ("place_accuracy", "u1"),
        ("other_accuracy", "u1"), ("time", "<u2"), ("time_accuracy", "u1"), ("last", "u1"),
    ]
)  # fmt: skip
assert _LOCATION.itemsize == SIZE


class LocationColumns(NamedTuple):
    """What many broadcasts say of where and who: one row per body, in their order, fields as in `f3411.Location`."""

    found: NDArray[np.bool_]
    """(n,) whether there is a Location in the body; where not, floats are NaN and codes 0."""
    status: Codes
    lat_deg: Floats
    lon_deg: Floats
    alt_geo_m: Floats
    """Above the WGS 84 ellipsoid."""
    alt_baro_m: Floats
    height_m: Floats
    height_type: Codes
    speed_mps: Floats
    vertical_mps: Floats
    track_deg: Floats
    horizontal_accuracy: Codes
    vertical_accuracy: Codes
    baro_accuracy: Codes
    speed_accuracy: Codes
    timestamp_accuracy: Codes
    timestamp_s: Floats
    """Since the full hour."""
    has_id: NDArray[np.bool_]
    """(n,) whether there is a Basic ID in the body."""
    id_type: Codes
    ua_type: Codes
    uas_id: NDArray[np.bytes_]
    """(n,) S20, the first Basic ID's; b"" where there is none."""


def places_of(bodies: Payloads, message_type: int) -> Ints:
    """(n,) where in `bodies.data` each body's first message of a type begins; -1 where it holds none.

    A body that `f3411.decode` refuses holds none.
    """
    data, starts, sizes = bodies.data, bodies.starts, bodies.sizes
    found = np.full(len(bodies), -1, dtype=np.int64)
    lone = np.flatnonzero(sizes == SIZE)
    lone = lone[data[starts[lone]] >> 4 == message_type]
    if message_type != MessageType.MESSAGE_PACK:
        found[lone] = starts[lone]
    packs, at, counts = _packs(bodies)
    for place in range(int(counts.max(initial=0)) - 1, -1, -1):  # backwards, so that the first one stays
        inside = counts > place
        here = at[inside] + SIZE * place
        right = data[here] >> 4 == message_type
        found[packs[inside][right]] = here[right]
    return found


def _packs(bodies: Payloads) -> tuple[Ints, Ints, Ints]:
    """Which bodies are whole packs, where each one's first message begins in `bodies.data`, and how many it has."""
    data, starts, sizes = bodies.data, bodies.starts, bodies.sizes
    packs = np.flatnonzero(sizes >= PACK_HEADER + SIZE)
    at = starts[packs]
    counts = data[at + 2].astype(np.int64)
    whole = (data[at] >> 4 == MessageType.MESSAGE_PACK) & (data[at + 1] == SIZE) & (counts <= PACK_MOST)
    whole &= sizes[packs] == PACK_HEADER + SIZE * counts
    return packs[whole], at[whole] + PACK_HEADER, counts[whole]


def whole_rows(bodies: Payloads) -> NDArray[np.bool_]:
    """(n,) whether `f3411.decode` would accept the body."""
    whole = np.zeros(len(bodies), dtype=np.bool_)
    lone = np.flatnonzero(bodies.sizes == SIZE)
    whole[lone] = bodies.data[bodies.starts[lone]] >> 4 != MessageType.MESSAGE_PACK
    whole[_packs(bodies)[0]] = True
    return whole


def bodies_at(bodies: Payloads, places: Ints) -> Bodies:
    """(n, 25) the messages at `places` (from `places_of`); zeros where it is -1."""
    raw = np.zeros((len(places), SIZE), dtype=np.uint8)
    there = np.flatnonzero(places >= 0)
    raw[there] = bodies.data[places[there, None] + np.arange(SIZE)]
    return raw


def location_rows(bodies: Payloads) -> LocationColumns:
    """The Location and the first Basic ID of each body, a message or a pack; a bad body has neither."""
    places = places_of(bodies, MessageType.LOCATION)
    found = places >= 0
    raw: Any = bodies_at(bodies, places).view(_LOCATION)[:, 0]
    flags, speed, track = raw["flags"], raw["speed"], raw["track"].astype(np.float64)
    fast, west = flags & 1, flags >> 1 & 1
    nowhere = ~found
    no_place = nowhere | ((raw["lat"] == 0) & (raw["lon"] == 0))
    degrees = track + 180.0 * west
    degrees[degrees == 360.0] = 0.0
    mps = np.where(fast, speed * values.SPEED_FAST_STEP_MPS + values.SPEED_KNEE_MPS, speed * values.SPEED_STEP_MPS)
    ids = places_of(bodies, MessageType.BASIC_ID)
    names: Any = bodies_at(bodies, ids)
    return LocationColumns(
        found=found,
        status=flags >> 4,
        lat_deg=_known(raw["lat"] / values.DEGREES, no_place),
        lon_deg=_known(raw["lon"] / values.DEGREES, no_place),
        alt_geo_m=_altitude(raw["geo"]),
        alt_baro_m=_altitude(raw["baro"]),
        height_m=_altitude(raw["height"]),
        height_type=flags >> 2 & 1,
        speed_mps=_known(mps, nowhere | ((speed == 255) & (fast == 1))),
        vertical_mps=_known(
            raw["vertical"] * values.VERTICAL_STEP_MPS, nowhere | (raw["vertical"] == values.VERTICAL_UNKNOWN)
        ),
        track_deg=_known(degrees, nowhere | ((track == values.TRACK_UNKNOWN[0]) & (west == 1))),
        horizontal_accuracy=raw["place_accuracy"] & 15,
        vertical_accuracy=raw["place_accuracy"] >> 4,
        baro_accuracy=raw["other_accuracy"] >> 4,
        speed_accuracy=raw["other_accuracy"] & 15,
        timestamp_accuracy=raw["time_accuracy"] & 15,
        timestamp_s=_known(raw["time"] / values.TIME_STEPS_PER_S, nowhere | (raw["time"] == values.TIME_UNKNOWN)),
        has_id=ids >= 0,
        id_type=names[:, 1] >> 4,
        ua_type=names[:, 1] & 15,
        uas_id=np.ascontiguousarray(names[:, 2:22]).view("S20")[:, 0],
    )


def _known(numbers: Floats, unknown: NDArray[np.bool_]) -> Floats:
    numbers[unknown] = np.nan
    return numbers


def _altitude(raw: Any) -> Floats:
    """Metres of (n,) 16-bit altitudes."""
    return _known(raw * values.ALTITUDE_STEP_M + values.ALTITUDE_LEAST_M, raw == 0)


def encode_locations(
    status: ArrayLike, lat_deg: ArrayLike, lon_deg: ArrayLike, alt_geo_m: ArrayLike, *,
    alt_baro_m: ArrayLike = np.nan, height_m: ArrayLike = np.nan, height_type: ArrayLike = 0,
    speed_mps: ArrayLike = np.nan, vertical_mps: ArrayLike = np.nan, track_deg: ArrayLike = np.nan,
    horizontal_accuracy: ArrayLike = 0, vertical_accuracy: ArrayLike = 0, baro_accuracy: ArrayLike = 0,
    speed_accuracy: ArrayLike = 0, timestamp_accuracy: ArrayLike = 0, timestamp_s: ArrayLike = np.nan,
) -> Bodies:  # fmt: skip
    """(n, 25) Location messages; n is the length of `lat_deg`, the others are one value or n. NaN is unknown.

    As `f3411.encode`, it saturates speeds and altitudes; a place, track, time or code without bytes is `ValueError`.
    """
    lat, lon = np.asarray(lat_deg, dtype=np.float64), np.asarray(lon_deg, dtype=np.float64)
    rows: NDArray[Any] = np.zeros(len(lat), dtype=_LOCATION)
    rows["kind"] = MessageType.LOCATION << 4 | PROTOCOL_VERSION
    if (np.isnan(lat) != np.isnan(lon)).any():
        raise ValueError("lat_deg and lon_deg: both unknown or neither")
    rows["lat"] = _fitting(np.rint(np.nan_to_num(lat) * values.DEGREES), -(2**31), 2**31 - 1, "lat_deg")
    rows["lon"] = _fitting(np.rint(np.nan_to_num(lon) * values.DEGREES), -(2**31), 2**31 - 1, "lon_deg")
    for name, altitude in (("geo", alt_geo_m), ("baro", alt_baro_m), ("height", height_m)):
        rows[name] = _altitude_bytes(altitude)
    speed = np.asarray(speed_mps, dtype=np.float64)
    _fitting(np.nan_to_num(speed, nan=0.0), 0.0, np.inf, "speed_mps")
    fast = ~(speed <= values.SPEED_KNEE_MPS)  # unknown counts as fast: 255 with the multiplier
    slow_steps = np.rint(np.where(fast, 0.0, speed) / values.SPEED_STEP_MPS)
    fast_steps = np.rint((np.minimum(speed, values.SPEED_MAX_MPS) - values.SPEED_KNEE_MPS) / values.SPEED_FAST_STEP_MPS)
    rows["speed"] = np.where(fast, np.nan_to_num(fast_steps, nan=255.0), slow_steps)
    vertical = np.clip(np.asarray(vertical_mps, dtype=np.float64), -values.VERTICAL_MAX_MPS, values.VERTICAL_MAX_MPS)
    rows["vertical"] = np.nan_to_num(np.rint(vertical / values.VERTICAL_STEP_MPS), nan=values.VERTICAL_UNKNOWN)
    track = np.asarray(track_deg, dtype=np.float64)
    _fitting(np.nan_to_num(track), 0.0, 360.0, "track_deg")
    degrees = np.where(np.isnan(track), 361.0, np.rint(track) % 360.0)
    west = degrees >= 180.0
    rows["track"] = degrees - 180.0 * west
    time = np.rint(np.asarray(timestamp_s, dtype=np.float64) * values.TIME_STEPS_PER_S)
    _fitting(np.nan_to_num(time), 0, values.TIME_UNKNOWN - 1, "timestamp_s")
    rows["time"] = np.nan_to_num(time, nan=values.TIME_UNKNOWN)
    rows["flags"] = _code(status, 15, "status") << 4 | _code(height_type, 1, "height_type") << 2 | west << 1 | fast
    rows["place_accuracy"] = _nibbles(vertical_accuracy, horizontal_accuracy, "vertical or horizontal accuracy")
    rows["other_accuracy"] = _nibbles(baro_accuracy, speed_accuracy, "baro or speed accuracy")
    rows["time_accuracy"] = _code(timestamp_accuracy, 15, "timestamp_accuracy")
    return rows.view(np.uint8).reshape(len(rows), SIZE)


def _altitude_bytes(altitude_m: ArrayLike) -> Floats:
    altitude = np.asarray(altitude_m, dtype=np.float64)
    held = np.clip(altitude, values.ALTITUDE_LEAST_M + values.ALTITUDE_STEP_M, values.ALTITUDE_MAX_M)
    steps = np.rint((held - values.ALTITUDE_LEAST_M) / values.ALTITUDE_STEP_M)
    return np.nan_to_num(steps, nan=0.0)


def _fitting(numbers: Floats, least: float, most: float, what: str) -> Floats:
    if ((numbers < least) | (numbers > most)).any():
        raise ValueError(f"{what}: a value without bytes, expected {least:g}…{most:g} (in the standard's steps)")
    return numbers


def _code(code: ArrayLike, most: int, what: str) -> Ints:
    codes = np.asarray(code, dtype=np.int64)
    if ((codes < 0) | (codes > most)).any():
        raise ValueError(f"{what}: 0…{most}")
    return codes


def _nibbles(high: ArrayLike, low: ArrayLike, what: str) -> Ints:
    return _code(high, 15, what) << 4 | _code(low, 15, what)


def rows_of(bodies: Sequence[bytes]) -> Bodies:
    """(n, 25) of messages encoded one by one (`f3411.encode`), which change seldom; `ValueError` for other lengths."""
    if any(len(body) != SIZE for body in bodies):
        raise ValueError(f"messages of {SIZE} bytes")
    return np.frombuffer(b"".join(bodies), dtype=np.uint8).reshape(len(bodies), SIZE)


def single_rows(part: Bodies) -> Payloads:
    """Bodies of one message each, as Bluetooth 4 carries them."""
    starts = np.arange(len(part), dtype=np.int64) * SIZE
    return Payloads(np.ascontiguousarray(part).reshape(-1), starts, np.full(len(part), SIZE, dtype=np.int64))


def pack_rows(parts: Sequence[Bodies]) -> Payloads:
    """Message packs: pack i holds row i of every part, in the order of the parts (1…9, else `ValueError`)."""
    if not 1 <= len(parts) <= PACK_MOST:
        raise ValueError(f"{len(parts)} messages in a pack, expected 1…{PACK_MOST}")
    count, size = len(parts[0]), PACK_HEADER + SIZE * len(parts)
    out = np.empty((count, size), dtype=np.uint8)
    out[:, 0] = MessageType.MESSAGE_PACK << 4 | PROTOCOL_VERSION
    out[:, 1] = SIZE
    out[:, 2] = len(parts)
    for place, part in enumerate(parts):
        out[:, PACK_HEADER + SIZE * place : PACK_HEADER + SIZE * (place + 1)] = part
    return Payloads(out.reshape(-1), np.arange(count, dtype=np.int64) * size, np.full(count, size, dtype=np.int64))
