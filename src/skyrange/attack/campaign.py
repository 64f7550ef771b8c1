"""The kind `campaign`: acts of other kinds, an adversary's taps and radio, and stages that are declared."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from skyrange.attack.campaigns.checks import find_problems
from skyrange.attack.campaigns.course import MAX_STAGES
from skyrange.attack.campaigns.knowledge import Knowledge
from skyrange.attack.campaigns.params import CAMPAIGN_FACTS, CampaignKind, Stage
from skyrange.attack.campaigns.parts import make_parts, move_acts
from skyrange.attack.campaigns.stages import StagedAdversary
from skyrange.attack.contract import Attack, AttackContext, Place, move_place
from skyrange.attack.declaration import attack
from skyrange.contracts.params import Params, items
from skyrange.contracts.plugins.fields import param
from skyrange.core.errors import Problem


def move_stages(params: Any, by: Place) -> Params:
    """The parameters of a campaign with the places of its acts and sightings moved."""
    moved: Params = move_acts(params, by)
    return moved.model_copy(update={"stages": tuple(_moved(stage, by) for stage in params.stages)})


def _moved(stage: Stage, by: Place) -> Stage:
    if stage.until is None or stage.until.sighting is None:
        return stage
    sighting = stage.until.sighting
    seen = sighting.model_copy(update={"place": move_place(sighting.place, by)})
    return stage.model_copy(update={"until": stage.until.model_copy(update={"sighting": seen})})


@attack("campaign", **CAMPAIGN_FACTS)
class Campaign(CampaignKind):
    """Starts and stops acts of other kinds in stages, by what the adversary observes.

    The adversary goes from one stage to the next, and never back.
    """

    move = move_stages
    stages: Annotated[tuple[Stage, ...], BeforeValidator(items), Field(min_length=1, max_length=MAX_STAGES)] = param(
        "Stages in their order."
    )

    def find_problems(self) -> Iterator[Problem]:
        """Stages that cannot be gone through."""
        return find_problems(self.stages, self.acts, taps=bool(self.taps), receiver=self.receiver_m is not None)

    def build(self, context: AttackContext) -> Attack:
        """The campaign. Raises `InputError` for acts whose kind or parameters are wrong, or that exclude each other."""
        adversary = StagedAdversary(self.stages, Knowledge(context.origin))
        return make_parts(self, context, adversary, together=[stage.acts for stage in self.stages])
