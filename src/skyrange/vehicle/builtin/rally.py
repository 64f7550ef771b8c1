"""Rally points: their places, and the one that RTL returns to.

After libraries/AP_Rally/AP_Rally.cpp, ArduCopter/AP_Rally.cpp and libraries/GCS_MAVLink/MissionItemProtocol_Rally.cpp.
"""

from __future__ import annotations

import math
from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin import fence
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Slot, Upload
from skyrange.vehicle.builtin.transfer_kinds import lat_lon_e7, plain_kind

MAX_ITEMS: Final = 46
"""(90 + 300 + 300) / 15 bytes (StorageManager.cpp StorageRally, 15 areas; AP_Rally.cpp `RallyLocation`)."""

Place = tuple[float, float, float]
"""East, north, up in metres."""

_NUMBER = dialect.MAV_MISSION_TYPE_RALLY
_ACCEPTED = int(dialect.MAV_MISSION_ACCEPTED)
_LAT_MAX, _LON_MAX = 900_000_000, 1_800_000_000
_ALT_MIN_M, _ALT_MAX_M = -32_768, 32_767
_ABSOLUTE = dialect.MAV_FRAME_GLOBAL
_ABOVE_HOME = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT
_ABOVE_GROUND = dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT
_FRAMES = {
    dialect.MAV_FRAME_GLOBAL: _ABSOLUTE,
    dialect.MAV_FRAME_GLOBAL_INT: _ABSOLUTE,
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT: _ABOVE_HOME,
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: _ABOVE_HOME,
    dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT: _ABOVE_GROUND,
    dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: _ABOVE_GROUND,
}


def place_of(fleet: Fleet, craft: Craft, point: Slot) -> Place:
    """Return a rally point's place; the ground is flat, at the origin's height."""
    east, north = fleet.origin.enu_of(point.x * 1e-7, point.y * 1e-7)
    datum = {_ABSOLUTE: -fleet.origin.alt_msl_m, _ABOVE_HOME: craft.home[2]}.get(point.frame, 0.0)
    return east, north, point.z + datum


def nearest(fleet: Fleet, craft: Craft) -> Place | None:
    """Return the nearest rally point inside the fence; `None` beyond RALLY_LIMIT_KM (`find_nearest_rally_point`)."""
    here = fleet.position(craft)
    places = (place_of(fleet, craft, point) for point in craft.rally if point.x != 0 or point.y != 0)
    good = [place for place in places if fence.allows(fleet, craft, place)]
    best = min(good, key=lambda place: _distance(here, place), default=None)
    limit_m = fleet.param(craft, "RALLY_LIMIT_KM") * 1000.0
    if best is None or 0.0 < limit_m < _distance(here, best):
        return None
    return best


def return_point(fleet: Fleet, craft: Craft) -> Place:
    """Return the destination of RTL: the nearest rally point, or home if that is nearer and RALLY_INCL_HOME is set.

    `up` is the point's own height, below which the return does not fly (`calc_best_rally_or_home_location`).
    """
    best = nearest(fleet, craft)
    if best is None:
        return craft.home
    here = fleet.position(craft)
    if fleet.param(craft, "RALLY_INCL_HOME") != 0 and _distance(here, craft.home) <= _distance(here, best):
        return craft.home
    return best


def _distance(a: Place, b: Place) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])


def _slot(message: Any, causes: Causes) -> tuple[int, Slot | None]:
    """Return (MAV_MISSION_RESULT, item) of one message (`convert_MISSION_ITEM_INT_to_RallyLocation`)."""
    if message.command != dialect.MAV_CMD_NAV_RALLY_POINT:
        return int(dialect.MAV_MISSION_UNSUPPORTED), None
    x, y = lat_lon_e7(message)
    if abs(x) > _LAT_MAX:
        return int(dialect.MAV_MISSION_INVALID_PARAM5_X), None
    if abs(y) > _LON_MAX:
        return int(dialect.MAV_MISSION_INVALID_PARAM6_Y), None
    if not _ALT_MIN_M <= message.z <= _ALT_MAX_M:
        return int(dialect.MAV_MISSION_INVALID_PARAM7), None
    if message.frame not in _FRAMES:
        return int(dialect.MAV_MISSION_UNSUPPORTED_FRAME), None
    # 16 bits of whole metres, as ArduPilot stores it
    return _ACCEPTED, Slot(message.command, _FRAMES[message.frame], x=x, y=y, z=float(int(message.z)), causes=causes)


def _begin(craft: Craft, upload: Upload, count: int | None) -> None:
    if count is not None:
        del craft.rally[count:]


def _put(craft: Craft, upload: Upload, message: Any, causes: Causes) -> int:
    if message.seq > min(len(craft.rally), MAX_ITEMS - 1):
        return int(dialect.MAV_MISSION_ERROR)
    result, slot = _slot(message, causes)
    if slot is not None:
        craft.rally[message.seq : message.seq + 1] = [slot]
    return result


def _complete(fleet: Fleet, craft: Craft, upload: Upload, causes: Causes) -> int:
    fleet.note("event.rally", craft, {"items": len(craft.rally)}, causes)
    return _ACCEPTED


def _clear(fleet: Fleet, craft: Craft, causes: Causes) -> bool:
    craft.rally.clear()
    fleet.note("event.rally", craft, {"items": 0}, causes)
    return True


RALLY: Final = plain_kind(_NUMBER, MAX_ITEMS, "Rally", lambda craft: craft.rally, _begin, _put, _complete, _clear)
