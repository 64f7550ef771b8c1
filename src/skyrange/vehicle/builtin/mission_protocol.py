"""How do missions get in and out? The server side of https://mavlink.io/en/services/mission.html, as ArduPilot does it.

After libraries/GCS_MAVLink/MissionItemProtocol.cpp, with what it does beyond or beside the standard: items are
asked for with MISSION_REQUEST (ground stations answer with MISSION_ITEM_INT), they are stored as they come (a
failed upload leaves the first part), a request is repeated after 1 s and given up after 8 s, and while one ground
station uploads, another is denied.
"""

from __future__ import annotations

from typing import Any

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin import navigator
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, MissionState, Timer, Upload
from skyrange.vehicle.builtin.item_kinds import JUMP
from skyrange.vehicle.builtin.mission_items import ACCEPTED, item_message, slot_of
from skyrange.vehicle.builtin.modes import Mode

MAX_ITEMS = 650
"""Items that fit with home: (2422 + 2132 + 5204 − 4) / 15 bytes of ArduCopter's 16 KiB storage
(StorageManager.cpp, 15 areas; AP_Mission's AP_MISSION_EEPROM_COMMAND_SIZE)."""
RETRY_NS = NS_PER_S
GIVE_UP_NS = 8 * NS_PER_S
_MISSION = dialect.MAV_MISSION_TYPE_MISSION
_ALL = dialect.MAV_MISSION_TYPE_ALL

Partner = tuple[int, int]


def _ack(fleet: Fleet, craft: Craft, partner: Partner, result: int, kind: int = _MISSION, causes: Causes = ()) -> None:
    fleet.send(craft, dialect.MAVLink_mission_ack_message(*partner, result, kind), causes)


def _foreign(fleet: Fleet, craft: Craft, message: Any, partner: Partner) -> bool:
    """Whether the message is about fence or rally points, which are not kept here; says so."""
    if message.mission_type == _MISSION:
        return False
    _ack(fleet, craft, partner, dialect.MAV_MISSION_UNSUPPORTED, message.mission_type)
    return True


def _busy(fleet: Fleet, craft: Craft, partner: Partner) -> bool:
    """Whether an upload is under way, which a download or partial write must not disturb; says so."""
    if craft.upload.active:
        _ack(fleet, craft, partner, dialect.MAV_MISSION_DENIED)
    return craft.upload.active


def _cancel(fleet: Fleet, craft: Craft, partner: Partner) -> bool:
    """End a running upload if it is the partner's own; `False` and a denial where it is another's."""
    if craft.upload.active and craft.upload.partner != partner:
        _ack(fleet, craft, partner, dialect.MAV_MISSION_DENIED)
        return False
    _end(fleet, craft)
    return True


def _end(fleet: Fleet, craft: Craft) -> None:
    craft.upload = Upload()
    fleet.timer(craft, Timer.UPLOAD)


def _request(fleet: Fleet, craft: Craft) -> None:
    """Ask for the item that is due."""
    upload = craft.upload
    fleet.send(craft, dialect.MAVLink_mission_request_message(*upload.partner, upload.next, _MISSION))
    fleet.timer(craft, Timer.UPLOAD, fleet.now + RETRY_NS)


def _open(fleet: Fleet, craft: Craft, partner: Partner, first: int, last: int) -> None:
    craft.upload = Upload(True, first, last, partner, fleet.now)
    _request(fleet, craft)


def on_count(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_COUNT: a new mission is coming. What lies beyond its end goes at once."""
    if _foreign(fleet, craft, message, partner) or not _cancel(fleet, craft, partner):
        return
    if message.count > MAX_ITEMS:
        _ack(fleet, craft, partner, dialect.MAV_MISSION_NO_SPACE)
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, f"Only {MAX_ITEMS} items are supported")
        return
    del craft.mission[message.count :]
    if message.count == 0:
        _complete(fleet, craft, partner, causes)
    else:
        _open(fleet, craft, partner, 0, message.count - 1)


def on_write_partial(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_WRITE_PARTIAL_LIST: items from start to end are coming, the rest stays."""
    if _foreign(fleet, craft, message, partner) or _busy(fleet, craft, partner):
        return
    count = len(craft.mission)
    if not 0 <= message.start_index <= message.end_index <= count:
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, "Flight plan update rejected")
        _ack(fleet, craft, partner, dialect.MAV_MISSION_ERROR)
        return
    _open(fleet, craft, partner, message.start_index, message.end_index)


def on_item(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_ITEM_INT or MISSION_ITEM: the item asked for, or a guided waypoint of the old kind (not supported)."""
    upload = craft.upload
    if _foreign(fleet, craft, message, partner):
        return
    if not upload.active:
        if message.current in (2, 3):  # the old way to send a guided target: SET_POSITION_TARGET_… is the new
            _ack(fleet, craft, partner, dialect.MAV_MISSION_UNSUPPORTED)
        else:
            _ack(fleet, craft, partner, dialect.MAV_MISSION_ERROR)
        return
    if message.seq != upload.next:
        _ack(fleet, craft, partner, dialect.MAV_MISSION_INVALID_SEQUENCE)
        return
    if partner != upload.partner:
        _ack(fleet, craft, partner, dialect.MAV_MISSION_DENIED)
        return
    result = _store(craft, message, causes)
    if result != ACCEPTED:
        _end(fleet, craft)
        _ack(fleet, craft, partner, result)
        return
    upload.received_ns = fleet.now
    upload.next += 1
    if upload.next > upload.last:
        _complete(fleet, craft, partner, causes)
    else:
        _request(fleet, craft)


def _store(craft: Craft, message: Any, causes: Causes) -> int:
    """Put an item in its place, replacing or appending; the result code."""
    result, slot = slot_of(message, causes)
    if slot is None:
        return result
    count = len(craft.mission)
    if slot.command == JUMP:
        target = int(slot.param1)
        if target == 0 or (target >= count and target > craft.upload.last):
            return int(dialect.MAV_MISSION_ERROR)
    if message.seq < count:
        craft.mission[message.seq] = slot
    elif message.seq == count:
        craft.mission.append(slot)
    else:
        return int(dialect.MAV_MISSION_ERROR)
    return result


def _complete(fleet: Fleet, craft: Craft, partner: Partner, causes: Causes) -> None:
    """The mission is whole: say so, and let AUTO know."""
    _end(fleet, craft)
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, "Flight plan received")
    _ack(fleet, craft, partner, ACCEPTED, causes=causes)
    fleet.note("event.mission", craft, {"items": len(craft.mission)}, causes)
    navigator.changed(fleet, craft)


def on_request_list(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_REQUEST_LIST: how many items there are."""
    if _foreign(fleet, craft, message, partner) or _busy(fleet, craft, partner):
        return
    fleet.send(craft, dialect.MAVLink_mission_count_message(*partner, len(craft.mission), _MISSION))


def on_request(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_REQUEST_INT or MISSION_REQUEST: one item. Home can always be read; beyond the end the count is told."""
    if _foreign(fleet, craft, message, partner) or _busy(fleet, craft, partner):
        return
    whole = message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT
    if message.seq != 0 and message.seq >= len(craft.mission):
        if whole:
            fleet.send(craft, dialect.MAVLink_mission_count_message(*partner, len(craft.mission), _MISSION))
        _ack(fleet, craft, partner, dialect.MAV_MISSION_INVALID_SEQUENCE)
        return
    fleet.send(craft, item_message(fleet, craft, message.seq, partner, whole))


def on_clear_all(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_CLEAR_ALL: no mission. Armed, one that runs is kept (AP_Mission::clear)."""
    if message.mission_type != _ALL and _foreign(fleet, craft, message, partner):
        return
    if not _cancel(fleet, craft, partner):
        return
    if fleet.armed(craft) and craft.mission_state == MissionState.ACTIVE:
        _ack(fleet, craft, partner, dialect.MAV_MISSION_ERROR, message.mission_type)
        return
    craft.mission.clear()
    navigator.changed(fleet, craft)
    navigator.reset(craft)
    craft.mission_state = MissionState.NONE
    _ack(fleet, craft, partner, ACCEPTED, message.mission_type, causes)
    fleet.note("event.mission", craft, {"items": 0}, causes)


def on_set_current(fleet: Fleet, craft: Craft, message: Any, partner: Partner, causes: Causes) -> None:
    """MISSION_SET_CURRENT: success answers with MISSION_CURRENT of exactly that number, failure with nothing."""
    if navigator.set_current(fleet, craft, message.seq):
        fleet.send(craft, current_message(craft, message.seq), causes)


def current_message(craft: Craft, seq: int | None = None) -> Any:
    """MISSION_CURRENT; the total excludes home."""
    state = craft.mission_state if craft.sees_mission else MissionState.NONE
    if craft.sees_mission and state == MissionState.NONE:
        state = MissionState.NOT_STARTED
    shown = craft.current if seq is None else seq
    return dialect.MAVLink_mission_current_message(
        shown, max(len(craft.mission) - 1, 0), state, int(craft.mode == Mode.AUTO)
    )


def on_timer(fleet: Fleet, craft: Craft) -> None:
    """An item asked for has not come: ask again, or give up after 8 s."""
    upload = craft.upload
    if not upload.active:
        return
    if fleet.now - upload.received_ns > GIVE_UP_NS:
        partner = upload.partner
        _end(fleet, craft)
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, "Mission upload timeout")
        _ack(fleet, craft, partner, dialect.MAV_MISSION_OPERATION_CANCELLED)
        navigator.changed(fleet, craft)
    else:
        _request(fleet, craft)
