"""Campaigns whose stages a Python class decides, as kinds of attack."""

from __future__ import annotations

from typing import ClassVar

from skyrange.attack.campaigns.adversary import CampaignStage, Observation
from skyrange.attack.campaigns.params import CampaignKind, move_acts
from skyrange.attack.campaigns.parts import make_parts
from skyrange.attack.contract import Attack, AttackContext
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.form import param
from skyrange.core.time import Time, from_seconds


class CampaignBase(CampaignKind):
    """A campaign whose class is the adversary: it is shown what it observes, and decides the stage.

    `Adversary` says when both methods are called.
    """

    needs: ClassVar[tuple[str, ...]] = ("observe", "decide")
    move = move_acts

    longest_s: Number = param(
        "Longest duration of the campaign in seconds: then it ends, whatever the adversary decides.",
        gt=0, le=31_536_000,
    )  # fmt: skip

    def build(self, context: AttackContext) -> Attack:
        """The campaign. Raises `InputError` for acts whose kind or parameters are wrong."""
        return make_parts(self, context, self, longest_ns=from_seconds(self.longest_s))

    def observe(self, now: Time, observation: Observation) -> None:
        """Learn from a frame on a tapped link, or from a broadcast that the radio has decoded."""
        raise NotImplementedError

    def decide(self, now: Time) -> CampaignStage | None:
        """The stage that the adversary is in; `None` ends the campaign."""
        raise NotImplementedError
