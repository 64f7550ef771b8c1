"""Defences and detectors in a scenario: the models of `[[defences]]` and `[[detectors]]`: kind, parameters, place."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from skyrange.contracts.monitors import DetectorPlugin
from skyrange.contracts.params import Params
from skyrange.contracts.plugins.registry import DEFENCES, DETECTORS
from skyrange.core.time import NS_PER_US, Time
from skyrange.defence.contract import DefencePlugin
from skyrange.scenario.model.attacks import PluginTable, manual_start
from skyrange.scenario.model.base import Id, Model, Number
from skyrange.scenario.validation.plugin_params import known, normalized


class DefenceCost(Model):
    """Time that a defence needs of the processor of its endpoint, which has one for all its links and defences."""

    us_per_frame: Number = Field(
        ge=0,
        le=10_000_000,
        description="Processor time in µs for each frame that it inspects, before it decides on it.",
    )

    @property
    def ns_per_frame(self) -> Time:
        """The same in whole ns."""
        return round(self.us_per_frame * NS_PER_US)


class DefenceTable(PluginTable):
    """One defence: its kind and parameters, and when it acts. Frames that arrive meet the first declared one first."""

    id: Id = Field(description="Name, unique among attacks, faults, defences and detectors; used in alerts and events.")
    kind: Annotated[str, known(DEFENCES, "a kind of defence")] = Field(
        description="Kind of defence, a plugin of skyrange.defences."
    )
    start_s: Number = Field(
        default=0.0,
        ge=0,
        le=31_536_000,
        description="Simulated time in seconds from which it acts, or waits for a start by hand.",
    )
    stop_s: Number | None = Field(
        default=None, gt=0, le=31_536_000, description="Simulated time in seconds at which it stops; default: never."
    )
    manual: bool = manual_start()
    muted: bool = Field(default=False, strict=True, description="Whether to run it and discard its output.")
    params: dict[str, Any] = Field(default_factory=dict, validate_default=True, description="Parameters of the kind.")

    cost: DefenceCost | None = Field(
        default=None,
        description="Processor time that it takes at its endpoints, such as { us_per_frame = 20 }; default: none, "
        "so that it is free of charge.",
    )

    @property
    def plugin(self) -> DefencePlugin:
        """The plugin of its kind."""
        return self._find(self.kind)

    @classmethod
    def _find(cls, kind: str) -> DefencePlugin:
        return DefencePlugin.find(kind)


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
