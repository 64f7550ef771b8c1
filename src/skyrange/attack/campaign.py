"""The kind `campaign`: acts of other kinds, an adversary's taps and radio, and stages that are declared."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

import skyrange.plugin as sky
from skyrange.attack.campaigns.checks import find_problems
from skyrange.attack.campaigns.course import MAX_STAGES
from skyrange.attack.campaigns.params import CampaignKind, Stage
from skyrange.attack.campaigns.parts import make_parts, move_acts
from skyrange.attack.campaigns.stages import StagedAdversary
from skyrange.attack.contract import move_place


def move_stages(params: Any, by: sky.Place) -> sky.Params:
    """The parameters of a campaign with the places of its acts and sightings moved."""
    moved: sky.Params = move_acts(params, by)
    return moved.model_copy(update={"stages": tuple(_moved(stage, by) for stage in params.stages)})


def _moved(stage: Stage, by: sky.Place) -> Stage:
    if stage.until is None or stage.until.sighting is None:
        return stage
    sighting = stage.until.sighting
    seen = sighting.model_copy(update={"place": move_place(sighting.place, by)})
    return stage.model_copy(update={"until": stage.until.model_copy(update={"sighting": seen})})


@sky.attack("campaign")
class Campaign(CampaignKind):
    """Starts and stops acts of other kinds in stages, by what the adversary observes.

    The adversary goes from one stage to the next, and never back.
    """

    move = move_stages
    stages: Annotated[tuple[Stage, ...], BeforeValidator(sky.items), Field(min_length=1, max_length=MAX_STAGES)] = (
        sky.param("Stages in their order.")
    )

    def find_problems(self) -> sky.Problems:
        """Stages that cannot be gone through."""
        return find_problems(self.stages, self.acts, taps=bool(self.taps), receiver=self.receiver_m is not None)

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """The campaign. Raises `InputError` for acts whose kind or parameters are wrong, or that exclude each other."""
        adversary = StagedAdversary(self.stages, sky.Knowledge(context.origin))
        return make_parts(self, context, adversary, together=[stage.acts for stage in self.stages])
