"""The kind `campaign`: acts of other kinds, an adversary's taps and radio, and stages that are declared."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from skyrange.attack.campaigns.checks import find_problems
from skyrange.attack.campaigns.course import MAX_STAGES
from skyrange.attack.campaigns.knowledge import Knowledge
from skyrange.attack.campaigns.params import Act, Means, Stage, Statement, param_of_means
from skyrange.attack.campaigns.parts import make_parts, move_acts
from skyrange.attack.campaigns.stages import StagedAdversary
from skyrange.attack.contract import Attack, AttackContext, Controls, Place, ThreatModel, move_place
from skyrange.attack.declaration import Composite, attack
from skyrange.attack.on_path import Names
from skyrange.contracts.params import Enu, Params, items
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


@attack(
    "campaign",
    places=("receiver_m",),
    surface=("gcs", "log", "autopilot", "medium", "gnss"),
    persists="flight",
    effect="those of its acts, one after the other, when the victims are where the adversary wants them",
    threat=ThreatModel(
        knowledge="stated in its parameters, and what it observes",
        position="that of its taps, radio and acts",
        equipment="that of its acts",
        budget="that of its acts",
    ),
    controls=Controls(
        load="the sham: the shams of its acts in the same stages",
        content="those of its acts",
        placement="those of its acts",
    ),
)
class Campaign(Composite):
    """Starts and stops acts of other kinds in stages, by what the adversary observes.

    The adversary goes from one stage to the next, and never back.
    """

    move = move_stages
    acts: dict[str, Act] = param_of_means("acts")  # type: ignore[assignment]  # nobody asks a campaign `acts(now)`
    taps: Names = param_of_means("taps")
    receiver_m: Enu | None = param_of_means("receiver_m")
    threat: Statement = param_of_means("threat")
    stages: Annotated[tuple[Stage, ...], BeforeValidator(items), Field(min_length=1, max_length=MAX_STAGES)] = param(
        "Stages in their order."
    )

    def find_problems(self) -> Iterator[Problem]:
        """Stages that cannot be gone through."""
        return find_problems(self.stages, self.acts, taps=bool(self.taps), receiver=self.receiver_m is not None)

    def build(self, context: AttackContext) -> Attack:
        """The campaign. Raises `InputError` for acts whose kind or parameters are wrong, or that exclude each other."""
        means = Means(acts=self.acts, taps=self.taps, receiver_m=self.receiver_m, threat=self.threat)
        adversary = StagedAdversary(self.stages, Knowledge(context.origin))
        return make_parts(means, context, adversary, together=[stage.acts for stage in self.stages])
