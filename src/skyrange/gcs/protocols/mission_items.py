"""Mission items as MISSION_ITEM_INT, as they are uploaded."""

from __future__ import annotations

import math
from typing import NamedTuple

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import MissionItem
from skyrange.codec.mission.differences import AREAS, GLOBAL_FRAMES, LOCATED
from skyrange.gcs.plan.plans import FlightPlan


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

    def message(self, seq: int, system: int, component: int, kind: int = mav.MAV_MISSION_TYPE_MISSION) -> Message:
        """The MISSION_ITEM_INT message that carries it as item number `seq` of a list of this MAV_MISSION_TYPE."""
        return mav.MAVLink_mission_item_int_message(
            system, component, seq, self.frame, self.command, 0, self.autocontinue,
            self.param1, self.param2, self.param3, self.param4, self.x, self.y, self.z, kind,
        )  # fmt: skip


class ItemList(NamedTuple):
    """What an autopilot stores as one list: the mission, the fence, or the rally points."""

    kind: int
    """MAV_MISSION_TYPE."""
    items: tuple[MissionItemInt, ...]


def encode_lists(plan: FlightPlan) -> list[ItemList]:
    """What is uploaded for a plan, in QGroundControl's order: its mission, its fence, its rally points."""
    lists = [ItemList(mav.MAV_MISSION_TYPE_MISSION, encode_mission(plan))] if plan.kind == "auto" else []
    for kind, items in ((mav.MAV_MISSION_TYPE_FENCE, plan.fence), (mav.MAV_MISSION_TYPE_RALLY, plan.rally)):
        if items:
            lists.append(ItemList(kind, tuple(map(_encode, items))))
    return lists


def encode_mission(plan: FlightPlan) -> tuple[MissionItemInt, ...]:
    """All items of an auto plan as they are uploaded; ArduPilot's item 0 (home) comes first."""
    lat, lon = plan.origin.geodetic_of(plan.home_enu_m.east_m, plan.home_enu_m.north_m)
    alt_m = plan.origin.alt_msl_m + plan.home_enu_m.up_m
    home = MissionItem(mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_NAV_WAYPOINT, 0.0, 0.0, 0.0, 0.0, lat, lon, alt_m)
    return tuple(_encode(item) for item in (home, *plan.items))


def _encode(item: MissionItem) -> MissionItemInt:
    # An unset (NaN) parameter is sent as 0: ArduCopter rejects most NaN, and stores 0 for unset parameters.
    p1, p2, p3, p4 = (0.0 if math.isnan(value) else value for value in item.values[:4])
    scale = 1e7 if item.frame in GLOBAL_FRAMES and item.command in LOCATED | AREAS else 1.0
    x, y = round(item.x * scale), round(item.y * scale)
    return MissionItemInt(item.frame, item.command, p1, p2, p3, p4, x, y, item.z, int(item.autocontinue))
