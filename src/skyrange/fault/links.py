"""Faults of links: which links fail, and the rule of the taps that make them fail."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from skyrange.attack.link.frame_taps import FrameChance, Rule
from skyrange.attack.on_path import Names, Selection
from skyrange.contracts.params import Params
from skyrange.fault.contract import FaultContext


class Links(Params):
    """Which links fail, and in which direction."""

    links: Annotated[Names, Field(min_length=1)] = Field(
        description="Links by name or pattern, such as ['gcs:blue/b1'] or ['gcs:*']."
    )
    direction: Literal["fwd", "rev", "both"] = Field(
        default="both", description="fwd: towards the aircraft on gcs, log and autopilot; rev: from it."
    )


def rule_for(context: FaultContext, direction: str = "both") -> Rule:
    """The rule of a fault that hits every frame of a direction."""
    chance = FrameChance(context.chance, context.id)
    return Rule(Selection(direction, frozenset()), context.schedule, chance, sham=False)
