"""What does the mission protocol have to know of a kind of item? Missions, fences and rally points each fill this in.

ArduPilot's `MissionItemProtocol` is the base of three classes with these very questions (libraries/GCS_MAVLink).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Slot, Upload

Partner = tuple[int, int]
"""System and component of who is spoken to."""


_BEYOND = 200.0  # degrees


class ItemKind(NamedTuple):
    """One MAV_MISSION_TYPE. Results are MAV_MISSION_RESULTs."""

    number: int
    most: int
    """Items that fit."""
    timeout: str
    """What is said when an upload is given up."""
    items: Callable[[Craft], list[Slot]]
    """What is stored."""
    begin: Callable[[Craft, Upload, int | None], None]
    """An upload of so many items starts, or (`None`) one of a part of those that there are."""
    put: Callable[[Craft, Upload, Any, Causes], int]
    """Take one item of it."""
    complete: Callable[[Fleet, Craft, Upload, Causes], int]
    """All are there."""
    stopped: Callable[[Fleet, Craft], None]
    """An upload was given up."""
    message: Callable[[Fleet, Craft, int, Partner, bool], Any]
    """One item as MISSION_ITEM_INT (`True`) or MISSION_ITEM; `None` where there is none of that number."""
    clear: Callable[[Fleet, Craft, Causes], bool]
    """Forget all; `False` where that is refused."""


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
    """A kind whose items have one parameter, and where an upload that was given up leaves nothing to be done."""

    def message(fleet: Fleet, craft: Craft, seq: int, partner: Partner, whole: bool) -> Any:
        slots = items(craft)
        return _plain_message(number, slots[seq], seq, partner, whole) if seq < len(slots) else None

    def stopped(fleet: Fleet, craft: Craft) -> None:
        pass

    return ItemKind(number, most, f"{name} upload timeout", items, begin, put, complete, stopped, message, clear)


def _plain_message(kind: int, slot: Slot, seq: int, partner: Partner, whole: bool) -> Any:
    """A stored item as MISSION_ITEM_INT (`whole`) or MISSION_ITEM; param1 is its only parameter."""
    head = (*partner, seq, slot.frame, slot.command, 0, 0, slot.param1, 0.0, 0.0, 0.0)
    if whole:
        return dialect.MAVLink_mission_item_int_message(*head, slot.x, slot.y, slot.z, kind)
    return dialect.MAVLink_mission_item_message(*head, slot.x * 1e-7, slot.y * 1e-7, slot.z, kind)


def lat_lon_e7(message: Any) -> tuple[int, int]:
    """Latitude and longitude of an item in 1e-7 degrees; beyond any place on Earth where they are not numbers."""
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT:
        return message.x, message.y
    lat, lon = (value if math.isfinite(value) and abs(value) < _BEYOND else _BEYOND for value in (message.x, message.y))
    return round(lat * 1e7), round(lon * 1e7)
