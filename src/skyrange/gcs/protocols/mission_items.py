"""Mission items as MISSION_ITEM_INT: encoding for upload, and comparison with what is read back.

An autopilot stores less than it receives: ArduCopter stores altitudes in centimetres, hold times in whole
seconds, and positions only for some commands, and it reports frame 3 where 6 was sent. The comparison
therefore covers what ArduCopter stores (libraries/AP_Mission/AP_Mission.cpp, `mission_cmd_to_mavlink_int`),
and is exact in that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import MissionItem
from skyrange.gcs.plan.plans import GLOBAL_FRAMES, HOME_FRAMES, LOCATED, MSL_FRAMES, FlightPlan

ALT_TOLERANCE_M = 0.0101
"""ArduCopter truncates to whole centimetres; the rest allows for 32-bit rounding."""
WHOLE_TOLERANCE = 1.0
"""For parameters that are stored as whole numbers and may lose their fraction."""
FLOAT_TOLERANCE = 1e-3

_COMPARED_PARAMS: dict[int, tuple[tuple[str, float], ...]] = {
    mav.MAV_CMD_NAV_WAYPOINT: (("param1", WHOLE_TOLERANCE),),
    mav.MAV_CMD_NAV_SPLINE_WAYPOINT: (("param1", WHOLE_TOLERANCE),),
    mav.MAV_CMD_NAV_LOITER_TIME: (("param1", WHOLE_TOLERANCE),),
    mav.MAV_CMD_NAV_LOITER_TURNS: (("param1", WHOLE_TOLERANCE),),
    mav.MAV_CMD_NAV_DELAY: (("param1", FLOAT_TOLERANCE),),
    mav.MAV_CMD_CONDITION_DELAY: (("param1", FLOAT_TOLERANCE),),
    mav.MAV_CMD_DO_JUMP: (("param1", FLOAT_TOLERANCE), ("param2", FLOAT_TOLERANCE)),
    mav.MAV_CMD_DO_CHANGE_SPEED: (("param1", FLOAT_TOLERANCE), ("param2", FLOAT_TOLERANCE)),
}
"""By command, the parameters that are compared and the difference that each must stay below."""


class MissionItemInt(NamedTuple):
    """A mission item with x and y as MISSION_ITEM_INT encodes them: 1e-7 degrees in global frames. No NaN."""

    frame: int
    command: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: int
    y: int
    z: float
    autocontinue: int

    def message(self, seq: int, system: int, component: int) -> Message:
        """The MISSION_ITEM_INT message that carries it as item number `seq`."""
        return mav.MAVLink_mission_item_int_message(
            system, component, seq, self.frame, self.command, 0, self.autocontinue,
            self.param1, self.param2, self.param3, self.param4, self.x, self.y, self.z,
            mav.MAV_MISSION_TYPE_MISSION,
        )  # fmt: skip


def encode_mission(plan: FlightPlan) -> tuple[MissionItemInt, ...]:
    """All items of an auto plan as they are uploaded; ArduPilot's item 0 (home) comes first."""
    lat, lon = plan.origin.geodetic_of(plan.home_enu_m.east_m, plan.home_enu_m.north_m)
    alt_m = plan.origin.alt_msl_m + plan.home_enu_m.up_m
    home = MissionItem(mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_NAV_WAYPOINT, 0.0, 0.0, 0.0, 0.0, lat, lon, alt_m)
    return tuple(_encode(item) for item in (home, *plan.items))


def _encode(item: MissionItem) -> MissionItemInt:
    # An unset (NaN) parameter is sent as 0: ArduCopter rejects most NaN, and stores 0 for unset parameters.
    p1, p2, p3, p4 = (0.0 if math.isnan(value) else value for value in item.values[:4])
    scale = 1e7 if item.frame in GLOBAL_FRAMES and item.command in LOCATED else 1.0
    x, y = round(item.x * scale), round(item.y * scale)
    return MissionItemInt(item.frame, item.command, p1, p2, p3, p4, x, y, item.z, int(item.autocontinue))


def describe_difference(sent: MissionItemInt, got: Message) -> str:
    """How the MISSION_ITEM_INT `got` differs from the item that was `sent`; empty if they are the same item."""
    if got.command != sent.command:
        return f"command is {got.command}, sent {sent.command}"
    if sent.command in LOCATED:
        if _datum(got.frame) != _datum(sent.frame):
            return f"frame is {got.frame}, sent {sent.frame}"
        if got.x != sent.x:
            return f"latitude is {got.x / 1e7:.7f}, sent {sent.x / 1e7:.7f}"
        if got.y != sent.y:
            return f"longitude is {got.y / 1e7:.7f}, sent {sent.y / 1e7:.7f}"
        if not abs(got.z - sent.z) <= ALT_TOLERANCE_M + abs(sent.z) * 1e-6:
            return f"altitude is {got.z:.2f} m, sent {sent.z:.2f} m"
    for name, tolerance in _COMPARED_PARAMS.get(sent.command, ()):
        value, wanted = getattr(got, name), getattr(sent, name)
        if not abs(value - wanted) < tolerance:
            return f"{name} is {value:g}, sent {wanted:g}"
    return ""


def _datum(frame: int) -> str:
    if frame in MSL_FRAMES or frame == mav.MAV_FRAME_MISSION:
        return "msl"
    if frame in HOME_FRAMES:
        return "home"
    return "terrain" if frame in GLOBAL_FRAMES else str(frame)
