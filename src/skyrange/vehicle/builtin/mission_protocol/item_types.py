"""Item types of the mission protocol: the interface that missions, fences and rally points each fill in.

ArduPilot's `MissionItemProtocol` is the base class of three classes with these methods (libraries/GCS_MAVLink).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionItem, Upload, Vehicle

Peer = tuple[int, int]
"""System id and component id of the other side."""


_INVALID_DEG = 200.0  # degrees


class EncodeItem(Protocol):
    """A function that makes a message of a stored item."""

    def __call__(self, fleet: Fleet, vehicle: Vehicle, seq: int, peer: Peer, *, whole: bool) -> Any:
        """The item number `seq` as MISSION_ITEM_INT (`whole`) or MISSION_ITEM; `None` for an unknown number."""
        ...


class ItemType(NamedTuple):
    """One MAV_MISSION_TYPE. Results are MAV_MISSION_RESULTs."""

    mission_type: int
    max_items: int
    """Maximum number of items."""
    timeout_text: str
    """Text sent when an upload is abandoned."""
    items: Callable[[Vehicle], list[MissionItem]]
    """Return the stored items."""
    begin_upload: Callable[[Vehicle, Upload, int | None], None]
    """Start an upload of so many items, or (`None`) of a part of the present ones."""
    store_item: Callable[[Vehicle, Upload, Any, Causes], int]
    """Store one item of an upload."""
    complete_upload: Callable[[Fleet, Vehicle, Upload, Causes], int]
    """Finish an upload whose items have all arrived."""
    abandon_upload: Callable[[Fleet, Vehicle], None]
    """Process an abandoned upload."""
    encode_item: EncodeItem
    """Return one item as MISSION_ITEM_INT (`whole`) or MISSION_ITEM; `None` for an unknown number."""
    clear_items: Callable[[Fleet, Vehicle, Causes], bool]
    """Remove all items; `False` where that is refused."""


def simple_item_type(
    number: int,
    *,
    most: int,
    name: str,
    items: Callable[[Vehicle], list[MissionItem]],
    begin_upload: Callable[[Vehicle, Upload, int | None], None],
    store_item: Callable[[Vehicle, Upload, Any, Causes], int],
    complete_upload: Callable[[Fleet, Vehicle, Upload, Causes], int],
    clear_items: Callable[[Fleet, Vehicle, Causes], bool],
) -> ItemType:
    """Return an item type whose items have one parameter and whose abandoned uploads need no action."""

    def message(fleet: Fleet, vehicle: Vehicle, seq: int, peer: Peer, *, whole: bool) -> Any:
        slots = items(vehicle)
        return _encode_simple_item(number, slots[seq], seq, peer, whole=whole) if seq < len(slots) else None

    def stopped(fleet: Fleet, vehicle: Vehicle) -> None:
        pass

    return ItemType(
        number,
        most,
        f"{name} upload timeout",
        items,
        begin_upload,
        store_item,
        complete_upload,
        stopped,
        message,
        clear_items,
    )


def _encode_simple_item(kind: int, slot: MissionItem, seq: int, peer: Peer, *, whole: bool) -> Any:
    """Return a stored item as MISSION_ITEM_INT (`whole`) or MISSION_ITEM; param1 is its only parameter."""
    head = (*peer, seq, slot.frame, slot.command, 0, 0, slot.param1, 0.0, 0.0, 0.0)
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
