"""Conversion of mission items: MISSION_ITEM(_INT) to a stored item with its checks, and back.

After libraries/AP_Mission/AP_Mission.cpp (`sanity_check_params`, `mavlink_int_to_mission_cmd`,
`convert_MISSION_ITEM_to_MISSION_ITEM_INT`): the result of a bad item names the wrong field.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionItem, Vehicle
from skyrange.vehicle.builtin.locations import ABSOLUTE_FRAMES, RELATIVE_FRAMES, TERRAIN_FRAMES
from skyrange.vehicle.builtin.mission.command_ids import (
    CONDITION_DELAY,
    CONDITION_DISTANCE,
    CONDITION_YAW,
    DO_CHANGE_SPEED,
    DO_SET_HOME,
    DO_SET_ROI,
    DO_SET_ROI_LOCATION,
    DO_SET_ROI_NONE,
    JUMPS,
    NAV_DELAY,
    NAV_LAND,
    NAV_LOITER_TIME,
    NAV_LOITER_TO_ALT,
    NAV_LOITER_TURNS,
    NAV_LOITER_UNLIM,
    NAV_SPLINE_WAYPOINT,
    NAV_TAKEOFF,
    NAV_VTOL_LAND,
    NAV_VTOL_TAKEOFF,
    NAV_WAYPOINT,
    STORED_BY_FIELDS,
    STORED_IN_LOCATION,
    SUPPORTED,
    is_modelled,
    stored_fields,
)
from skyrange.vehicle.builtin.modes import NAV_GUIDED_ENABLE

ACCEPTED = dialect.MAV_MISSION_ACCEPTED
_U8, _U16 = 255, 65535
_ALT_MAX_M = 83_000.0  # LOCATION_ALT_MAX_M
_DATUMS = {
    **dict.fromkeys((*ABSOLUTE_FRAMES, dialect.MAV_FRAME_MISSION), dialect.MAV_FRAME_GLOBAL),
    **dict.fromkeys(RELATIVE_FRAMES, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT),
    **dict.fromkeys(TERRAIN_FRAMES, dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT),
}
"""The frame in which a place is stored and read back (`mission_cmd_to_mavlink_int`): only its datum is kept."""
_NO_FRAME = dialect.MAV_FRAME_GLOBAL
"""The frame of an item without a place."""
_YAW_MAY_BE_NAN = frozenset((NAV_WAYPOINT, NAV_LOITER_UNLIM, NAV_LAND, NAV_TAKEOFF, NAV_VTOL_TAKEOFF, NAV_VTOL_LAND))
"""Commands whose yaw may be NaN, which leaves it to the autopilot (sanity_check_params)."""
_APPROACH_PLACE = 2
"""param3, which may be NaN in NAV_VTOL_LAND alone."""
_INVALID_PARAM = (
    dialect.MAV_MISSION_INVALID_PARAM1,
    dialect.MAV_MISSION_INVALID_PARAM2,
    dialect.MAV_MISSION_INVALID_PARAM3,
    dialect.MAV_MISSION_INVALID_PARAM4,
)

Params = tuple[float, float, float, float]


def decode_item(message: Any, causes: Causes) -> tuple[int, MissionItem | None]:
    """Return (MAV_MISSION_RESULT, item) of a MISSION_ITEM_INT or MISSION_ITEM; no item unless accepted."""
    command = message.command
    params = (message.param1, message.param2, message.param3, message.param4)
    for place, (value, bad) in enumerate(zip(params, _INVALID_PARAM, strict=True)):
        yaw = place == 3 and command in _YAW_MAY_BE_NAN
        approach = place == _APPROACH_PLACE and command == NAV_VTOL_LAND
        if math.isinf(value) or (math.isnan(value) and not yaw and not approach):
            return bad, None
    if command <= 1:
        return dialect.MAV_MISSION_INVALID, None
    if command not in SUPPORTED:
        return dialect.MAV_MISSION_UNSUPPORTED, None
    x, y, z = message.x, message.y, message.z
    if command in STORED_IN_LOCATION:
        whole = message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT
        lat, lon = (x * 1e-7, y * 1e-7) if whole else (x, y)
        if not -90.0 <= lat <= 90.0:
            return dialect.MAV_MISSION_INVALID_PARAM5_X, None
        if not -180.0 <= lon <= 180.0:
            return dialect.MAV_MISSION_INVALID_PARAM6_Y, None
        if not abs(z) < _ALT_MAX_M:
            return dialect.MAV_MISSION_INVALID_PARAM7, None
        if message.frame not in _DATUMS:
            return dialect.MAV_MISSION_UNSUPPORTED_FRAME, None
        if not whole:
            x, y = round(x * 1e7), round(y * 1e7)
        z = int(np.float32(z) * np.float32(100.0)) / 100.0  # whole centimetres
        return ACCEPTED, MissionItem(
            command, _DATUMS[message.frame], *stored_params(command, params), x, y, z, causes=causes
        )
    if command in STORED_BY_FIELDS:
        a, b, c, d, e, f, g = stored_fields(command, (*params, x, y, z))
        if not is_modelled(command, a):
            return dialect.MAV_MISSION_UNSUPPORTED, None
        return ACCEPTED, MissionItem(command, _NO_FRAME, a, b, c, d, int(e), int(f), g, causes=causes)
    return ACCEPTED, MissionItem(command, _NO_FRAME, *stored_params(command, params), causes=causes)


def _to_whole(value: float, low: int, high: int) -> float:
    return float(int(min(max(value, low), high)))


def stored_params(command: int, params: Params) -> Params:
    """Return the parameters that ArduPilot keeps of an item in its 15 bytes (mavlink_int_to_mission_cmd), as read back.

    A waypoint's acceptance radius, pass-by distance and yaw are not stored: WPNAV_RADIUS applies to all.
    """
    a, b, c, d = params
    if command in (
        NAV_WAYPOINT,
        NAV_SPLINE_WAYPOINT,
        NAV_LAND,
        NAV_TAKEOFF,
        DO_SET_HOME,
        NAV_VTOL_LAND,
        NAV_GUIDED_ENABLE,
        dialect.MAV_CMD_NAV_CONTINUE_AND_CHANGE_ALT,
        DO_SET_ROI,
        DO_SET_ROI_LOCATION,
        DO_SET_ROI_NONE,
    ):
        return _to_whole(a, 0, _U16), 0.0, 0.0, 0.0
    if command == NAV_LOITER_UNLIM:
        return 0.0, 0.0, math.copysign(_to_whole(abs(c), 0, _U16), c), 0.0
    if command == NAV_LOITER_TURNS:
        turns = int(a * 256.0) / 256.0 if 0.0 < a < 1.0 else _to_whole(a, 0, _U8)
        radius = abs(c)
        radius = _to_whole(radius, 0, _U8) if radius <= _U8 else 10.0 * _to_whole(radius * 0.1, 0, _U8)
        return turns, 0.0, math.copysign(radius, c), float(d > 0.0)
    if command == NAV_LOITER_TIME:
        return _to_whole(a, 0, _U16), 0.0, -1.0 if c < 0.0 else 1.0, float(d > 0.0)
    if command == NAV_LOITER_TO_ALT:
        return 0.0, math.copysign(_to_whole(abs(b), 0, _U16), b), 0.0, float(d > 0.0)
    if command == NAV_DELAY:
        return a, _to_whole(b, -128, 127), _to_whole(c, -128, 127), _to_whole(d, -128, 127)
    if command in JUMPS:
        return _to_whole(a, 0, _U16), _to_whole(b, -1, 32767), 0.0, 0.0
    if command == DO_CHANGE_SPEED:
        return _to_whole(a, 0, _U8), b, c, 0.0
    if command == CONDITION_YAW:
        return a, b, _to_whole(c, -128, 127), _to_whole(d, 0, _U8)
    if command in (CONDITION_DELAY, CONDITION_DISTANCE):
        return a, 0.0, 0.0, 0.0
    return 0.0, 0.0, 0.0, 0.0  # RETURN_TO_LAUNCH, VTOL_TAKEOFF, DO_LAND_START, DO_GO_AROUND


def encode_item(fleet: Fleet, vehicle: Vehicle, seq: int, peer: tuple[int, int], *, whole: bool) -> Any:
    """Return item `seq` as MISSION_ITEM_INT (`whole`) or MISSION_ITEM; item 0 is home, whatever was written there."""
    if seq == 0:
        lat, lon = fleet.origin.geodetic_of(vehicle.home[0], vehicle.home[1])
        item = MissionItem(
            NAV_WAYPOINT,
            dialect.MAV_FRAME_GLOBAL,
            x=round(lat * 1e7),
            y=round(lon * 1e7),
            z=vehicle.home[2] + fleet.origin.alt_msl_m,
        )
    else:
        item = vehicle.mission[seq]
    current = int(seq == vehicle.current and seq > 0)
    head = (*peer, seq, item.frame, item.command, current, 1)
    params = (item.param1, item.param2, item.param3, item.param4)
    if whole:
        return dialect.MAVLink_mission_item_int_message(*head, *params, item.x, item.y, item.z, 0)
    scale = 1.0 if item.command in STORED_BY_FIELDS else 1e-7
    return dialect.MAVLink_mission_item_message(*head, *params, item.x * scale, item.y * scale, item.z, 0)
