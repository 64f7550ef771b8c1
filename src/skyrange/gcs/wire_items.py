"""How does a mission item stand on the wire, and is what came back the same? MISSION_ITEM_INT, both ways.

An autopilot keeps less than it is given: ArduCopter stores altitudes in centimetres, hold times in
whole seconds, places only for some commands, and says frame 3 where 6 was sent. So comparing is by
what can be kept (libraries/AP_Mission/AP_Mission.cpp, `mission_cmd_to_mavlink_int`), and exact in that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.missions import MissionItem
from skyrange.gcs.plans import GLOBAL_FRAMES, HOME_FRAMES, LOCATED, MSL_FRAMES, FlightPlan

ALT_TOLERANCE_M = 0.0101
"""ArduCopter truncates to whole centimetres; the rest is 32-bit rounding."""
WHOLE_TOLERANCE = 1.0
"""For parameters kept as whole numbers: they may lose their fraction."""
FLOAT_TOLERANCE = 1e-3

_KEPT: dict[int, tuple[tuple[str, float], ...]] = {
    mav.MAV_CMD_NAV_WAYPOINT: (("param1", WHOLE_TOLERANCE),),
    mav.MAV_CMD_NAV_SPLINE_WAYPOINT: (("param1", WHOLE_TOLERANCE),),
    mav.MAV_CMD_NAV_LOITER_TIME: (("param1", WHOLE_TOLERANCE),),
    mav.MAV_CMD_NAV_LOITER_TURNS: (("param1", WHOLE_TOLERANCE),),
    mav.MAV_CMD_NAV_DELAY: (("param1", FLOAT_TOLERANCE),),
    mav.MAV_CMD_CONDITION_DELAY: (("param1", FLOAT_TOLERANCE),),
    mav.MAV_CMD_DO_JUMP: (("param1", FLOAT_TOLERANCE), ("param2", FLOAT_TOLERANCE)),
    mav.MAV_CMD_DO_CHANGE_SPEED: (("param1", FLOAT_TOLERANCE), ("param2", FLOAT_TOLERANCE)),
}
"""Parameters that are compared, by command, and how far they may differ (below, for the whole ones)."""


class WireItem(NamedTuple):
    """A mission item with x and y as they travel: 1e-7 degrees in global frames. No NaN."""

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
        """The MISSION_ITEM_INT that carries it as item `seq`."""
        return mav.MAVLink_mission_item_int_message(
            system, component, seq, self.frame, self.command, 0, self.autocontinue,
            self.param1, self.param2, self.param3, self.param4, self.x, self.y, self.z,
            mav.MAV_MISSION_TYPE_MISSION,
        )  # fmt: skip


def wire_items(plan: FlightPlan) -> tuple[WireItem, ...]:
    """All items of an auto plan as they are uploaded, ArduPilot's item 0 (home) first."""
    lat, lon = plan.origin.geodetic_of(plan.home_enu_m.east_m, plan.home_enu_m.north_m)
    alt_m = plan.origin.alt_msl_m + plan.home_enu_m.up_m
    home = MissionItem(mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_NAV_WAYPOINT, 0.0, 0.0, 0.0, 0.0, lat, lon, alt_m)
    return tuple(_wire(item) for item in (home, *plan.items))


def _wire(item: MissionItem) -> WireItem:
    # An unset (NaN) parameter goes up as 0: ArduCopter refuses most NaN, and stores 0 for unset ones.
    p1, p2, p3, p4 = (0.0 if math.isnan(value) else value for value in item.values[:4])
    scale = 1e7 if item.frame in GLOBAL_FRAMES and item.command in LOCATED else 1.0
    x, y = round(item.x * scale), round(item.y * scale)
    return WireItem(item.frame, item.command, p1, p2, p3, p4, x, y, item.z, int(item.autocontinue))


def difference(sent: WireItem, got: Message) -> str:
    """How the MISSION_ITEM_INT `got` differs from what was `sent`; empty if it is the same item."""
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
    for name, tolerance in _KEPT.get(sent.command, ()):
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
