"""Locations: conversion from messages and mission items to ENU metres, home, and rally points.

Conversion: from latitude, longitude, altitude and frame of messages and mission items to ENU metres. After Location
(libraries/AP_Common/Location.cpp) and `mavlink_coordinate_frame_to_location_alt_frame`. The ground is flat: altitude
above terrain is height above the origin's plane.

Rally points: their places, and the one that RTL returns to. After libraries/AP_Rally/AP_Rally.cpp and
ArduCopter/AP_Rally.cpp. `mission_protocol.rally_items` uploads the points.

Home position: how it is set and reported (ArduCopter/commands.cpp `Copter::set_home`, AP_AHRS::set_home).
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink import dialect as mav
from skyrange.core import elementary
from skyrange.vehicle.builtin import fence
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionItem, Vehicle
from skyrange.vehicle.builtin.telemetry.table import build_message

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
    return max(elementary.cos(lat_e7 * 1e-7 * math.radians(1.0)), _LEAST_SCALE)


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


MAX_ITEMS: Final = 46
"""(90 + 300 + 300) / 15 bytes (StorageManager.cpp StorageRally, 15 areas; AP_Rally.cpp `RallyLocation`)."""

Place = tuple[float, float, float]
"""East, north, up in metres."""

ABSOLUTE: Final = dialect.MAV_FRAME_GLOBAL
ABOVE_HOME: Final = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT
"""Frames of stored points; the third is MAV_FRAME_GLOBAL_TERRAIN_ALT."""


def location_of(fleet: Fleet, vehicle: Vehicle, point: MissionItem) -> Place:
    """Return a rally point's place; the ground is flat, at the origin's height."""
    east, north = fleet.origin.enu_of(point.x * 1e-7, point.y * 1e-7)
    datum = {ABSOLUTE: -fleet.origin.alt_msl_m, ABOVE_HOME: vehicle.home[2]}.get(point.frame, 0.0)
    return east, north, point.z + datum


def nearest_rally_point(fleet: Fleet, vehicle: Vehicle) -> Place | None:
    """Return the nearest rally point inside the fence; `None` beyond RALLY_LIMIT_KM (`find_nearest_rally_point`)."""
    here = fleet.position(vehicle)
    places = (location_of(fleet, vehicle, point) for point in vehicle.rally if point.x != 0 or point.y != 0)
    inside = [place for place in places if fence.destination_within_fence(fleet, vehicle, place)]
    best = min(inside, key=lambda place: _distance(here, place), default=None)
    limit_m = fleet.param(vehicle, "RALLY_LIMIT_KM") * 1000.0
    if best is None or 0.0 < limit_m < _distance(here, best):
        return None
    return best


def best_rally_or_home(fleet: Fleet, vehicle: Vehicle) -> Place:
    """Return the destination of RTL: the nearest rally point, or home if that is nearer and RALLY_INCL_HOME is set.

    `up` is the point's own height, below which the return does not fly (`calc_best_rally_or_home_location`).
    """
    best = nearest_rally_point(fleet, vehicle)
    if best is None:
        return vehicle.home
    here = fleet.position(vehicle)
    if fleet.param(vehicle, "RALLY_INCL_HOME") != 0 and _distance(here, vehicle.home) <= _distance(here, best):
        return vehicle.home
    return best


def _distance(a: Place, b: Place) -> float:
    return elementary.hypot(a[0] - b[0], a[1] - b[1])


def send_home(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> None:
    """Send HOME_POSITION and GPS_GLOBAL_ORIGIN, as at every change of home."""
    for number in (mav.MAVLINK_MSG_ID_HOME_POSITION, mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN):
        message = build_message(fleet, vehicle, number)
        if message is not None:
            fleet.send(vehicle, message, causes)


def set_home(fleet: Fleet, vehicle: Vehicle, place: tuple[float, float, float], causes: Causes, *, lock: bool) -> None:
    """Move home to a place (ENU metres) at once, for the fence too; with `lock`, the next arming does not move it."""
    fleet.assign_home(vehicle, place)
    vehicle.home_locked = vehicle.home_locked or lock
    fleet.note("event.home", vehicle, {"east_m": place[0], "north_m": place[1], "up_m": place[2]}, causes)
    send_home(fleet, vehicle, causes)
