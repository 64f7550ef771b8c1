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

_UNIT_M: Final = 0.011131884502145034
"""Length of 1e-7 degrees of latitude (LOCATION_SCALING_FACTOR of Location.h)."""

Vector = tuple[float, float, float]


def as_array(place: Vector) -> NDArray[Any]:
    """Return a point as an array, for compiled functions."""
    return np.array(place)


def altitude_datum_m(fleet: Fleet, vehicle: Vehicle, frame: int) -> float:
    """Return what to add to an altitude in a frame to get the height above the origin, m."""
    if frame in RELATIVE_FRAMES:
        return vehicle.home[2]
    return 0.0 if frame in TERRAIN_FRAMES else -fleet.origin.alt_msl_m


def truncated(fleet: Fleet, place: Vector) -> Vector:
    """Return a point as a Location holds it: in whole 1e-7 degrees and centimetres (Location::offset)."""
    east, north, up = place
    east_unit = _UNIT_M * max(math.cos(math.radians(fleet.origin.lat_deg)), 0.01)
    return int(east / east_unit) * east_unit, int(north / _UNIT_M) * _UNIT_M, int(up * 100.0) * 0.01


def to_enu(fleet: Fleet, vehicle: Vehicle, frame: int, lat_e7: int, lon_e7: int, alt_m: float) -> Vector | None:
    """Return the point in ENU metres; `None` for an unknown frame or an invalid latitude or longitude."""
    lat, lon = lat_e7 * 1e-7, lon_e7 * 1e-7
    if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 180.0):
        return None
    if frame not in RELATIVE_FRAMES | TERRAIN_FRAMES | ABSOLUTE_FRAMES:
        return None
    east, north = fleet.origin.enu_of(lat, lon)
    return east, north, alt_m + altitude_datum_m(fleet, vehicle, frame)
