"""The kind `campaign`: acts of other kinds, an adversary's taps and radio, and stages that are declared."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.campaigns.checks import find_problems
from skyrange.attack.campaigns.moved_places import move_stages
from skyrange.attack.campaigns.params import CampaignKind, Stages
from skyrange.attack.campaigns.parts import make_parts
from skyrange.attack.campaigns.stages import StagedAdversary


@sky.attack("campaign")
class Campaign(CampaignKind):
    """Starts and stops acts of other kinds in stages, by what the adversary observes.

    The adversary goes from one stage to the next, and never back.
    """

    move = move_stages
    stages: Stages = sky.param("Stages in their order.")

    def find_problems(self) -> sky.Problems:
        """Stages that cannot be gone through."""
        return find_problems(self.stages, self.acts, taps=bool(self.taps), receiver=self.receiver_m is not None)

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """The campaign. Raises `InputError` for acts whose kind or parameters are wrong, or that exclude each other."""
        adversary = StagedAdversary(self.stages, sky.Knowledge(context.origin))
        return make_parts(self, context, adversary, together=[stage.acts for stage in self.stages])
