"""Is a mission item one that this autopilot can fly? From MISSION_ITEM(_INT) to a stored slot, and back.

After libraries/AP_Mission/AP_Mission.cpp (`sanity_check_params`, `mavlink_int_to_mission_cmd`,
`convert_MISSION_ITEM_to_MISSION_ITEM_INT`): the result of a bad item says which field is wrong.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Slot
from skyrange.vehicle.builtin.navigator import JUMP, LAND, RTL, SPEED, TAKEOFF, WAYPOINT

ACCEPTED = dialect.MAV_MISSION_ACCEPTED
_ALT_MAX_M = 83_000.0  # LOCATION_ALT_MAX_M
_LOCATED = frozenset((WAYPOINT, LAND, TAKEOFF))
_SUPPORTED = _LOCATED | {RTL, JUMP, SPEED}
_FRAMES = frozenset(
    (
        dialect.MAV_FRAME_GLOBAL,
        dialect.MAV_FRAME_GLOBAL_INT,
        dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        dialect.MAV_FRAME_MISSION,
    )
)
_BAD_PARAM = (
    dialect.MAV_MISSION_INVALID_PARAM1,
    dialect.MAV_MISSION_INVALID_PARAM2,
    dialect.MAV_MISSION_INVALID_PARAM3,
    dialect.MAV_MISSION_INVALID_PARAM4,
)


def slot_of(message: Any, causes: Causes) -> tuple[int, Slot | None]:
    """(MAV_MISSION_RESULT, slot) of a MISSION_ITEM_INT or a MISSION_ITEM; no slot unless accepted."""
    command = message.command
    params = (message.param1, message.param2, message.param3, message.param4)
    for place, (value, bad) in enumerate(zip(params, _BAD_PARAM, strict=True)):
        yaw = place == 3 and command in _LOCATED  # NaN leaves the yaw to the autopilot
        if math.isinf(value) or (math.isnan(value) and not yaw):
            return bad, None
    if command not in _SUPPORTED:
        return dialect.MAV_MISSION_UNSUPPORTED, None
    x, y, z = message.x, message.y, message.z
    if command in _LOCATED:
        whole = message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT
        lat, lon = (x * 1e-7, y * 1e-7) if whole else (x, y)
        if not -90.0 <= lat <= 90.0:
            return dialect.MAV_MISSION_INVALID_PARAM5_X, None
        if not -180.0 <= lon <= 180.0:
            return dialect.MAV_MISSION_INVALID_PARAM6_Y, None
        if not abs(z) < _ALT_MAX_M:
            return dialect.MAV_MISSION_INVALID_PARAM7, None
        if message.frame not in _FRAMES:
            return dialect.MAV_MISSION_UNSUPPORTED_FRAME, None
        if not whole:
            x, y = round(x * 1e7), round(y * 1e7)
    else:
        x, y, z = 0, 0, 0.0
    yaw_or_zero = 0.0 if math.isnan(params[3]) else params[3]
    slot = Slot(command, message.frame, *params[:3], yaw_or_zero, x, y, z, message.autocontinue, causes)
    if command == WAYPOINT:  # 16 bits of seconds, as ArduPilot keeps it
        slot.param1 = float(int(min(max(slot.param1, 0.0), 65535.0)))
    elif command == JUMP:
        slot.param1 = float(int(min(max(slot.param1, 0.0), 65535.0)))
        slot.param2 = float(int(min(max(slot.param2, -1.0), 32767.0)))
    return ACCEPTED, slot


def item_message(fleet: Fleet, craft: Craft, seq: int, partner: tuple[int, int], whole: bool) -> Any:
    """Item `seq` as MISSION_ITEM_INT (`whole`) or MISSION_ITEM; item 0 is home, whatever was written there."""
    if seq == 0:
        lat, lon = fleet.origin.geodetic_of(craft.home[0], craft.home[1])
        slot = Slot(
            WAYPOINT,
            dialect.MAV_FRAME_GLOBAL,
            x=round(lat * 1e7),
            y=round(lon * 1e7),
            z=craft.home[2] + fleet.origin.alt_msl_m,
        )
    else:
        slot = craft.mission[seq]
    current = int(seq == craft.current and seq > 0)
    head = (*partner, seq, slot.frame, slot.command, current, slot.autocontinue)
    params = (slot.param1, slot.param2, slot.param3, slot.param4)
    if whole:
        return dialect.MAVLink_mission_item_int_message(*head, *params, slot.x, slot.y, slot.z, 0)
    return dialect.MAVLink_mission_item_message(*head, *params, slot.x * 1e-7, slot.y * 1e-7, slot.z, 0)
