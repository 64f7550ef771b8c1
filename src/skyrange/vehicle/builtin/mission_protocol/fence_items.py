"""Fence items of the mission protocol: their conversion, their validation, and the zones made from them.

After libraries/GCS_MAVLink/MissionItemProtocol_Fence.cpp and AC_PolyFence_loader.cpp `validate_fence`, `write_fence`. A
fence is accepted as a whole or not at all.
"""

from __future__ import annotations

import math
from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionItem, Upload, Vehicle, all_causes
from skyrange.vehicle.builtin.layout import CIRCLE_IN, CIRCLE_OUT, MAX_FENCE_ITEMS, POLYGON_IN, POLYGON_OUT
from skyrange.vehicle.builtin.mission_protocol.item_types import lat_lon_e7, simple_item_type

_NUMBER = dialect.MAV_MISSION_TYPE_FENCE
_ACCEPTED = int(dialect.MAV_MISSION_ACCEPTED)
_POLYGON_INCLUSION = dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
_POLYGON_EXCLUSION = dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
_CIRCLE_INCLUSION = dialect.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
_CIRCLE_EXCLUSION = dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
_RETURN = dialect.MAV_CMD_NAV_FENCE_RETURN_POINT
_ZONE_OF = {
    _POLYGON_INCLUSION: POLYGON_IN,
    _POLYGON_EXCLUSION: POLYGON_OUT,
    _CIRCLE_INCLUSION: CIRCLE_IN,
    _CIRCLE_EXCLUSION: CIRCLE_OUT,
}
_POLYGONS = (_POLYGON_INCLUSION, _POLYGON_EXCLUSION)
_CIRCLES = (_CIRCLE_INCLUSION, _CIRCLE_EXCLUSION)
# AC_PolyFence_loader.h AC_PolyFenceType, as its texts number them
_TYPE_NUMBER = {
    _POLYGON_INCLUSION: 98,
    _POLYGON_EXCLUSION: 97,
    _CIRCLE_EXCLUSION: 93,
    _RETURN: 95,
    _CIRCLE_INCLUSION: 92,
}
_FRAMES = frozenset(
    (
        dialect.MAV_FRAME_GLOBAL,
        dialect.MAV_FRAME_GLOBAL_INT,
        dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT,
        dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
    )
)
_VERTICES_MAX = 255
_VERTICES_MIN = 3
_LAT_MAX, _LON_MAX = 900_000_000, 1_800_000_000
_MAX_STORAGE_BYTES = 560
"""StorageFence of 15 areas: 48 + 256 + 256."""


def _decode_item(message: Any, causes: Causes) -> tuple[int, MissionItem | None]:
    """Return (MAV_MISSION_RESULT, item) of one message (`convert_MISSION_ITEM_INT_to_AC_PolyFenceItem`)."""
    if message.frame not in _FRAMES:
        return int(dialect.MAV_MISSION_UNSUPPORTED_FRAME), None
    if message.command not in _TYPE_NUMBER:
        return int(dialect.MAV_MISSION_UNSUPPORTED), None
    value = message.param1
    if message.command in _POLYGONS:
        if value > _VERTICES_MAX:
            return int(dialect.MAV_MISSION_INVALID_PARAM1), None
        value = float(int(value)) if value >= 0.0 else 0.0  # a count; a value that is not a number counts as 0
    elif message.command == _RETURN:
        value = 0.0
    x, y = lat_lon_e7(message)
    return _ACCEPTED, MissionItem(message.command, dialect.MAV_FRAME_GLOBAL, value, x=x, y=y, causes=causes)


def _begin_upload(vehicle: Vehicle, upload: Upload, count: int | None) -> None:
    upload.items = list(vehicle.fence) if count is None else [None] * count


def _store_item(vehicle: Vehicle, upload: Upload, message: Any, causes: Causes) -> int:
    if message.seq >= len(upload.items):
        return int(dialect.MAV_MISSION_INVALID_SEQUENCE)
    result, slot = _decode_item(message, causes)
    if slot is not None:
        upload.items[message.seq] = slot
    return result


def _validation_error(items: list[MissionItem]) -> str:
    """Return why the items make no valid fence, in ArduPilot's words, or "" (`validate_fence`)."""
    left, of, kind, returns = 0, 0, 0, 0
    for item in items:
        if item.command in _POLYGONS:
            vertices = int(item.param1)
            if vertices < _VERTICES_MIN:
                return f"Invalid vertex count ({vertices})"
            if left == 0:
                left, of, kind = vertices, vertices, item.command
            elif item.command != kind:
                return f"Received incorrect vertex type (want={_TYPE_NUMBER[kind]} got={_TYPE_NUMBER[item.command]})"
            elif vertices != of:
                return f"Unexpected vertex count want={of} got={vertices}"
            left -= 1
        else:
            if left:
                return f"Received incorrect type (want={_TYPE_NUMBER[kind]} got={_TYPE_NUMBER[item.command]})"
            if item.command in _CIRCLES and not item.param1 > 0.0:
                return "Non-positive circle radius"
            returns += item.command == _RETURN
            if returns > 1:
                return "Multiple return points"
        if abs(item.x) > _LAT_MAX or abs(item.y) > _LON_MAX:
            return "Bad lat or lon"
    return "Incorrect item count" if left else ""


def _storage_bytes(items: list[MissionItem]) -> int:
    """Return the bytes that a valid fence takes (`fence_storage_space_required`)."""
    need, place = 4, 0
    while place < len(items):
        item = items[place]
        if item.command in _POLYGONS:
            need += 2 + 8 * int(item.param1)
            place += int(item.param1)
        else:
            need += 13 if item.command in _CIRCLES else 9
            place += 1
    return need


def _complete_upload(fleet: Fleet, vehicle: Vehicle, upload: Upload, causes: Causes) -> int:
    items = [item for item in upload.items if item is not None]
    error = _validation_error(items)
    if error:
        severity = dialect.MAV_SEVERITY_INFO if error == "Incorrect item count" else dialect.MAV_SEVERITY_WARNING
        fleet.send_text(vehicle, severity, error, causes)
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, "Fence validation failed", causes)
        return int(dialect.MAV_MISSION_ERROR)
    if _storage_bytes(items) > _MAX_STORAGE_BYTES:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, "Fence exceeds storage size", causes)
        return int(dialect.MAV_MISSION_ERROR)
    _apply_fence(fleet, vehicle, items, causes)
    return _ACCEPTED


def _apply_fence(fleet: Fleet, vehicle: Vehicle, items: list[MissionItem], causes: Causes) -> None:
    """Put a valid fence in force."""
    vehicle.fence = items
    fleet.note("event.fence", vehicle, {"items": len(items)}, all_causes(items, causes))
    zone = fleet.fence_zones[vehicle.row]
    zone["count"] = 0
    zone["min_circle_radius"] = min((item.param1 for item in items if item.command == _CIRCLE_INCLUSION), default=0.0)
    points = 0
    place = 0
    while place < len(items):
        item = items[place]
        size = int(item.param1) if item.command in _POLYGONS else 1
        if item.command in _ZONE_OF:
            number = int(zone["count"])
            zone["kind"][number] = _ZONE_OF[item.command]
            zone["first"][number] = points
            zone["size"][number] = size
            zone["radius"][number] = item.param1 if item.command in _CIRCLES else math.nan
            for vertex in items[place : place + size]:
                zone["point"][points] = fleet.origin.enu_of(vertex.x * 1e-7, vertex.y * 1e-7)
                points += 1
            zone["count"] = number + 1
        place += size


def _clear_fence(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> bool:
    _apply_fence(fleet, vehicle, [], causes)
    return True


FENCE: Final = simple_item_type(
    _NUMBER,
    most=MAX_FENCE_ITEMS,
    name="Fence",
    items=lambda vehicle: vehicle.fence,
    begin_upload=_begin_upload,
    store_item=_store_item,
    complete_upload=_complete_upload,
    clear_items=_clear_fence,
)
