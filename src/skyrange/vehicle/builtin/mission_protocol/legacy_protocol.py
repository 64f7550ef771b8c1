"""Deprecated messages of the mission protocol: MISSION_ITEM in degrees, MISSION_REQUEST, and items executed at once.

After libraries/GCS_MAVLink/GCS_Common.cpp `handle_mission_item`, MissionItemProtocol.cpp, AP_Mission.cpp
`convert_MISSION_ITEM_to_MISSION_ITEM_INT` and ArduCopter/mode_auto.cpp `do_guided`.
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin import facing, places, targets
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet
from skyrange.vehicle.builtin.mission_items import ACCEPTED, slot_of
from skyrange.vehicle.builtin.mission_kinds import LOCATED, WAYPOINT, YAW
from skyrange.vehicle.builtin.modes import Mode

_GUIDED, _ALTITUDE = 2, 3
MARKS: Final = (_GUIDED, _ALTITUDE)
"""Values of `current` that make an item a command: to fly there in GUIDED, or to change height."""
WARNINGS: Final = {
    dialect.MAVLINK_MSG_ID_MISSION_ITEM: "got MISSION_ITEM; GCS should send MISSION_ITEM_INT",
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST: "got MISSION_REQUEST; use MISSION_REQUEST_INT!",
}
"""Texts sent about deprecated messages, once per upload."""
_LOCATION_COMMANDS: Final = LOCATED | {
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
    dialect.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
    dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
    dialect.MAV_CMD_NAV_FENCE_RETURN_POINT,
    dialect.MAV_CMD_NAV_RALLY_POINT,
}
"""Commands whose x and y are degrees (`cmd_has_location`)."""
_LAT_MAX_DEG, _LON_MAX_DEG = 90.0, 180.0


def bad_place(message: Any) -> int | None:
    """Return the MAV_MISSION_RESULT of a MISSION_ITEM whose degrees are invalid, else `None`."""
    if message.command not in _LOCATION_COMMANDS:
        return None
    if not abs(message.x) <= _LAT_MAX_DEG:
        return int(dialect.MAV_MISSION_INVALID_PARAM5_X)
    if not abs(message.y) <= _LON_MAX_DEG:
        return int(dialect.MAV_MISSION_INVALID_PARAM6_Y)
    return None


def warn(fleet: Fleet, craft: Craft, message: Any, kind: int) -> None:
    """Ask the ground station to use the newer message."""
    number = message.get_msgId()
    if (kind, number) not in craft.warned:
        craft.warned.add((kind, number))
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, WARNINGS[number])


def obey(fleet: Fleet, craft: Craft, message: Any, causes: Causes) -> int:
    """Execute an item with one of the `IMMEDIATE_CURRENT` values and return the MAV_MISSION_RESULT.

    A change of height is accepted and has no effect.
    """
    result, slot = slot_of(message, causes)
    if slot is None or message.current == _ALTITUDE:
        return result
    done = False
    if craft.mode == Mode.GUIDED and slot.command == WAYPOINT:
        east, north = fleet.origin.enu_of(slot.x * 1e-7, slot.y * 1e-7)
        up = slot.z + places.datum_m(fleet, craft, slot.frame)
        done = targets.order(fleet, craft, (east, north, up), causes)
    elif craft.mode == Mode.GUIDED and slot.command == YAW:
        sense = (slot.param3 > 0.0) - (slot.param3 < 0.0)
        facing.turn(fleet, craft, slot.param1, slot.param2, sense, slot.param4 > 0.0)
        done = True
    return int(ACCEPTED if done else dialect.MAV_MISSION_ERROR)
