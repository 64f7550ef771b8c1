"""Server side of the mission protocol, for missions, fences and rally points, as in ArduPilot.

After libraries/GCS_MAVLink/MissionItemProtocol.cpp, beyond or unlike https://mavlink.io/en/services/mission.html:
items are requested with MISSION_REQUEST (ground stations answer with MISSION_ITEM_INT), those of a mission are stored
as they arrive (a failed upload leaves its first part), a request is repeated after 1 s and abandoned after 8 s, and
while one ground station uploads, another is denied. Each item type defines what its items mean (`item_types`).
"""

from __future__ import annotations

from typing import Any

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NEVER, NS_PER_S
from skyrange.vehicle.builtin import navigator, old_items
from skyrange.vehicle.builtin.fence_items import FENCE
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, MissionState, Timer, Upload
from skyrange.vehicle.builtin.mission_items import ACCEPTED, item_message, slot_of
from skyrange.vehicle.builtin.mission_kinds import JUMP
from skyrange.vehicle.builtin.rally_items import RALLY
from skyrange.vehicle.builtin.telemetry import table
from skyrange.vehicle.builtin.transfer_kinds import ItemKind, Partner

MAX_ITEMS = 650
"""Items that fit with home: (2422 + 2132 + 5204 − 4) / 15 bytes of ArduCopter's 16 KiB storage
(StorageManager.cpp, 15 areas; AP_Mission's AP_MISSION_EEPROM_COMMAND_SIZE)."""
RETRY_NS = NS_PER_S
GIVE_UP_NS = 8 * NS_PER_S


def _begin_mission(craft: Craft, upload: Upload, count: int | None) -> None:
    if count is not None:
        del craft.mission[count:]


def _store_item(craft: Craft, upload: Upload, message: Any, causes: Causes) -> int:
    """Store an item at its place, replacing or appending; return the result code."""
    result, slot = slot_of(message, causes)
    if slot is None:
        return result
    count = len(craft.mission)
    if slot.command == JUMP:
        target = int(slot.param1)
        if target == 0 or (target >= count and target > upload.last):
            return int(dialect.MAV_MISSION_ERROR)
    if message.seq < count:
        craft.mission[message.seq] = slot
    elif message.seq == count:
        craft.mission.append(slot)
    else:
        return int(dialect.MAV_MISSION_ERROR)
    return result


def _complete_mission(fleet: Fleet, craft: Craft, upload: Upload, causes: Causes) -> int:
    """Report that the mission is complete, and inform AUTO."""
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, "Flight plan received")
    fleet.note("event.mission", craft, {"items": len(craft.mission)}, causes)
    navigator.changed(fleet, craft)
    return int(ACCEPTED)


def _clear_mission(fleet: Fleet, craft: Craft, causes: Causes) -> bool:
    """Remove the mission. While armed, a running mission is kept (AP_Mission::clear)."""
    if fleet.armed(craft) and craft.mission_state == MissionState.ACTIVE:
        return False
    craft.mission.clear()
    navigator.changed(fleet, craft)
    navigator.reset(craft)
    craft.mission_state = MissionState.NONE
    fleet.note("event.mission", craft, {"items": 0}, causes)
    return True


def _mission_message(fleet: Fleet, craft: Craft, seq: int, partner: Partner, whole: bool) -> Any:
    """Return one item as a message; home can always be read."""
    return item_message(fleet, craft, seq, partner, whole) if seq == 0 or seq < len(craft.mission) else None


_MISSION = ItemKind(
    number=dialect.MAV_MISSION_TYPE_MISSION,
    most=MAX_ITEMS,
    timeout="Mission upload timeout",
    items=lambda craft: craft.mission,
    begin=_begin_mission,
    put=_store_item,
    complete=_complete_mission,
    stopped=navigator.changed,
    message=_mission_message,
    clear=_clear_mission,
)
KINDS = {kind.number: kind for kind in (_MISSION, FENCE, RALLY)}
"""Item types by MAV_MISSION_TYPE."""


def _send_ack(fleet: Fleet, craft: Craft, partner: Partner, result: int, kind: int, causes: Causes = ()) -> None:
    fleet.send(craft, dialect.MAVLink_mission_ack_message(*partner, result, kind), causes)


def _item_type(fleet: Fleet, craft: Craft, message: Any, partner: Partner) -> ItemKind | None:
    """Return the item type that a message is about; refuse an unknown one."""
    kind = KINDS.get(message.mission_type)
    if kind is None:
        _send_ack(fleet, craft, partner, dialect.MAV_MISSION_UNSUPPORTED, message.mission_type)
    return kind


def _deny_during_upload(fleet: Fleet, craft: Craft, partner: Partner, kind: ItemKind) -> bool:
    """Whether an upload is in progress, which a download or partial write must not disturb; refuse the request then."""
    busy = craft.uploads[kind.number].active
    if busy:
        _send_ack(fleet, craft, partner, dialect.MAV_MISSION_DENIED, kind.number)
    return busy


def _cancel_upload(fleet: Fleet, craft: Craft, partner: Partner, kind: ItemKind) -> bool:
    """End the peer's own upload; `False` and a denial where another peer is uploading."""
    upload = craft.uploads[kind.number]
    if upload.active and upload.partner != partner:
        _send_ack(fleet, craft, partner, dialect.MAV_MISSION_DENIED, kind.number)
        return False
    _end_upload(fleet, craft, kind)
    return True


def _end_upload(fleet: Fleet, craft: Craft, kind: ItemKind) -> None:
    craft.uploads[kind.number] = Upload()
    _set_retry_timer(fleet, craft)


def _set_retry_timer(fleet: Fleet, craft: Craft) -> None:
    """Set the timer to when the first requested item is overdue."""
    due = (upload.asked_ns + RETRY_NS for upload in craft.uploads if upload.active)
    fleet.timer(craft, Timer.UPLOAD, min(due, default=NEVER))


def _request_item(fleet: Fleet, craft: Craft, kind: ItemKind) -> None:
    """Request the next item."""
    upload = craft.uploads[kind.number]
    fleet.send(craft, dialect.MAVLink_mission_request_message(*upload.partner, upload.next, kind.number))
    upload.asked_ns = fleet.now
    _set_retry_timer(fleet, craft)


def _start_upload(
    fleet: Fleet, craft: Craft, partner: Partner, kind: ItemKind, span: tuple[int, int], whole: bool
) -> None:
    """Start to request the items of a span (first, last)."""
    upload = Upload(True, span[0], span[1], partner, fleet.now)
    craft.warned -= {(kind.number, old) for old in old_items.WARNINGS}
    craft.uploads[kind.number] = upload
    kind.begin(craft, upload, span[1] + 1 if whole else None)
    _request_item(fleet, craft, kind)


def on_count(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_COUNT: start an upload. Items of a mission or rally points beyond its end are removed at once."""
    kind = _item_type(fleet, craft, message, partner)
    if kind is None or not _cancel_upload(fleet, craft, partner, kind):
        return
    if message.count > kind.most:
        _send_ack(fleet, craft, partner, dialect.MAV_MISSION_NO_SPACE, kind.number)
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, f"Only {kind.most} items are supported")
    elif message.count == 0:
        kind.begin(craft, craft.uploads[kind.number], 0)
        _complete_upload(fleet, craft, partner, kind, causes)
    else:
        _start_upload(fleet, craft, partner, kind, (0, message.count - 1), True)


def on_write_partial(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_WRITE_PARTIAL_LIST: start an upload of the items from start to end; the rest stays."""
    kind = _item_type(fleet, craft, message, partner)
    if kind is None or _deny_during_upload(fleet, craft, partner, kind):
        return
    if not 0 <= message.start_index <= message.end_index <= len(kind.items(craft)):
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, "Flight plan update rejected")
        _send_ack(fleet, craft, partner, dialect.MAV_MISSION_ERROR, kind.number)
        return
    _start_upload(fleet, craft, partner, kind, (message.start_index, message.end_index), False)


def on_item(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_ITEM_INT or MISSION_ITEM: the requested item, or a guided target of the deprecated kind."""
    old = message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ITEM
    bad = old_items.bad_place(message) if old else None
    if bad is not None:  # it cannot be converted to MISSION_ITEM_INT: the upload continues without it
        _send_ack(fleet, craft, partner, bad, message.mission_type)
        return
    if message.mission_type == dialect.MAV_MISSION_TYPE_MISSION and message.current in old_items.MARKS:
        _send_ack(fleet, craft, partner, old_items.obey(fleet, craft, message, causes), message.mission_type)
        return
    kind = _item_type(fleet, craft, message, partner)
    if kind is None:
        return
    if old:
        old_items.warn(fleet, craft, message, kind.number)
    upload = craft.uploads[kind.number]
    if not upload.active:
        _send_ack(fleet, craft, partner, dialect.MAV_MISSION_ERROR, kind.number)
        return
    if message.seq != upload.next:
        _send_ack(fleet, craft, partner, dialect.MAV_MISSION_INVALID_SEQUENCE, kind.number)
        return
    if partner != upload.partner:
        _send_ack(fleet, craft, partner, dialect.MAV_MISSION_DENIED, kind.number)
        return
    result = kind.put(craft, upload, message, causes)
    if result != ACCEPTED:
        _end_upload(fleet, craft, kind)
        _send_ack(fleet, craft, partner, result, kind.number)
        return
    upload.received_ns = fleet.now
    upload.next += 1
    if upload.next > upload.last:
        _complete_upload(fleet, craft, partner, kind, causes)
    else:
        _request_item(fleet, craft, kind)


def _complete_upload(fleet: Fleet, craft: Craft, partner: Partner, kind: ItemKind, causes: Causes) -> None:
    """Finish an upload whose items have all arrived."""
    upload = craft.uploads[kind.number]
    _end_upload(fleet, craft, kind)
    result = kind.complete(fleet, craft, upload, causes)
    _send_ack(fleet, craft, partner, result, kind.number, causes)


def on_request_list(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_REQUEST_LIST: answer with the number of items."""
    kind = _item_type(fleet, craft, message, partner)
    if kind is not None and not _deny_during_upload(fleet, craft, partner, kind):
        count = len(kind.items(craft))
        fleet.send(craft, dialect.MAVLink_mission_count_message(*partner, count, kind.number))


def on_request(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_REQUEST_INT or MISSION_REQUEST: send one item, or the count for a number beyond the end."""
    kind = KINDS.get(message.mission_type)  # an unknown type gets no answer
    if kind is None or _deny_during_upload(fleet, craft, partner, kind):
        return
    whole = message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT
    item = kind.message(fleet, craft, message.seq, partner, whole)
    if item is None:
        if whole:
            count = len(kind.items(craft))
            fleet.send(craft, dialect.MAVLink_mission_count_message(*partner, count, kind.number))
        _send_ack(fleet, craft, partner, dialect.MAV_MISSION_INVALID_SEQUENCE, kind.number)
        return
    if not whole:
        old_items.warn(fleet, craft, message, kind.number)
    fleet.send(craft, item)


def on_clear_all(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_CLEAR_ALL: remove all items of one type; MAV_MISSION_TYPE_ALL is refused, as by ArduPilot."""
    kind = _item_type(fleet, craft, message, partner)
    if kind is None:
        return
    mine = _cancel_upload(fleet, craft, partner, kind)  # during another peer's upload: a denial, then an error
    result = ACCEPTED if mine and kind.clear(fleet, craft, causes) else dialect.MAV_MISSION_ERROR
    _send_ack(fleet, craft, partner, result, kind.number, causes)


def on_set_current(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_SET_CURRENT: answer success with MISSION_CURRENT of that number, failure with nothing."""
    if navigator.set_current(fleet, craft, message.seq):
        told = table.message(fleet, craft, dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
        assert told is not None
        told.seq = message.seq
        fleet.send(craft, told, causes)


def on_timer(fleet: Fleet, craft: Craft) -> None:
    """Request overdue items again, or abandon the upload after 8 s."""
    for kind in KINDS.values():
        upload = craft.uploads[kind.number]
        if not upload.active or fleet.now - upload.asked_ns < RETRY_NS:
            continue
        if fleet.now - upload.received_ns > GIVE_UP_NS:
            _end_upload(fleet, craft, kind)
            fleet.text(craft, dialect.MAV_SEVERITY_WARNING, kind.timeout)
            _send_ack(fleet, craft, upload.partner, dialect.MAV_MISSION_OPERATION_CANCELLED, kind.number)
            kind.stopped(fleet, craft)
        else:
            _request_item(fleet, craft, kind)
    _set_retry_timer(fleet, craft)
