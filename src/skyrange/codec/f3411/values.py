"""Number formats of F3411: speeds, altitudes, directions, positions, times and accuracies as integers.

ASTM F3411-22a, tables of the Basic ID to Operator ID messages; opendroneid-core-c (`libopendroneid/opendroneid.h`,
`opendroneid.c`) has the same resolutions and special values, and test vectors compare the two. Numbers are rounded to
the nearest step, halves to the even one. The `encode_*` functions saturate where the standard defines the last value
as "or more", and raise `ValueError` for values that cannot be encoded.
"""

from __future__ import annotations

from math import isfinite
from typing import Final

SPEED_STEP_MPS: Final = 0.25
"""Up to `SPEED_KNEE_MPS`, multiplier bit 0."""
SPEED_FAST_STEP_MPS: Final = 0.75
"""Above it, multiplier bit 1."""
SPEED_KNEE_MPS: Final = 63.75
"""255 × 0.25."""
SPEED_SLOW_MPS: Final = SPEED_KNEE_MPS + SPEED_FAST_STEP_MPS / 2
"""Up to here the nearest step is one of `SPEED_STEP_MPS`: the knee itself is 255 of these, not 0 of the others."""
SPEED_MAX_MPS: Final = 254.25
"""254 × 0.75 + 63.75: this speed or faster."""
SPEED_UNKNOWN: Final = (255, 1)
"""Byte and multiplier bit of "255 m/s", which means unknown."""
VERTICAL_STEP_MPS: Final = 0.5
VERTICAL_MAX_MPS: Final = 62.0
"""This speed or faster, up or down."""
VERTICAL_UNKNOWN: Final = 126
""""63 m/s"."""
ALTITUDE_STEP_M: Final = 0.5
ALTITUDE_MIN_M: Final = -1000.0
"""Written as 0, which means unknown."""
ALTITUDE_MAX_M: Final = 31767.5
UNITS_PER_DEGREE: Final = 10_000_000
"""Latitude and longitude count 1e-7 degrees; both 0 means unknown."""
TRACK_UNKNOWN: Final = (181, 1)
"""Byte and east/west bit of "361°"."""
TIME_STEPS_PER_S: Final = 10
TIME_UNKNOWN: Final = 0xFFFF
TIME_MAX_S: Final = 3600.0
RADIUS_STEP_M: Final = 10
RADIUS_MAX_M: Final = 2550.0

NAUTICAL_MILE_M: Final = 1852.0
HORIZONTAL_ACCURACY_M: Final = (
    None, *(miles * NAUTICAL_MILE_M for miles in (10, 4, 2, 1, 0.5, 0.3, 0.1, 0.05)), 30.0, 10.0, 3.0, 1.0,
)  # fmt: skip
"""By code: the horizontal error is below this (95 %, NACp of RTCA DO-282B); `None`: 18.52 km or more, or unknown."""
VERTICAL_ACCURACY_M: Final = (None, 150.0, 45.0, 25.0, 10.0, 3.0, 1.0)
"""By code: the vertical error is below this."""
SPEED_ACCURACY_MPS: Final = (None, 10.0, 3.0, 1.0, 0.3)
"""By code: the error of the speed is below this (NACv of RTCA DO-282B)."""


def accuracy_code(table: tuple[float | None, ...], error: float | None) -> int:
    """The code in `table` of the tightest limit above `error`; 0 if there is none."""
    if error is None or not isfinite(error) or error < 0:
        return 0
    code = 0
    for place, limit in enumerate(table):
        if limit is not None and error < limit:
            code = place
    return code


def _finite(value: float, what: str) -> float:
    if not isfinite(value):
        raise ValueError(f"{what} {value}: a number, or None for unknown")
    return value


def encode_speed(speed_mps: float | None) -> tuple[int, int]:
    """(byte, multiplier bit)."""
    if speed_mps is None:
        return SPEED_UNKNOWN
    if _finite(speed_mps, "speed_mps") < 0:
        raise ValueError(f"speed_mps {speed_mps}: 0 or more")
    if speed_mps <= SPEED_SLOW_MPS:
        return min(round(speed_mps / SPEED_STEP_MPS), 255), 0
    return min(round((speed_mps - SPEED_KNEE_MPS) / SPEED_FAST_STEP_MPS), 254), 1


def decode_speed(value: int, fast: int) -> float | None:
    """Metres per second; `fast` is the multiplier bit."""
    if (value, fast) == SPEED_UNKNOWN:
        return None
    return value * SPEED_FAST_STEP_MPS + SPEED_KNEE_MPS if fast else value * SPEED_STEP_MPS


def encode_vertical(vertical_mps: float | None) -> int:
    """A signed byte."""
    if vertical_mps is None:
        return VERTICAL_UNKNOWN
    clamped = min(max(_finite(vertical_mps, "vertical_mps"), -VERTICAL_MAX_MPS), VERTICAL_MAX_MPS)
    return round(clamped / VERTICAL_STEP_MPS)


def decode_vertical(value: int) -> float | None:
    """Metres per second, up positive."""
    return None if value == VERTICAL_UNKNOWN else value * VERTICAL_STEP_MPS


def encode_altitude(altitude_m: float | None) -> int:
    """16 bits; the lowest known altitude is −999.5 m, since −1000 m means unknown."""
    if altitude_m is None:
        return 0
    clamped_m = min(max(_finite(altitude_m, "altitude"), ALTITUDE_MIN_M + ALTITUDE_STEP_M), ALTITUDE_MAX_M)
    return round((clamped_m - ALTITUDE_MIN_M) / ALTITUDE_STEP_M)


def decode_altitude(value: int) -> float | None:
    """Metres."""
    return None if value == 0 else value * ALTITUDE_STEP_M + ALTITUDE_MIN_M


def encode_position(lat_deg: float | None, lon_deg: float | None) -> tuple[int, int]:
    """Two signed integers of 32 bits. A latitude of 95° can be encoded (a sender may claim it), one of 220° cannot."""
    if lat_deg is None or lon_deg is None:
        if lat_deg is not None or lon_deg is not None:
            raise ValueError(f"lat_deg {lat_deg}, lon_deg {lon_deg}: both or neither")
        return 0, 0
    lat, lon = (
        round(_finite(lat_deg, "lat_deg") * UNITS_PER_DEGREE),
        round(_finite(lon_deg, "lon_deg") * UNITS_PER_DEGREE),
    )
    for name, value in (("lat_deg", lat), ("lon_deg", lon)):
        if not -(2**31) <= value < 2**31:
            raise ValueError(f"{name} {value / UNITS_PER_DEGREE}: does not fit 32 bits of 1e-7 degrees")
    return lat, lon


def decode_position(lat: int, lon: int) -> tuple[float | None, float | None]:
    """Degrees."""
    return (None, None) if lat == 0 and lon == 0 else (lat / UNITS_PER_DEGREE, lon / UNITS_PER_DEGREE)


def encode_track(track_deg: float | None) -> tuple[int, int]:
    """(byte, east/west bit) of whole degrees."""
    if track_deg is None:
        return TRACK_UNKNOWN
    if not 0 <= _finite(track_deg, "track_deg") <= 360:
        raise ValueError(f"track_deg {track_deg}: 0…360")
    degrees = round(track_deg) % 360
    return (degrees - 180, 1) if degrees >= 180 else (degrees, 0)


def decode_track(value: int, west: int) -> float | None:
    """Degrees. Bytes above 179 are not allowed by the standard and decode to their sum, 180…435°; 360 decodes to 0."""
    if (value, west) == TRACK_UNKNOWN:
        return None
    degrees = value + 180 * west
    return 0.0 if degrees == 360 else float(degrees)


def encode_time(timestamp_s: float | None) -> int:
    """16 bits of tenths of a second since the full hour."""
    if timestamp_s is None:
        return TIME_UNKNOWN
    value = round(_finite(timestamp_s, "timestamp_s") * TIME_STEPS_PER_S)
    if not 0 <= value < TIME_UNKNOWN:
        raise ValueError(f"timestamp_s {timestamp_s}: seconds since the full hour, 0…3600")
    return value


def decode_time(value: int) -> float | None:
    """Seconds since the full hour."""
    return None if value == TIME_UNKNOWN else value / TIME_STEPS_PER_S
