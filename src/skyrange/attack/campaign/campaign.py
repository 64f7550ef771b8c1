"""The kind `campaign`: acts of other kinds, an adversary's taps and radio, and stages that are declared."""

from __future__ import annotations

from skyrange.attack.campaign.knowledge import Knowledge
from skyrange.attack.campaign.params import Campaign, Stage
from skyrange.attack.campaign.parts import make_parts, move_acts
from skyrange.attack.campaign.stages import StagedAdversary
from skyrange.attack.contract import (
    Attack,
    AttackContext,
    AttackPlugin,
    Controls,
    Place,
    ThreatModel,
    move_place,
)
from skyrange.attack.techniques import NO_FIT


def make(params: Campaign, context: AttackContext) -> Attack:
    """The campaign. Raises `InputError` for acts whose kind or parameters are wrong, or that exclude each other."""
    adversary = StagedAdversary(params.stages, Knowledge(context.origin))
    return make_parts(params, context, adversary, together=[stage.acts for stage in params.stages])


def move_stages(params: Campaign, by: Place) -> Campaign:
    """The campaign with the places of its acts and sightings moved."""
    return move_acts(params, by).model_copy(update={"stages": tuple(_moved(stage, by) for stage in params.stages)})


def _moved(stage: Stage, by: Place) -> Stage:
    if stage.until is None or stage.until.sighting is None:
        return stage
    sighting = stage.until.sighting
    seen = sighting.model_copy(update={"place": move_place(sighting.place, by)})
    return stage.model_copy(update={"until": stage.until.model_copy(update={"sighting": seen})})


CAMPAIGN = AttackPlugin(
    Campaign,
    make,
    "Starts and stops acts of other kinds in stages, by what the adversary observes.",
    technique=NO_FIT,
    places=("receiver_m",),
    move=move_stages,
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
