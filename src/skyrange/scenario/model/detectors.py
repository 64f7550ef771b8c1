"""Detectors in a scenario: `[[detectors]]`, their kind, the links that they listen to, their parameters."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from skyrange.contracts.detectors import DetectorPlugin
from skyrange.contracts.params import Params
from skyrange.contracts.plugins import DETECTORS
from skyrange.scenario.model.base import Id, Model
from skyrange.scenario.validation.plugin_params import known, normalized


class DetectorTable(Model):
    """One detector: it listens to links and raises alerts, and alters nothing."""

    id: Id = Field(description="Name, unique among the detectors: in alerts and figures.")
    kind: Annotated[str, known(DETECTORS, "a kind of detector")] = Field(
        description="How it detects, a plugin of skyrange.detectors."
    )
    links: tuple[Annotated[str, Field(min_length=1)], ...] = Field(
        default=("gcs:*",),
        min_length=1,
        description="The links that it listens to: names such as 'gcs:blue/b1', or patterns with *.",
    )
    side: str = Field(
        default="gcs",
        min_length=1,
        description="At which end of them it listens: an endpoint's role such as 'gcs' or 'companion', an endpoint, or "
        "a pattern; * for both ends.",
    )
    params: dict[str, Any] = Field(
        default_factory=dict, validate_default=True, description="The kind's own parameters."
    )

    @field_validator("params")
    @classmethod
    def _of_its_kind(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters with every default; untouched where the kind is unknown."""
        return normalized(DetectorPlugin.find(info.data["kind"]), params) if "kind" in info.data else params

    @property
    def plugin(self) -> DetectorPlugin:
        """The plugin of its kind."""
        return DetectorPlugin.find(self.kind)

    @property
    def settings(self) -> Params:
        """The parameters as the kind's own model."""
        return self.plugin.params.model_validate(self.params)
