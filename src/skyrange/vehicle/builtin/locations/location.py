"""Locations: from latitude, longitude, altitude and frame of messages and mission items to ENU metres.

After Location (libraries/AP_Common/Location.cpp) and `mavlink_coordinate_frame_to_location_alt_frame`. The ground is
flat: altitude above terrain is height above the origin's plane.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle

RELATIVE_FRAMES = frozenset((dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT))
TERRAIN_FRAMES = frozenset((dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT, dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT))
ABSOLUTE_FRAMES = frozenset((dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT))

_UNIT_CM: Final = np.float32(1.1131884502145034)
"""Length of 1e-7 degrees of latitude (LATLON_TO_CM of definitions.h); ArduPilot's constants are floats."""
_UNITS_PER_M: Final = float(np.float32(89.83204953368922))
"""LATLON_TO_M_INV."""
_METRES_PER_CM: Final = np.float32(0.01)
_HALF_TURN_E7: Final = 1_800_000_000
_LEAST_SCALE: Final = 0.01
"""Of a degree of longitude near the poles (Location::longitude_scale)."""

Vector = tuple[float, float, float]


def as_array(place: Vector) -> NDArray[Any]:
    """Return a point as an array, for compiled functions."""
    return np.array(place)


def altitude_datum_m(fleet: Fleet, vehicle: Vehicle, frame: int) -> float:
    """Return what to add to an altitude in a frame to get the height above the origin, m."""
    if frame in RELATIVE_FRAMES:
        return vehicle.home[2]
    return 0.0 if frame in TERRAIN_FRAMES else -fleet.origin.alt_msl_m


def truncated(fleet: Fleet, vehicle: Vehicle, place: Vector) -> Vector:
    """Return a point as a Location holds it: whole 1e-7 degrees from the aircraft's origin, whole centimetres.

    ArduPilot truncates both, towards the origin of the EKF, which is where the aircraft was switched on
    (Location::offset_latlng).
    """
    lat_e7, lon_e7 = vehicle.origin_e7
    lat, lon = fleet.origin.geodetic_of(place[0], place[1])
    units = lat_e7 + int(lat * 1e7 - lat_e7), lon_e7 + int(_diff_longitude(lon * 1e7 - lon_e7))
    return (*_enu_of(fleet, *units), int(place[2] * 100.0) * 0.01)


def rounded_destination(fleet: Fleet, vehicle: Vehicle, place: Vector) -> Vector:
    """Return the Location that ArduPilot makes of a destination, often 1e-7° nearer to the origin.

    A destination is kept as centimetres from the origin in single precision, and converted back by truncation
    (`AC_WPNav::get_wp_destination_loc`, after `Location::get_vector_xy_from_origin_NE_cm`). So a command without a
    place that follows a waypoint has a leg of nothing or of a centimetre, which takes a second.
    """
    lat_e7, lon_e7 = vehicle.origin_e7
    lat, lon = fleet.origin.geodetic_of(place[0], place[1])
    to_lat, to_lon = round(lat * 1e7), round(lon * 1e7)
    north_cm = np.float32(to_lat - lat_e7) * _UNIT_CM
    scale = _longitude_scale(int((to_lat + lat_e7) / 2))
    east_cm = np.float32(float(np.float32(_diff_longitude(to_lon - lon_e7)) * _UNIT_CM) * scale)
    north_units = int(float(north_cm * _METRES_PER_CM) * _UNITS_PER_M)
    scale = _longitude_scale(lat_e7 + int(north_units / 2))
    east_units = int(float(east_cm * _METRES_PER_CM) * _UNITS_PER_M / scale)
    return (*_enu_of(fleet, lat_e7 + north_units, lon_e7 + east_units), place[2])


def _diff_longitude(units: float) -> float:
    """Return a difference of longitudes in 1e-7 degrees, across the date line if that is shorter (diff_longitude)."""
    if units > _HALF_TURN_E7:
        return units - 2 * _HALF_TURN_E7
    return units + 2 * _HALF_TURN_E7 if units < -_HALF_TURN_E7 else units


def _longitude_scale(lat_e7: int) -> float:
    return max(math.cos(lat_e7 * 1e-7 * math.radians(1.0)), _LEAST_SCALE)


def _enu_of(fleet: Fleet, lat_e7: int, lon_e7: int) -> tuple[float, float]:
    return fleet.origin.enu_of(lat_e7 * 1e-7, lon_e7 * 1e-7)


def to_enu(fleet: Fleet, vehicle: Vehicle, frame: int, lat_e7: int, lon_e7: int, alt_m: float) -> Vector | None:
    """Return the point in ENU metres; `None` for an unknown frame or an invalid latitude or longitude."""
    lat, lon = lat_e7 * 1e-7, lon_e7 * 1e-7
    if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 180.0):
        return None
    if frame not in RELATIVE_FRAMES | TERRAIN_FRAMES | ABSOLUTE_FRAMES:
        return None
    east, north = fleet.origin.enu_of(lat, lon)
    return east, north, alt_m + altitude_datum_m(fleet, vehicle, frame)
