"""Differences between a mission item that was sent and what an autopilot stored of it.

An autopilot stores less than it receives: ArduCopter stores altitudes in centimetres, hold times in whole
seconds, and positions only for some commands, and it reports frame 3 where 6 was sent. The comparison
therefore covers what ArduCopter stores (libraries/AP_Mission/AP_Mission.cpp, `mission_cmd_to_mavlink_int`),
and is exact in that.
"""

from __future__ import annotations

from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mav

MSL_FRAMES = frozenset({mav.MAV_FRAME_GLOBAL, mav.MAV_FRAME_GLOBAL_INT})
HOME_FRAMES = frozenset({mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})
TERRAIN_FRAMES = frozenset({mav.MAV_FRAME_GLOBAL_TERRAIN_ALT, mav.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT})
GLOBAL_FRAMES = MSL_FRAMES | HOME_FRAMES | TERRAIN_FRAMES
"""Frames whose x and y are latitude and longitude."""

LOCATED = frozenset(
    {
        mav.MAV_CMD_NAV_WAYPOINT,
        mav.MAV_CMD_NAV_LOITER_UNLIM,
        mav.MAV_CMD_NAV_LOITER_TURNS,
        mav.MAV_CMD_NAV_LOITER_TIME,
        mav.MAV_CMD_NAV_LAND,
        mav.MAV_CMD_NAV_TAKEOFF,
        mav.MAV_CMD_NAV_VTOL_TAKEOFF,
        mav.MAV_CMD_NAV_VTOL_LAND,
        mav.MAV_CMD_NAV_LOITER_TO_ALT,
        mav.MAV_CMD_NAV_SPLINE_WAYPOINT,
        mav.MAV_CMD_DO_SET_HOME,
        mav.MAV_CMD_DO_RETURN_PATH_START,
        mav.MAV_CMD_DO_LAND_START,
        mav.MAV_CMD_DO_SET_ROI_LOCATION,
        mav.MAV_CMD_DO_SET_ROI,
        mav.MAV_CMD_NAV_PAYLOAD_PLACE,
    }
)
"""Commands whose position ArduCopter stores (`AP_Mission::stored_in_location`); it drops x, y, z of the others."""

AREAS = frozenset(
    {
        mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
        mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
        mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
        mav.MAV_CMD_NAV_FENCE_RETURN_POINT,
        mav.MAV_CMD_NAV_RALLY_POINT,
    }
)
"""Commands of fences and rally points, which ArduPilot stores with their position."""

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


class SentItem(Protocol):
    """An item as it was sent, with the fields of MISSION_ITEM_INT: x and y are 1e-7 degrees in global frames."""

    @property
    def frame(self) -> int:
        """MAV_FRAME."""
        ...

    @property
    def command(self) -> int:
        """MAV_CMD."""
        ...

    @property
    def param1(self) -> float:
        """Parameter 1."""
        ...

    @property
    def x(self) -> int:
        """Latitude."""
        ...

    @property
    def y(self) -> int:
        """Longitude."""
        ...

    @property
    def z(self) -> float:
        """Altitude in metres."""
        ...


def describe_difference(sent: SentItem, got: Any) -> str:
    """How the MISSION_ITEM_INT `got` differs from the item that was `sent`; empty if they are the same item."""
    if got.command != sent.command:
        return f"command is {got.command}, sent {sent.command}"
    if sent.command in AREAS:
        return _describe_area(sent, got)
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


def _describe_area(sent: SentItem, got: Any) -> str:
    """How an item of a fence or a rally point differs."""
    for name, axis in (("latitude", "x"), ("longitude", "y")):
        if getattr(got, axis) != getattr(sent, axis):
            return f"{name} is {getattr(got, axis) / 1e7:.7f}, sent {getattr(sent, axis) / 1e7:.7f}"
    if not abs(got.param1 - sent.param1) <= FLOAT_TOLERANCE + abs(sent.param1) * 1e-6:
        return f"param1 is {got.param1:g}, sent {sent.param1:g}"
    if sent.command != mav.MAV_CMD_NAV_RALLY_POINT:
        return ""  # ArduPilot stores no altitude of a fence
    if _datum(got.frame) != _datum(sent.frame):
        return f"frame is {got.frame}, sent {sent.frame}"
    return "" if abs(got.z - sent.z) < WHOLE_TOLERANCE else f"altitude is {got.z:g} m, sent {sent.z:g} m"


def _datum(frame: int) -> str:
    if frame in MSL_FRAMES or frame == mav.MAV_FRAME_MISSION:
        return "msl"
    if frame in HOME_FRAMES:
        return "home"
    return "terrain" if frame in GLOBAL_FRAMES else str(frame)
