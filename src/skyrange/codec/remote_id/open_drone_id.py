"""Conversion between MAVLink `OPEN_DRONE_ID_*` messages and the values of `codec.f3411`, one by one and in columns.

Units and unknown values are those of MAVLink's common.xml (messages 12900…12905, 12915, 12919): centidegrees, cm/s,
degrees times 1e7, metres; unknown are 36100 cdeg, 25500 cm/s, 6300 cm/s vertical, −1000 m, latitude and longitude both
0, timestamp 65535. Unlike MAVLink's usual `alt`, the altitudes `altitude_geodetic` and `operator_altitude_geo` are
heights above the WGS 84 ellipsoid; `core.geodesy.Origin` converts.

`location_columns` gives the same results as `from_mavlink`, except that a number that F3411 cannot encode (a track of
400°, a status of 200) becomes unknown: a bad value from an autopilot must not stop its transmitter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411 import (
    PROTOCOL_VERSION,
    SIZE,
    Authentication,
    BasicId,
    Location,
    MessagePack,
    MessageType,
    OperatorId,
    SelfId,
    System,
    decode,
    encode,
    values,
)
from skyrange.codec.f3411 import Message as RidMessage
from skyrange.codec.f3411.columns import CODES, NUMBERS, Codes, Flags, Floats
from skyrange.codec.mavlink.frames import Message, dialect
from skyrange.codec.mavlink.message_columns import MessageTable
from skyrange.core.errors import DecodeError

TRACK_UNKNOWN_CDEG: Final = 36_100
SPEED_UNKNOWN_CMPS: Final = 25_500
VERTICAL_UNKNOWN_CMPS: Final = 6_300
ALTITUDE_UNKNOWN_M: Final = -1000.0
TIME_UNKNOWN_S: Final = 65_535.0
PACK_BYTES: Final = 225
BROADCAST: Final = (0, 0)
"""Target system and component: all."""


def to_mavlink(message: RidMessage, *, target: tuple[int, int] = BROADCAST, id_or_mac: bytes = bytes(20)) -> Message:
    """The MAVLink message equivalent to `message`; raises `ValueError` if there is none (`f3411.Reserved`).

    `id_or_mac` (20 bytes) names the other aircraft that a broadcast was received from; zeros mean this aircraft. The
    protocol version is not carried. Speeds saturate as in F3411.
    """
    who = (*target, list(id_or_mac))
    if isinstance(message, BasicId):
        text = _bytes(message.uas_id, 20)
        return dialect.MAVLink_open_drone_id_basic_id_message(*who, message.id_type, message.ua_type, list(text))
    if isinstance(message, Location):
        lat, lon = values.encode_position(message.lat_deg, message.lon_deg)
        return dialect.MAVLink_open_drone_id_location_message(
            *who, message.status, _track(message.track_deg), _speed(message.speed_mps),
            _vertical(message.vertical_mps), lat, lon, _altitude(message.alt_baro_m), _altitude(message.alt_geo_m),
            message.height_type, _altitude(message.height_m), message.horizontal_accuracy, message.vertical_accuracy,
            message.baro_accuracy, message.speed_accuracy,
            TIME_UNKNOWN_S if message.timestamp_s is None else message.timestamp_s, message.timestamp_accuracy,
        )  # fmt: skip
    if isinstance(message, Authentication):
        return dialect.MAVLink_open_drone_id_authentication_message(
            *who, message.auth_type, message.page, message.last_page or 0, message.length or 0,
            message.timestamp_s or 0, list(message.data.ljust(23, b"\0")),
        )  # fmt: skip
    if isinstance(message, SelfId):
        text = _bytes(message.text, 23)
        return dialect.MAVLink_open_drone_id_self_id_message(*who, message.description_type, text)
    if isinstance(message, System):
        lat, lon = values.encode_position(message.operator_lat_deg, message.operator_lon_deg)
        return dialect.MAVLink_open_drone_id_system_message(
            *who, message.operator_location_type, message.classification, lat, lon, message.area_count,
            round(message.area_radius_m), _altitude(message.area_ceiling_m), _altitude(message.area_floor_m),
            message.category, message.ua_class, _altitude(message.operator_alt_geo_m), message.timestamp_s,
        )  # fmt: skip
    if isinstance(message, OperatorId):
        text = _bytes(message.operator_id, 20)
        return dialect.MAVLink_open_drone_id_operator_id_message(*who, message.operator_id_type, text)
    if isinstance(message, MessagePack):
        bodies = b"".join(encode(part) for part in message.messages).ljust(PACK_BYTES, b"\0")
        return dialect.MAVLink_open_drone_id_message_pack_message(*who, SIZE, len(message.messages), list(bodies))
    raise ValueError(f"{message}: no MAVLink message is equivalent")


def from_mavlink(message: Message) -> RidMessage:
    """The F3411 message equivalent to an `OPEN_DRONE_ID_*` message.

    Raises `DecodeError` for any other message and for an inconsistent pack. Values outside F3411's range (a status of
    200) are kept, and `f3411.deviations` names them; a field that is not a number becomes unknown.
    """
    reader = _READERS.get(type(message).id)
    if reader is None:
        raise DecodeError(f"{type(message).msgname} is not an Open Drone ID message")
    return reader(message)


def apply_system_update(system: System, message: Message) -> System:
    """`system` with the newer position and time of an OPEN_DRONE_ID_SYSTEM_UPDATE."""
    lat_deg, lon_deg = values.decode_position(message.operator_latitude, message.operator_longitude)
    return system._replace(
        operator_lat_deg=lat_deg,
        operator_lon_deg=lon_deg,
        operator_alt_geo_m=_known(message.operator_altitude_geo, ALTITUDE_UNKNOWN_M),
        timestamp_s=message.timestamp,
    )


def _bytes(text: str, size: int) -> bytes:
    try:
        raw = text.encode("latin-1")
    except UnicodeEncodeError:
        raise ValueError(f"{text!r}: one byte per character (latin-1)") from None
    if len(raw) > size:
        raise ValueError(f"{text!r}: {len(raw)} bytes, at most {size}")
    return raw.ljust(size, b"\0")


def _track(track_deg: float | None) -> int:
    return TRACK_UNKNOWN_CDEG if track_deg is None else round(track_deg * 100)


def _speed(speed_mps: float | None) -> int:
    return SPEED_UNKNOWN_CMPS if speed_mps is None else round(min(speed_mps, values.SPEED_MAX_MPS) * 100)


def _vertical(vertical_mps: float | None) -> int:
    if vertical_mps is None:
        return VERTICAL_UNKNOWN_CMPS
    return round(min(max(vertical_mps, -values.VERTICAL_MAX_MPS), values.VERTICAL_MAX_MPS) * 100)


def _altitude(altitude_m: float | None) -> float:
    return ALTITUDE_UNKNOWN_M if altitude_m is None else altitude_m


def _known(number: float, unknown: float, scale: float = 1.0) -> float | None:
    return None if number == unknown or not isfinite(number) else number / scale


def _text(field: Sequence[int] | bytes | str) -> str:
    """A text field, which pymavlink keeps as `str` or `bytes`, or as numbers where common.xml declares `uint8_t`."""
    if isinstance(field, str):
        return field.rstrip("\0")
    return bytes(field).rstrip(b"\0").decode("latin-1")


def _basic_id(message: Any) -> BasicId:
    return BasicId(message.id_type, message.ua_type, _text(message.uas_id))


def _location(message: Any) -> Location:
    lat_deg, lon_deg = values.decode_position(message.latitude, message.longitude)
    return Location(
        message.status, lat_deg, lon_deg, _known(message.altitude_geodetic, ALTITUDE_UNKNOWN_M),
        _known(message.altitude_barometric, ALTITUDE_UNKNOWN_M), _known(message.height, ALTITUDE_UNKNOWN_M),
        message.height_reference, _known(message.speed_horizontal, SPEED_UNKNOWN_CMPS, 100),
        _known(message.speed_vertical, VERTICAL_UNKNOWN_CMPS, 100), _known(message.direction, TRACK_UNKNOWN_CDEG, 100),
        message.horizontal_accuracy, message.vertical_accuracy, message.barometer_accuracy, message.speed_accuracy,
        message.timestamp_accuracy, _known(message.timestamp, TIME_UNKNOWN_S),
    )  # fmt: skip


def _authentication(message: Any) -> Authentication:
    data = bytes(message.authentication_data)
    if message.data_page:
        return Authentication(message.authentication_type, message.data_page, data)
    return Authentication(
        message.authentication_type, 0, data[:17], message.last_page_index, message.length, message.timestamp
    )


def _self_id(message: Any) -> SelfId:
    return SelfId(message.description_type, _text(message._description_raw))


def _system(message: Any) -> System:
    lat_deg, lon_deg = values.decode_position(message.operator_latitude, message.operator_longitude)
    return System(
        message.operator_location_type, lat_deg, lon_deg, _known(message.operator_altitude_geo, ALTITUDE_UNKNOWN_M),
        message.area_count, float(message.area_radius), _known(message.area_ceiling, ALTITUDE_UNKNOWN_M),
        _known(message.area_floor, ALTITUDE_UNKNOWN_M), message.classification_type, message.category_eu,
        message.class_eu, message.timestamp,
    )  # fmt: skip


def _operator_id(message: Any) -> OperatorId:
    return OperatorId(message.operator_id_type, _text(message._operator_id_raw))


def _pack(message: Any) -> RidMessage:
    if message.single_message_size != SIZE or not 1 <= message.msg_pack_size <= PACK_BYTES // SIZE:
        raise DecodeError(
            f"a pack of {message.msg_pack_size} messages of {message.single_message_size} bytes,"
            f" expected 1…{PACK_BYTES // SIZE} of {SIZE}"
        )
    bodies = bytes(message.messages)
    size = SIZE * message.msg_pack_size
    return decode(
        bytes([MessageType.MESSAGE_PACK << 4 | PROTOCOL_VERSION, SIZE, message.msg_pack_size]) + bodies[:size]
    )


_READERS: Final[dict[int, Callable[[Any], RidMessage]]] = {
    dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_BASIC_ID: _basic_id,
    dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION: _location,
    dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_AUTHENTICATION: _authentication,
    dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_SELF_ID: _self_id,
    dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM: _system,
    dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_OPERATOR_ID: _operator_id,
    dialect.MAVLINK_MSG_ID_OPEN_DRONE_ID_MESSAGE_PACK: _pack,
}


_ALTITUDES: Final = ("altitude_geodetic", "altitude_barometric", "height")
_CODES: Final = (
    "status", "height_reference", "horizontal_accuracy", "vertical_accuracy", "barometer_accuracy", "speed_accuracy",
    "timestamp_accuracy",
)  # fmt: skip
"""MAVLink's names of `CODES`, in the same order."""
_MAX_CODES: Final = np.array([15, 1, 15, 15, 15, 15, 15])
_TRACK_MAX_CDEG: Final = 36_000
_TIME_MAX_S: Final = (values.TIME_UNKNOWN - 1) / values.TIME_STEPS_PER_S


def location_columns(table: MessageTable) -> tuple[Floats, Codes]:
    """(9, n) numbers and (7, n) codes as `f3411.columns.encode_locations` takes them; NaN is unknown.

    `table` (n,): rows of `message_columns.payload_dtype` OPEN_DRONE_ID_LOCATION.
    """
    numbers, codes = np.empty((len(NUMBERS), len(table))), np.empty((len(CODES), len(table)), dtype=np.uint8)
    placed = (table["latitude"] != 0) | (table["longitude"] != 0)
    numbers[0] = _known_values(table["latitude"] / values.UNITS_PER_DEGREE, placed)
    numbers[1] = _known_values(table["longitude"] / values.UNITS_PER_DEGREE, placed)
    for row, name in enumerate(_ALTITUDES, start=2):
        metres = _as_float64(table[name])
        numbers[row] = _known_values(metres, np.isfinite(metres) & (metres != ALTITUDE_UNKNOWN_M))
    for row, name, unknown in (
        (5, "speed_horizontal", SPEED_UNKNOWN_CMPS),
        (6, "speed_vertical", VERTICAL_UNKNOWN_CMPS),
        (7, "direction", TRACK_UNKNOWN_CDEG),
    ):
        numbers[row] = _known_values(table[name] / 100.0, table[name] != unknown)
    numbers[7, table["direction"] > _TRACK_MAX_CDEG] = np.nan
    seconds = _as_float64(table["timestamp"])
    numbers[8] = _known_values(seconds, (seconds >= 0.0) & (seconds <= _TIME_MAX_S))
    for row, name in enumerate(_CODES):
        codes[row] = np.where(table[name] <= _MAX_CODES[row], table[name], 0)
    return numbers, codes


def _as_float64(numbers: NDArray[np.float32]) -> Floats:
    with np.errstate(invalid="ignore"):  # some bytes are a signalling NaN
        return numbers.astype(np.float64)


def _known_values(numbers: Floats, where: Flags) -> Floats:
    known_numbers: Floats = np.where(where, numbers, np.nan)
    return known_numbers
