"""Autopilots in a scenario: options of each kind, and the reaction to an autopilot that does not answer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, ValidationError, model_validator

from skyrange.contracts.params import Params
from skyrange.contracts.plugins.registry import AUTOPILOTS, kinds
from skyrange.core.errors import Problem, nearest
from skyrange.scenario.model.base import Model, Number, refuse
from skyrange.scenario.validation.error_messages import input_error
from skyrange.scenario.validation.plugin_params import checked, params_of
from skyrange.vehicle.contract import AutopilotPlugin


class Autopilots(Model):
    """Settings of autopilots that are separate programs."""

    on_silent: Literal["stop", "continue"] = Field(
        default="stop",
        description="Reaction to an autopilot that ends or does not answer in time: stop the run, or continue "
        "without it; the motors of a simulated aircraft then stop.",
    )
    on_unready: Literal["fail", "wait"] = Field(
        default="fail",
        description="Reaction to an autopilot that is not ready at time 0: fail ends the run, wait starts the run and "
        "lets the autopilot join later.",
    )
    deadline_s: Number = Field(
        default=5.0, gt=0, le=3600, description="Wall time in seconds within which an autopilot must answer each tick."
    )
    options: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="Options of each kind of autopilot, such as options.ardupilot."
    )

    @model_validator(mode="after")
    def _of_their_kinds(self) -> Autopilots:
        for kind in self.options:
            if kind not in kinds(AUTOPILOTS):
                raise refuse(Problem(f"options.{kind}", kind, "an autopilot", nearest(kind, kinds(AUTOPILOTS))))
            checked(AutopilotPlugin.find(kind), self.options[kind], f"options.{kind}")
        return self

    def with_options(self, kind: str, given: Mapping[str, Any], who: str) -> Autopilots:
        """A copy with the options `given` set for `kind`. Raises `InputError` for `who` if they are invalid."""
        data = self.model_dump() | {"options": {**self.options, kind: {**self.options.get(kind, {}), **given}}}
        try:
            return Autopilots.model_validate(data)
        except ValidationError as error:
            raise input_error(who, error, Autopilots, data) from None

    def params_of(self, kind: str) -> Params:
        """The options of a kind as its plugin's own model. Raises InputError if a required option is missing."""
        return params_of(AutopilotPlugin.find(kind), self.options.get(kind, {}), f"autopilots.options.{kind}")
