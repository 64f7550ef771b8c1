"""The files of @MISSION/: missions, fences and rally points; who writes one replaces what is stored.

After libraries/AP_Filesystem/AP_Filesystem_Mission.cpp of ArduPilot 4.6. A mission is stored item by item up to one
that is refused, also while it is flown; an upload is answered by no MISSION_ACK.
"""

from __future__ import annotations

import errno
from typing import Any

from skyrange.codec.ardupilot_files import missions as packed
from skyrange.codec.mavlink import dialect
from skyrange.core.errors import DecodeError
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Upload, Vehicle
from skyrange.vehicle.builtin.memory_card import fail
from skyrange.vehicle.builtin.mission.command_ids import DO_JUMP
from skyrange.vehicle.builtin.mission.items import ACCEPTED, decode_item
from skyrange.vehicle.builtin.mission_protocol import server

STATED_SIZE = 1 << 20
"""The size that is told when one is opened: a fixed one."""
MAX_UPLOAD_BYTES = 1 << 16
"""Assumed: what the memory of a flight controller takes; 650 items need 24,710 bytes."""


def mission_type(name: str) -> int:
    """The MAV_MISSION_TYPE of a name behind @MISSION/. Raises `OSError` for another file."""
    if name not in packed.TYPES:
        raise fail(errno.ENOENT)
    return packed.TYPES[name]


def pack(fleet: Fleet, vehicle: Vehicle, kind: int) -> bytes:
    """The file of a MAV_MISSION_TYPE."""
    items = server.ITEM_TYPES[kind]
    count = len(items.items(vehicle))
    return packed.pack([items.encode_item(fleet, vehicle, seq, (0, 0), whole=True) for seq in range(count)], kind)


def apply(fleet: Fleet, vehicle: Vehicle, kind: int, data: bytes, causes: Causes) -> None:
    """Store the items of an upload. Raises `OSError` for what is malformed or refused."""
    try:
        upload = packed.read(data, kind)
    except DecodeError as error:
        raise fail(errno.EINVAL) from error
    if kind == dialect.MAV_MISSION_TYPE_MISSION:
        done = _store_mission(fleet, vehicle, upload, causes)
    else:
        done = not upload.options & packed.NO_CLEAR and _store_whole(fleet, vehicle, kind, upload.items, causes)
    if not done:
        raise fail(errno.EINVAL)


def _store_mission(fleet: Fleet, vehicle: Vehicle, upload: packed.MissionUpload, causes: Causes) -> bool:
    """Store the items of a mission up to one that is refused (`finish_upload_mission`); whether all were stored."""
    if not upload.options & packed.NO_CLEAR:
        server.clear_mission(fleet, vehicle, causes)  # one that is flown stays, and its items are replaced
    stored = 0
    for number, message in enumerate(upload.items, upload.start):
        result, item = decode_item(message, causes)
        count = len(vehicle.mission)
        if result != ACCEPTED or item is None or number > count or number >= server.MAX_ITEMS:
            break
        if item.command == DO_JUMP and not 0 < item.param1 < len(upload.items):
            break
        vehicle.mission[number : number + 1] = [item]
        stored += 1
    if stored:
        server.report_mission(fleet, vehicle, causes)
    return stored == len(upload.items)


def _store_whole(fleet: Fleet, vehicle: Vehicle, kind: int, messages: list[Any], causes: Causes) -> bool:
    """Store a fence or rally points; whether they were accepted."""
    items = server.ITEM_TYPES[kind]
    if len(messages) > items.max_items:
        return False
    upload = Upload()
    items.begin_upload(vehicle, upload, 0)  # rally points are removed first, a fence once it is complete
    items.begin_upload(vehicle, upload, len(messages))
    for seq, message in enumerate(messages):
        message.seq = seq
        if items.store_item(vehicle, upload, message, causes) != ACCEPTED:
            return False
    return bool(items.complete_upload(fleet, vehicle, upload, causes) == ACCEPTED)
