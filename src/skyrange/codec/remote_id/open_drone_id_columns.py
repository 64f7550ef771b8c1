"""Batch conversion of OPEN_DRONE_ID_LOCATION: MAVLink tables to the columns from which F3411 Locations are encoded.

Gives the same results as `codec.remote_id.open_drone_id.from_mavlink` does one by one, except that a number that F3411
cannot encode (a track of 400°, a status of 200) becomes unknown: a bad value from an autopilot must not stop its
transmitter.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411 import values
from skyrange.codec.f3411.columns import CODES, NUMBERS, Codes, Flags, Floats
from skyrange.codec.mavlink.message_columns import MessageTable
from skyrange.codec.remote_id.open_drone_id import (
    ALTITUDE_UNKNOWN_M,
    SPEED_UNKNOWN_CMPS,
    TRACK_UNKNOWN_CDEG,
    VERTICAL_UNKNOWN_CMPS,
)

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
    numbers[0] = _known(table["latitude"] / values.UNITS_PER_DEGREE, placed)
    numbers[1] = _known(table["longitude"] / values.UNITS_PER_DEGREE, placed)
    for row, name in enumerate(_ALTITUDES, start=2):
        metres = _as_float64(table[name])
        numbers[row] = _known(metres, np.isfinite(metres) & (metres != ALTITUDE_UNKNOWN_M))
    for row, name, unknown in (
        (5, "speed_horizontal", SPEED_UNKNOWN_CMPS),
        (6, "speed_vertical", VERTICAL_UNKNOWN_CMPS),
        (7, "direction", TRACK_UNKNOWN_CDEG),
    ):
        numbers[row] = _known(table[name] / 100.0, table[name] != unknown)
    numbers[7, table["direction"] > _TRACK_MAX_CDEG] = np.nan
    seconds = _as_float64(table["timestamp"])
    numbers[8] = _known(seconds, (seconds >= 0.0) & (seconds <= _TIME_MAX_S))
    for row, name in enumerate(_CODES):
        codes[row] = np.where(table[name] <= _MAX_CODES[row], table[name], 0)
    return numbers, codes


def _as_float64(numbers: NDArray[np.float32]) -> Floats:
    with np.errstate(invalid="ignore"):  # some bytes are a signalling NaN
        return numbers.astype(np.float64)


def _known(numbers: Floats, where: Flags) -> Floats:
    found: Floats = np.where(where, numbers, np.nan)
    return found
