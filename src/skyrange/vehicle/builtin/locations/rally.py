"""Rally points: their places, and the one that RTL returns to.

After libraries/AP_Rally/AP_Rally.cpp and ArduCopter/AP_Rally.cpp. `mission_protocol.rally_items` uploads the points.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fence import fence
from skyrange.vehicle.builtin.fleet import Fleet, MissionItem, Vehicle

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
    good = [place for place in places if fence.destination_within_fence(fleet, vehicle, place)]
    best = min(good, key=lambda place: _distance(here, place), default=None)
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
    return math.hypot(a[0] - b[0], a[1] - b[1])
