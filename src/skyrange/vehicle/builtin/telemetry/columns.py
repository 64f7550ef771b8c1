"""Conversions for the columns of reports: times, angles, places and integers, by rows.

Functions are vectorised over `rows` (aircraft), or compiled for the messages that are sent most; a row's numbers depend
on that row alone. Angles are converted from this project's frames (east-north-up, forward-left-up, counter-clockwise
from east) to MAVLink's (north-east-down, forward-right-down, clockwise from north).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink.message_columns import MessageTable
from skyrange.contracts.frames import Ints
from skyrange.core import elementwise
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_MS, NS_PER_US
from skyrange.vehicle.builtin.fleet import Fleet

Floats = NDArray[np.float64]
Builder = Callable[[Fleet, Ints, MessageTable], None]
"""Fills a table, one row per aircraft of `rows`, in wire units; the table arrives all zero."""
Available = Callable[[Fleet, Ints], NDArray[np.bool_]]
"""Whether each of some aircraft has a message to send at all."""

U16 = 65_535
I16 = 32_767
I32 = 2**31 - 1


def boot_ms(fleet: Fleet, rows: Ints) -> Ints:
    """Return `time_boot_ms`: since boot, modulo 2³² ms."""
    since: Ints = np.maximum(fleet.now - fleet.boot_ns[rows], 0) // NS_PER_MS & 0xFFFFFFFF
    return since


def boot_us(fleet: Fleet, rows: Ints) -> Ints:
    """Return `time_usec` as ArduPilot fills it: since boot, never UTC, which only SYSTEM_TIME has."""
    since: Ints = np.maximum(fleet.now - fleet.boot_ns[rows], 0) // NS_PER_US
    return since


def clip_to_field(values: Floats, most: int, least: int | None = None) -> Floats:
    """Limit numbers to an integer field (−`most` unless `least` is given), which truncates their fractions.

    A value that is not a number becomes a limit: `finite_or_zeros` removes such values.
    """
    inside: Floats = np.fmin(np.fmax(values, -most if least is None else least), most)
    return inside


@compiled
def to_whole(value: float, least: int, most: int) -> int:
    """Limit one number to an integer range and truncate it, in compiled code."""
    if not value >= least:
        return least
    return most if value > most else int(value)


@compiled
def finite_or_zero(value: float) -> float:
    """Return the number, 0 where it is not finite, in compiled code."""
    return value if math.isfinite(value) else 0.0


@compiled
def boot_ms_of(now: int, boot_ns: int) -> int:
    """Return `boot_ms` of one aircraft, in compiled code."""
    return max(now - boot_ns, 0) // NS_PER_MS & 0xFFFFFFFF


@compiled
def heading_cdeg_of(yaw: float) -> int:
    """Return `heading_cdeg` of one yaw, in compiled code."""
    return int((0.5 * math.pi - yaw) * (180.0 / math.pi) % 360.0 * 100.0) % 36_000


def finite_or_zeros(values: Floats) -> Floats:
    """Return the numbers, 0 where they are not finite."""
    finite: Floats = np.where(np.isfinite(values), values, 0.0)
    return finite


def gather_from_vehicles(fleet: Fleet, rows: Ints, read: Callable[[Any], Any], dtype: str = "i8") -> NDArray[Any]:
    """Read a value from the objects of some aircraft."""
    vehicles = fleet.vehicles
    return np.array([read(vehicles[row]) for row in rows.tolist()], dtype=dtype)


def heading_rad(yaw: Floats) -> Floats:
    """Convert a yaw counter-clockwise from east to clockwise from north, −π…π."""
    turned: Floats = (1.5 * math.pi - yaw) % (2.0 * math.pi) - math.pi
    return turned


def heading_cdeg(yaw: Floats) -> Ints:
    """Convert a yaw counter-clockwise from east to hundredths of a degree, 0…35999 (`yaw_sensor`)."""
    return _cdeg(np.degrees(0.5 * math.pi - yaw))


def course_cdeg(east: Floats, north: Floats) -> Ints:
    """Return the direction of a velocity, clockwise from north, hundredths of a degree, 0…35999."""
    return _cdeg(np.degrees(elementwise.atan2(east, north)))


def _cdeg(degrees: Floats) -> Ints:
    turned: Ints = (degrees % 360.0 * 100.0).astype(np.int64) % 36_000
    return turned


def lat_lon_e7(fleet: Fleet, east: Floats, north: Floats) -> tuple[Ints, Ints]:
    """Return latitude and longitude in 1e-7 degrees."""
    lat, lon = fleet.origin.to_geodetic(east, north)
    return np.rint(lat * 1e7).astype(np.int64), np.rint(lon * 1e7).astype(np.int64)


def msl_mm(fleet: Fleet, up: Floats) -> Floats:
    """Return altitude above mean sea level in millimetres, of a height above the origin."""
    return clip_to_field((fleet.origin.alt_msl_m + up) * 1e3, I32)


def home_positions(fleet: Fleet, rows: Ints) -> Floats:
    """Return (n, 3) home positions, ENU metres."""
    homes: Floats = fleet.checks["home"][rows]
    return homes
