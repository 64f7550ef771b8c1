"""Server side of the mission protocol, for missions, fences and rally points, as in ArduPilot.

After libraries/GCS_MAVLink/MissionItemProtocol.cpp, beyond or unlike https://mavlink.io/en/services/mission.html:
items are requested with MISSION_REQUEST (ground stations answer with MISSION_ITEM_INT), those of a mission are stored
as they arrive (a failed upload leaves its first part), a request is repeated after 1 s and abandoned after 8 s, and
while one ground station uploads, another is denied. Each item type defines what its items mean (`item_types`).

Deprecated messages of the mission protocol: MISSION_ITEM in degrees, MISSION_REQUEST, and items executed at once. After
libraries/GCS_MAVLink/GCS_Common.cpp `handle_mission_item`, MissionItemProtocol.cpp, AP_Mission.cpp
`convert_MISSION_ITEM_to_MISSION_ITEM_INT` and ArduCopter/mode_auto.cpp `do_guided`.
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NEVER, NS_PER_S
from skyrange.vehicle.builtin import locations
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionState, Timer, Upload, Vehicle, all_causes
from skyrange.vehicle.builtin.flight_modes import guided
from skyrange.vehicle.builtin.guidance import auto_yaw
from skyrange.vehicle.builtin.mission import execution
from skyrange.vehicle.builtin.mission.command_ids import CONDITION_YAW, DO_JUMP, NAV_WAYPOINT, STORED_IN_LOCATION
from skyrange.vehicle.builtin.mission.items import ACCEPTED, decode_item, encode_item
from skyrange.vehicle.builtin.mission_protocol.fence_items import FENCE
from skyrange.vehicle.builtin.mission_protocol.item_types import ItemType, Peer
from skyrange.vehicle.builtin.mission_protocol.rally_items import RALLY
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.telemetry import table

MAX_ITEMS = 650
"""Items that fit with home: (2422 + 2132 + 5204 − 4) / 15 bytes of ArduCopter's 16 KiB storage
(StorageManager.cpp, 15 areas; AP_Mission's AP_MISSION_EEPROM_COMMAND_SIZE)."""
RETRY_NS = NS_PER_S
GIVE_UP_NS = 8 * NS_PER_S


def _begin_mission(vehicle: Vehicle, upload: Upload, count: int | None) -> None:
    if count is not None:
        del vehicle.mission[count:]


def _store_item(vehicle: Vehicle, upload: Upload, message: Any, causes: Causes) -> int:
    """Store an item at its place, replacing or appending; return the result code."""
    result, slot = decode_item(message, causes)
    if slot is None:
        return result
    count = len(vehicle.mission)
    if slot.command == DO_JUMP:
        target = int(slot.param1)
        if target == 0 or (target >= count and target > upload.last):
            return int(dialect.MAV_MISSION_ERROR)
    if message.seq < count:
        vehicle.mission[message.seq] = slot
    elif message.seq == count:
        vehicle.mission.append(slot)
    else:
        return int(dialect.MAV_MISSION_ERROR)
    return result


def _complete_mission(fleet: Fleet, vehicle: Vehicle, upload: Upload, causes: Causes) -> int:
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, "Flight plan received")
    report_mission(fleet, vehicle, causes)
    return int(ACCEPTED)


def report_mission(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> None:
    """Record that a mission is complete, and inform AUTO."""
    fleet.note("event.mission", vehicle, {"items": len(vehicle.mission)}, all_causes(vehicle.mission, causes))
    execution.on_mission_changed(fleet, vehicle)


def clear_mission(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> bool:
    """Remove the mission. While armed, a running mission is kept (AP_Mission::clear)."""
    if fleet.armed(vehicle) and vehicle.mission_state == MissionState.ACTIVE:
        return False
    vehicle.mission.clear()
    execution.on_mission_changed(fleet, vehicle)
    execution.reset(vehicle)
    vehicle.mission_state = MissionState.NONE
    fleet.note("event.mission", vehicle, {"items": 0}, causes)
    return True


def _mission_message(fleet: Fleet, vehicle: Vehicle, seq: int, peer: Peer, *, whole: bool) -> Any:
    """Return one item as a message; home can always be read."""
    return encode_item(fleet, vehicle, seq, peer, whole=whole) if seq == 0 or seq < len(vehicle.mission) else None


_MISSION = ItemType(
    mission_type=dialect.MAV_MISSION_TYPE_MISSION,
    max_items=MAX_ITEMS,
    timeout_text="Mission upload timeout",
    items=lambda vehicle: vehicle.mission,
    begin_upload=_begin_mission,
    store_item=_store_item,
    complete_upload=_complete_mission,
    abandon_upload=execution.on_mission_changed,
    encode_item=_mission_message,
    clear_items=clear_mission,
)
ITEM_TYPES = {kind.mission_type: kind for kind in (_MISSION, FENCE, RALLY)}
"""Item types by MAV_MISSION_TYPE."""


def _send_ack(fleet: Fleet, vehicle: Vehicle, peer: Peer, result: int, kind: int, causes: Causes = ()) -> None:
    fleet.send(vehicle, dialect.MAVLink_mission_ack_message(*peer, result, kind), causes)


def _item_type(fleet: Fleet, vehicle: Vehicle, message: Any, peer: Peer) -> ItemType | None:
    """Return the item type that a message is about; refuse an unknown one."""
    kind = ITEM_TYPES.get(message.mission_type)
    if kind is None:
        _send_ack(fleet, vehicle, peer, dialect.MAV_MISSION_UNSUPPORTED, message.mission_type)
    return kind


def _deny_during_upload(fleet: Fleet, vehicle: Vehicle, peer: Peer, kind: ItemType) -> bool:
    """Whether an upload is in progress, which a download or partial write must not disturb; refuse the request then."""
    busy = vehicle.uploads[kind.mission_type].active
    if busy:
        _send_ack(fleet, vehicle, peer, dialect.MAV_MISSION_DENIED, kind.mission_type)
    return busy


def _cancel_upload(fleet: Fleet, vehicle: Vehicle, peer: Peer, kind: ItemType) -> bool:
    """End the peer's own upload; `False` and a denial where another peer is uploading."""
    upload = vehicle.uploads[kind.mission_type]
    if upload.active and upload.peer != peer:
        _send_ack(fleet, vehicle, peer, dialect.MAV_MISSION_DENIED, kind.mission_type)
        return False
    _end_upload(fleet, vehicle, kind)
    return True


def _end_upload(fleet: Fleet, vehicle: Vehicle, kind: ItemType) -> None:
    vehicle.uploads[kind.mission_type] = Upload()
    _set_retry_timer(fleet, vehicle)


def _set_retry_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """Set the timer to when the first requested item is overdue."""
    due = (upload.asked_ns + RETRY_NS for upload in vehicle.uploads if upload.active)
    fleet.set_timer(vehicle, Timer.UPLOAD, min(due, default=NEVER))


def _request_item(fleet: Fleet, vehicle: Vehicle, kind: ItemType) -> None:
    """Request the next item."""
    upload = vehicle.uploads[kind.mission_type]
    fleet.send(vehicle, dialect.MAVLink_mission_request_message(*upload.peer, upload.next, kind.mission_type))
    upload.asked_ns = fleet.now
    _set_retry_timer(fleet, vehicle)


def _start_upload(
    fleet: Fleet, vehicle: Vehicle, peer: Peer, kind: ItemType, span: tuple[int, int], *, whole: bool
) -> None:
    """Start to request the items of a span (first, last)."""
    upload = Upload(active=True, next=span[0], last=span[1], peer=peer, received_ns=fleet.now)
    vehicle.legacy_warned -= {(kind.mission_type, old) for old in WARNING_TEXTS}
    vehicle.uploads[kind.mission_type] = upload
    kind.begin_upload(vehicle, upload, span[1] + 1 if whole else None)
    _request_item(fleet, vehicle, kind)


def on_count(fleet: Fleet, vehicle: Vehicle, message: Any, peer: Peer, causes: Causes) -> None:
    """MISSION_COUNT: start an upload. Items of a mission or rally points beyond its end are removed at once."""
    kind = _item_type(fleet, vehicle, message, peer)
    if kind is None or not _cancel_upload(fleet, vehicle, peer, kind):
        return
    if message.count > kind.max_items:
        _send_ack(fleet, vehicle, peer, dialect.MAV_MISSION_NO_SPACE, kind.mission_type)
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, f"Only {kind.max_items} items are supported")
    elif message.count == 0:
        kind.begin_upload(vehicle, vehicle.uploads[kind.mission_type], 0)
        _complete_upload(fleet, vehicle, peer, kind, causes)
    else:
        _start_upload(fleet, vehicle, peer, kind, (0, message.count - 1), whole=True)


def on_write_partial(fleet: Fleet, vehicle: Vehicle, message: Any, peer: Peer, causes: Causes) -> None:
    """MISSION_WRITE_PARTIAL_LIST: start an upload of the items from start to end; the rest stays."""
    kind = _item_type(fleet, vehicle, message, peer)
    if kind is None or _deny_during_upload(fleet, vehicle, peer, kind):
        return
    if not 0 <= message.start_index <= message.end_index <= len(kind.items(vehicle)):
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, "Flight plan update rejected")
        _send_ack(fleet, vehicle, peer, dialect.MAV_MISSION_ERROR, kind.mission_type)
        return
    _start_upload(fleet, vehicle, peer, kind, (message.start_index, message.end_index), whole=False)


def on_item(fleet: Fleet, vehicle: Vehicle, message: Any, peer: Peer, causes: Causes) -> None:
    """MISSION_ITEM_INT or MISSION_ITEM: the requested item, or a guided target of the deprecated kind."""
    old = message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ITEM
    bad = location_error(message) if old else None
    if bad is not None:  # it cannot be converted to MISSION_ITEM_INT: the upload continues without it
        _send_ack(fleet, vehicle, peer, bad, message.mission_type)
        return
    if message.mission_type == dialect.MAV_MISSION_TYPE_MISSION and message.current in IMMEDIATE_CURRENT:
        _send_ack(
            fleet,
            vehicle,
            peer,
            execute_immediately(fleet, vehicle, message, causes),
            message.mission_type,
        )
        return
    kind = _item_type(fleet, vehicle, message, peer)
    if kind is None:
        return
    if old:
        send_deprecation_text(fleet, vehicle, message, kind.mission_type)
    upload = vehicle.uploads[kind.mission_type]
    if not upload.active:
        _send_ack(fleet, vehicle, peer, dialect.MAV_MISSION_ERROR, kind.mission_type)
        return
    if message.seq != upload.next:
        _send_ack(fleet, vehicle, peer, dialect.MAV_MISSION_INVALID_SEQUENCE, kind.mission_type)
        return
    if peer != upload.peer:
        _send_ack(fleet, vehicle, peer, dialect.MAV_MISSION_DENIED, kind.mission_type)
        return
    result = kind.store_item(vehicle, upload, message, causes)
    if result != ACCEPTED:
        _end_upload(fleet, vehicle, kind)
        _send_ack(fleet, vehicle, peer, result, kind.mission_type)
        return
    upload.received_ns = fleet.now
    upload.next += 1
    if upload.next > upload.last:
        _complete_upload(fleet, vehicle, peer, kind, causes)
    else:
        _request_item(fleet, vehicle, kind)


def _complete_upload(fleet: Fleet, vehicle: Vehicle, peer: Peer, kind: ItemType, causes: Causes) -> None:
    """Finish an upload whose items have all arrived."""
    upload = vehicle.uploads[kind.mission_type]
    _end_upload(fleet, vehicle, kind)
    result = kind.complete_upload(fleet, vehicle, upload, causes)
    _send_ack(fleet, vehicle, peer, result, kind.mission_type, causes)


def on_request_list(fleet: Fleet, vehicle: Vehicle, message: Any, peer: Peer, causes: Causes) -> None:
    """MISSION_REQUEST_LIST: answer with the number of items."""
    kind = _item_type(fleet, vehicle, message, peer)
    if kind is not None and not _deny_during_upload(fleet, vehicle, peer, kind):
        count = len(kind.items(vehicle))
        fleet.send(vehicle, dialect.MAVLink_mission_count_message(*peer, count, kind.mission_type))


def on_request(fleet: Fleet, vehicle: Vehicle, message: Any, peer: Peer, causes: Causes) -> None:
    """MISSION_REQUEST_INT or MISSION_REQUEST: send one item, or the count for a number beyond the end."""
    kind = ITEM_TYPES.get(message.mission_type)  # an unknown type gets no answer
    if kind is None or _deny_during_upload(fleet, vehicle, peer, kind):
        return
    whole = message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT
    item = kind.encode_item(fleet, vehicle, message.seq, peer, whole=whole)
    if item is None:
        if whole:
            count = len(kind.items(vehicle))
            fleet.send(vehicle, dialect.MAVLink_mission_count_message(*peer, count, kind.mission_type))
        _send_ack(fleet, vehicle, peer, dialect.MAV_MISSION_INVALID_SEQUENCE, kind.mission_type)
        return
    if not whole:
        send_deprecation_text(fleet, vehicle, message, kind.mission_type)
    fleet.send(vehicle, item)


def on_clear_all(fleet: Fleet, vehicle: Vehicle, message: Any, peer: Peer, causes: Causes) -> None:
    """MISSION_CLEAR_ALL: remove all items of one type; MAV_MISSION_TYPE_ALL is refused, as by ArduPilot."""
    kind = _item_type(fleet, vehicle, message, peer)
    if kind is None:
        return
    is_own_upload = _cancel_upload(fleet, vehicle, peer, kind)  # during another peer's upload: a denial, then an error
    result = ACCEPTED if is_own_upload and kind.clear_items(fleet, vehicle, causes) else dialect.MAV_MISSION_ERROR
    _send_ack(fleet, vehicle, peer, result, kind.mission_type, causes)


def on_set_current(fleet: Fleet, vehicle: Vehicle, message: Any, peer: Peer, causes: Causes) -> None:
    """MISSION_SET_CURRENT: answer success with MISSION_CURRENT of that number, failure with nothing."""
    if execution.set_current_cmd(fleet, vehicle, message.seq):
        current = table.build_message(fleet, vehicle, dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
        assert current is not None
        current.seq = message.seq
        fleet.send(vehicle, current, causes)


def on_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """Request overdue items again, or abandon the upload after 8 s."""
    for kind in ITEM_TYPES.values():
        upload = vehicle.uploads[kind.mission_type]
        if not upload.active or fleet.now - upload.asked_ns < RETRY_NS:
            continue
        if fleet.now - upload.received_ns > GIVE_UP_NS:
            _end_upload(fleet, vehicle, kind)
            fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, kind.timeout_text)
            _send_ack(fleet, vehicle, upload.peer, dialect.MAV_MISSION_OPERATION_CANCELLED, kind.mission_type)
            kind.abandon_upload(fleet, vehicle)
        else:
            _request_item(fleet, vehicle, kind)
    _set_retry_timer(fleet, vehicle)


_GUIDED, _ALTITUDE = 2, 3
IMMEDIATE_CURRENT: Final = (_GUIDED, _ALTITUDE)
"""Values of `current` that make an item a command: to fly there in GUIDED, or to change height."""
WARNING_TEXTS: Final = {
    dialect.MAVLINK_MSG_ID_MISSION_ITEM: "got MISSION_ITEM; GCS should send MISSION_ITEM_INT",
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST: "got MISSION_REQUEST; use MISSION_REQUEST_INT!",
}
"""Texts sent about deprecated messages, once per upload."""
_LOCATION_COMMANDS: Final = STORED_IN_LOCATION | {
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
    dialect.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
    dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
    dialect.MAV_CMD_NAV_FENCE_RETURN_POINT,
    dialect.MAV_CMD_NAV_RALLY_POINT,
}
"""Commands whose x and y are degrees (`cmd_has_location`)."""
_LAT_MAX_DEG, _LON_MAX_DEG = 90.0, 180.0


def location_error(message: Any) -> int | None:
    """Return the MAV_MISSION_RESULT of a MISSION_ITEM whose degrees are invalid, else `None`."""
    if message.command not in _LOCATION_COMMANDS:
        return None
    if not abs(message.x) <= _LAT_MAX_DEG:
        return int(dialect.MAV_MISSION_INVALID_PARAM5_X)
    if not abs(message.y) <= _LON_MAX_DEG:
        return int(dialect.MAV_MISSION_INVALID_PARAM6_Y)
    return None


def send_deprecation_text(fleet: Fleet, vehicle: Vehicle, message: Any, kind: int) -> None:
    """Ask the ground station to use the newer message."""
    number = message.get_msgId()
    if (kind, number) not in vehicle.legacy_warned:
        vehicle.legacy_warned.add((kind, number))
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, WARNING_TEXTS[number])


def execute_immediately(fleet: Fleet, vehicle: Vehicle, message: Any, causes: Causes) -> int:
    """Execute an item with one of the `IMMEDIATE_CURRENT` values and return the MAV_MISSION_RESULT.

    A change of height is accepted and has no effect.
    """
    result, slot = decode_item(message, causes)
    if slot is None or message.current == _ALTITUDE:
        return result
    done = False
    if vehicle.mode == Mode.GUIDED and slot.command == NAV_WAYPOINT:
        east, north = fleet.origin.enu_of(slot.x * 1e-7, slot.y * 1e-7)
        up = slot.z + locations.altitude_datum_m(fleet, vehicle, slot.frame)
        done = guided.set_destination(fleet, vehicle, (east, north, up), causes)
    elif vehicle.mode == Mode.GUIDED and slot.command == CONDITION_YAW:
        sense = (slot.param3 > 0.0) - (slot.param3 < 0.0)
        auto_yaw.set_fixed_yaw(fleet, vehicle, slot.param1, slot.param2, sense, relative=slot.param4 > 0.0)
        done = True
    return int(ACCEPTED if done else dialect.MAV_MISSION_ERROR)
