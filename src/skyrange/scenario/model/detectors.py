"""Detectors in a scenario: the model of `[[detectors]]`, with kind, links and parameters."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from skyrange.contracts.detectors import DetectorPlugin
from skyrange.contracts.params import Params
from skyrange.contracts.plugins.registry import DETECTORS
from skyrange.scenario.model.base import Id, Model
from skyrange.scenario.validation.plugin_params import known, normalized


class DetectorTable(Model):
    """One detector. It listens to links and raises alerts, and does not alter any frame."""

    id: Id = Field(description="Name, unique among the detectors; used in alerts and figures.")
    kind: Annotated[str, known(DETECTORS, "a kind of detector")] = Field(
        description="Kind of detector, a plugin of skyrange.detectors."
    )
    links: tuple[Annotated[str, Field(min_length=1)], ...] = Field(
        default=("gcs:*",),
        min_length=1,
        description="Links to listen to: names such as 'gcs:blue/b1', or patterns with *.",
    )
    side: str = Field(
        default="gcs",
        min_length=1,
        description="End of those links at which to listen: the role of an endpoint such as 'gcs' or 'companion', the "
        "name of an endpoint, or a pattern; * means both ends.",
    )
    params: dict[str, Any] = Field(default_factory=dict, validate_default=True, description="Parameters of the kind.")

    @field_validator("params")
    @classmethod
    def _of_its_kind(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters, checked and completed with the kind's defaults; unchanged if the kind is unknown."""
        return normalized(DetectorPlugin.find(info.data["kind"]), params) if "kind" in info.data else params

    @property
    def plugin(self) -> DetectorPlugin:
        """The plugin of its kind."""
        return DetectorPlugin.find(self.kind)

    @property
    def settings(self) -> Params:
        """The parameters as the kind's own model."""
        return self.plugin.params.model_validate(self.params)
