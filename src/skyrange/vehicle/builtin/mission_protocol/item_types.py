"""Item types of the mission protocol: the interface that missions, fences and rally points each fill in.

ArduPilot's `MissionItemProtocol` is the base class of three classes with these methods (libraries/GCS_MAVLink).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Slot, Upload

Partner = tuple[int, int]
"""System id and component id of the other side."""


_INVALID_DEG = 200.0  # degrees


class ItemKind(NamedTuple):
    """One MAV_MISSION_TYPE. Results are MAV_MISSION_RESULTs."""

    number: int
    most: int
    """Maximum number of items."""
    timeout: str
    """Text sent when an upload is abandoned."""
    items: Callable[[Craft], list[Slot]]
    """Return the stored items."""
    begin: Callable[[Craft, Upload, int | None], None]
    """Start an upload of so many items, or (`None`) of a part of the present ones."""
    put: Callable[[Craft, Upload, Any, Causes], int]
    """Store one item of an upload."""
    complete: Callable[[Fleet, Craft, Upload, Causes], int]
    """Finish an upload whose items have all arrived."""
    stopped: Callable[[Fleet, Craft], None]
    """Process an abandoned upload."""
    message: Callable[[Fleet, Craft, int, Partner, bool], Any]
    """Return one item as MISSION_ITEM_INT (`True`) or MISSION_ITEM; `None` for an unknown number."""
    clear: Callable[[Fleet, Craft, Causes], bool]
    """Remove all items; `False` where that is refused."""


def plain_kind(
    number: int,
    most: int,
    name: str,
    items: Callable[[Craft], list[Slot]],
    begin: Callable[[Craft, Upload, int | None], None],
    put: Callable[[Craft, Upload, Any, Causes], int],
    complete: Callable[[Fleet, Craft, Upload, Causes], int],
    clear: Callable[[Fleet, Craft, Causes], bool],
) -> ItemKind:
    """Return an item type whose items have one parameter and whose abandoned uploads need no action."""

    def message(fleet: Fleet, craft: Craft, seq: int, partner: Partner, whole: bool) -> Any:
        slots = items(craft)
        return _encode_simple_item(number, slots[seq], seq, partner, whole) if seq < len(slots) else None

    def stopped(fleet: Fleet, craft: Craft) -> None:
        pass

    return ItemKind(number, most, f"{name} upload timeout", items, begin, put, complete, stopped, message, clear)


def _encode_simple_item(kind: int, slot: Slot, seq: int, partner: Partner, whole: bool) -> Any:
    """Return a stored item as MISSION_ITEM_INT (`whole`) or MISSION_ITEM; param1 is its only parameter."""
    head = (*partner, seq, slot.frame, slot.command, 0, 0, slot.param1, 0.0, 0.0, 0.0)
    if whole:
        return dialect.MAVLink_mission_item_int_message(*head, slot.x, slot.y, slot.z, kind)
    return dialect.MAVLink_mission_item_message(*head, slot.x * 1e-7, slot.y * 1e-7, slot.z, kind)


def lat_lon_e7(message: Any) -> tuple[int, int]:
    """Return latitude and longitude of an item in 1e-7 degrees; out of range where they are not numbers."""
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT:
        return message.x, message.y
    lat, lon = (
        value if math.isfinite(value) and abs(value) < _INVALID_DEG else _INVALID_DEG
        for value in (message.x, message.y)
    )
    return round(lat * 1e7), round(lon * 1e7)
