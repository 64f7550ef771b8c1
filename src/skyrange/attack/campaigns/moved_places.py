"""Places in the parameters of a campaign, moved: those of its acts, and those where stages wait for a sighting."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from skyrange.attack.campaigns.params import CampaignAct, Stage
from skyrange.attack.contract import AttackPlugin, Place, move_place, moved
from skyrange.contracts.params import Params
from skyrange.core.errors import InputError


def move_acts(params: Any, by: Place) -> Any:
    """The parameters of a campaign with the places of its acts moved; an act that is wrong stays as it is."""
    return params.model_copy(update={"acts": {name: _moved_act(act, by) for name, act in params.acts.items()}})


def move_stages(params: Any, by: Place) -> Any:
    """The parameters of a campaign with the places of its acts and sightings moved."""
    stages = tuple(_moved_stage(stage, by) for stage in params.stages)
    return move_acts(params, by).model_copy(update={"stages": stages})


def _moved_act(act: CampaignAct, by: Place) -> CampaignAct:
    try:
        plugin = AttackPlugin.find(act.kind)
        settings: Params = moved(plugin, plugin.params.model_validate(act.params), by)
    except (ValidationError, InputError):
        return act  # named when it is made
    return act.model_copy(update={"params": settings.model_dump(exclude_none=True)})


def _moved_stage(stage: Stage, by: Place) -> Stage:
    if stage.until is None or stage.until.sighting is None:
        return stage
    sighting = stage.until.sighting
    seen = sighting.model_copy(update={"place": move_place(sighting.place, by)})
    return stage.model_copy(update={"until": stage.until.model_copy(update={"sighting": seen})})
