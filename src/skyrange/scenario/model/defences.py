"""Defences in a scenario: the model of `[[defences]]`, with kind, parameters and times."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from skyrange.contracts.params import Params
from skyrange.contracts.plugins import DEFENCES
from skyrange.defence.contract import DefencePlugin
from skyrange.scenario.model.base import Id, Model, Number, wrong
from skyrange.scenario.validation.plugin_params import known, normalized


class DefenceTable(Model):
    """One defence: its kind and parameters, and when it acts. Frames that arrive meet the first declared one first."""

    id: Id = Field(description="Name, unique among attacks, faults, defences and detectors; used in alerts and events.")
    kind: Annotated[str, known(DEFENCES, "a kind of defence")] = Field(
        description="Kind of defence, a plugin of skyrange.defences."
    )
    start_s: Number = Field(
        default=0.0, ge=0, le=31_536_000, description="Simulated time in seconds from which it acts."
    )
    stop_s: Number | None = Field(
        default=None, gt=0, le=31_536_000, description="Simulated time in seconds at which it stops; default: never."
    )
    muted: bool = Field(default=False, strict=True, description="Whether to run it and discard its output.")
    params: dict[str, Any] = Field(default_factory=dict, validate_default=True, description="Parameters of the kind.")

    @field_validator("params")
    @classmethod
    def _of_its_kind(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters, checked and completed with the kind's defaults; unchanged if the kind is unknown."""
        return normalized(DefencePlugin.find(info.data["kind"]), params) if "kind" in info.data else params

    @field_validator("stop_s")
    @classmethod
    def _stops_after_it_starts(cls, stop_s: float | None, info: ValidationInfo) -> float | None:
        start_s = info.data.get("start_s", 0.0)
        if stop_s is not None and stop_s <= start_s:
            raise wrong(f"{stop_s:g}", f"more than start_s, {start_s:g}")
        return stop_s

    @property
    def plugin(self) -> DefencePlugin:
        """The plugin of its kind."""
        return DefencePlugin.find(self.kind)

    @property
    def settings(self) -> Params:
        """The parameters as the kind's own model."""
        return self.plugin.params.model_validate(self.params)
