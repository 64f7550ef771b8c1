"""Disabled avoidance: the companion hears other aircraft and decides to avoid, and its orders never leave it."""

from __future__ import annotations

from pydantic import Field

from skyrange.attack.companion.own_commands import compromise_companions
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.victims import Victims
from skyrange.contracts.params import Params


class DisabledAvoidance(Params):
    """Which companions do not act."""

    vehicles: Victims = Field(description="Aircraft whose companion is compromised, such as ['blue/b1'].")


def make(params: DisabledAvoidance, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    return compromise_companions(params.vehicles, context, holds_back="companion")


NO_AVOIDANCE = AttackPlugin(
    DisabledAvoidance,
    make,
    "Holds back the orders by which a companion computer avoids others, and nothing else.",
    technique="T0837",
    surface=("log",),
    persists="acts",
    effect="the aircraft does not avoid those that it hears, and its telemetry and broadcasts look normal",
    threat=ThreatModel(
        knowledge="the messages by which a companion commands its autopilot",
        position="in the companion computer",
        equipment="a program on the companion: from its supply chain, an update or a remote login",
        budget="no frames of its own; it alters some frames in each avoidance",
    ),
    controls=Controls(
        load="the sham: the same frames are replaced by copies of themselves",
        content="none, because an order that is held back has no content",
        placement="the companion of another aircraft",
    ),
)
