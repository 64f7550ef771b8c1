"""Deprecated messages of the mission protocol: MISSION_ITEM in degrees, MISSION_REQUEST, and items executed at once.

After libraries/GCS_MAVLink/GCS_Common.cpp `handle_mission_item`, MissionItemProtocol.cpp, AP_Mission.cpp
`convert_MISSION_ITEM_to_MISSION_ITEM_INT` and ArduCopter/mode_auto.cpp `do_guided`.
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle
from skyrange.vehicle.builtin.flight_modes import guided
from skyrange.vehicle.builtin.guidance import auto_yaw
from skyrange.vehicle.builtin.locations import location
from skyrange.vehicle.builtin.mission.command_ids import CONDITION_YAW, NAV_WAYPOINT, STORED_IN_LOCATION
from skyrange.vehicle.builtin.mission.items import ACCEPTED, decode_item
from skyrange.vehicle.builtin.modes import Mode

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
        up = slot.z + location.altitude_datum_m(fleet, vehicle, slot.frame)
        done = guided.set_destination(fleet, vehicle, (east, north, up), causes)
    elif vehicle.mode == Mode.GUIDED and slot.command == CONDITION_YAW:
        sense = (slot.param3 > 0.0) - (slot.param3 < 0.0)
        auto_yaw.set_fixed_yaw(fleet, vehicle, slot.param1, slot.param2, sense, slot.param4 > 0.0)
        done = True
    return int(ACCEPTED if done else dialect.MAV_MISSION_ERROR)
