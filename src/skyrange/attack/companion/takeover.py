"""Takeover by the companion: it leads its own aircraft away, and forwards no order of the operator."""

from __future__ import annotations

from dataclasses import replace

from pydantic import Field

from skyrange.attack.bases.leading import Leader
from skyrange.attack.bases.mavlink_params import Track
from skyrange.attack.companion.own_commands import compromise_companions
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.victims import Victims
from skyrange.contracts.params import Number, Params
from skyrange.core.time import from_seconds


class Takeover(Params):
    """Where the aircraft is led."""

    vehicles: Victims = Field(description="Aircraft whose companion is compromised, such as ['blue/b1'].")
    track: Track = Field(
        description="Places to lead the aircraft to, in order, each [east_m, north_m, up_m] in metres from the origin."
    )
    within_m: Number = Field(
        default=3.0, gt=0, le=1000, description="Distance at which a place counts as reached, in metres."
    )
    every_s: Number = Field(default=0.5, ge=0.02, le=10, description="Time between two targets, in seconds.")


def make(params: Takeover, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    arguments = (
        context.schedule, context.origin, params.track, params.within_m, from_seconds(params.every_s), False,
    )  # fmt: skip
    made = compromise_companions(params.vehicles, context, holds_back="station", source=Leader, arguments=arguments)
    return replace(made, shown={"end of the track": params.track[-1]})


TAKEOVER = AttackPlugin(
    Takeover,
    make,
    "Has a companion computer fly its aircraft away and hold back the orders of the operator.",
    technique="T0813",
    surface=("log",),
    persists="mode",
    effect="the aircraft obeys its companion alone; the operator sees it leave and cannot call it back",
    places=(),
    threat=ThreatModel(
        knowledge="what the companion has: telemetry, the operator's orders, and the key of a signed link",
        position="in the companion computer, through which the control link passes",
        equipment="a program on the companion: from its supply chain, an update or a remote login",
        budget="one or two frames for each target, on board",
    ),
    controls=Controls(
        load="the sham: the same targets, addressed to a system that is not there; orders of the operator pass",
        content="targets along the plan of the aircraft itself",
        placement="the companion of another aircraft",
    ),
)
