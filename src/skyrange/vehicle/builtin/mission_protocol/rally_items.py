"""Rally points of the mission protocol: their conversion and storage.

After libraries/GCS_MAVLink/MissionItemProtocol_Rally.cpp.
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionItem, Upload, Vehicle, all_causes
from skyrange.vehicle.builtin.locations import ABOVE_HOME, ABSOLUTE, MAX_ITEMS
from skyrange.vehicle.builtin.mission_protocol.item_types import lat_lon_e7, simple_item_type

_NUMBER = dialect.MAV_MISSION_TYPE_RALLY
_ACCEPTED = int(dialect.MAV_MISSION_ACCEPTED)
_LAT_MAX, _LON_MAX = 900_000_000, 1_800_000_000
_ALT_MIN_M, _ALT_MAX_M = -32_768, 32_767
_ABOVE_TERRAIN = dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT
_FRAMES = {
    dialect.MAV_FRAME_GLOBAL: ABSOLUTE,
    dialect.MAV_FRAME_GLOBAL_INT: ABSOLUTE,
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT: ABOVE_HOME,
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: ABOVE_HOME,
    dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT: _ABOVE_TERRAIN,
    dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: _ABOVE_TERRAIN,
}
"""The frame in which a point is stored, by the frame of its item."""


def _decode_item(message: Any, causes: Causes) -> tuple[int, MissionItem | None]:
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
    return _ACCEPTED, MissionItem(
        message.command, _FRAMES[message.frame], x=x, y=y, z=float(int(message.z)), causes=causes
    )


def _begin_upload(vehicle: Vehicle, upload: Upload, count: int | None) -> None:
    if count is not None:
        del vehicle.rally[count:]


def _store_item(vehicle: Vehicle, upload: Upload, message: Any, causes: Causes) -> int:
    if message.seq > min(len(vehicle.rally), MAX_ITEMS - 1):
        return int(dialect.MAV_MISSION_ERROR)
    result, slot = _decode_item(message, causes)
    if slot is not None:
        vehicle.rally[message.seq : message.seq + 1] = [slot]
    return result


def _complete_upload(fleet: Fleet, vehicle: Vehicle, upload: Upload, causes: Causes) -> int:
    fleet.note("event.rally", vehicle, {"items": len(vehicle.rally)}, all_causes(vehicle.rally, causes))
    return _ACCEPTED


def _clear_points(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> bool:
    vehicle.rally.clear()
    fleet.note("event.rally", vehicle, {"items": 0}, causes)
    return True


RALLY: Final = simple_item_type(
    _NUMBER,
    most=MAX_ITEMS,
    name="Rally",
    items=lambda vehicle: vehicle.rally,
    begin_upload=_begin_upload,
    store_item=_store_item,
    complete_upload=_complete_upload,
    clear_items=_clear_points,
)
