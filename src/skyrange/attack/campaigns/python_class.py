"""Campaigns whose adversary is a Python class, as kinds of attack."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from skyrange.attack.campaigns.adversary import Adversary
from skyrange.attack.campaigns.params import CampaignParams
from skyrange.attack.campaigns.parts import CAMPAIGN, make_parts, move_acts
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.core.errors import ComponentError
from skyrange.core.time import from_seconds


def campaign_plugin(
    params: type[CampaignParams], make: Callable[[Any, AttackContext], Adversary], about: str
) -> AttackPlugin:
    """The kind of campaigns of which `make(params, context)` makes the adversary.

    A parameter that is a place of its own is moved by `anchor` if its name is in `places` of the kind: use
    `dataclasses.replace`.
    """

    def parts(given: CampaignParams, context: AttackContext) -> Attack:
        adversary = make(given, context)
        if not isinstance(adversary, Adversary):
            raise ComponentError(f"adversary of {context.id}", f"is {adversary!r}, which has no observe or no decide")
        return make_parts(given, context, adversary, longest_ns=from_seconds(given.longest_s))

    declared = AttackPlugin.find(CAMPAIGN)
    return replace(declared, params=params, make=parts, about=about, move=move_acts, source="")
