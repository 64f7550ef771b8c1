"""How are the autopilots' engines run? What each kind may be told, and what happens when one falls silent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, ValidationError, model_validator

from skyrange.agent.plugins import AUTOPILOTS, find, kinds
from skyrange.core.errors import Fault, nearest
from skyrange.scenario.base import Model, Number, refuse
from skyrange.scenario.faults import faults_of, input_error


class Autopilots(Model):
    """What holds for all autopilots that are programs."""

    on_silent: Literal["stop", "continue"] = Field(
        default="stop",
        description="When an autopilot gives no answer in time or ends: stop the run, or continue without it; its "
        "motors stop.",
    )
    on_unready: Literal["fail", "wait"] = Field(
        default="fail", description="When one is not ready at time 0: fail, or wait and let it come later."
    )
    deadline_s: Number = Field(
        default=5.0, gt=0, le=3600, description="Seconds of wall time in which it has to answer for a tick."
    )
    options: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="What a kind of autopilot may be told, by kind, such as options.ardupilot."
    )

    @model_validator(mode="after")
    def _made_once(self) -> Autopilots:
        """Making them finds what is wrong."""
        for kind in self.options:
            if kind not in kinds(AUTOPILOTS):
                raise refuse(Fault(f"options.{kind}", kind, "an autopilot", nearest(kind, kinds(AUTOPILOTS))))
            self.made(kind)
        return self

    def told(self, kind: str, given: Mapping[str, Any], who: str) -> Autopilots:
        """The same, but for what `kind` is told of `given`. Raises `InputError`, by `who`, where that does not fit."""
        data = self.model_dump() | {"options": {**self.options, kind: {**self.options.get(kind, {}), **given}}}
        try:
            return Autopilots.model_validate(data)
        except ValidationError as error:
            raise input_error(who, error, Autopilots, data) from None

    def made(self, kind: str) -> dict[str, Any]:
        """The keyword arguments that a kind's factory gets beside those that all get."""
        model = getattr(find(AUTOPILOTS, kind), "options", None)
        given = self.options.get(kind, {})
        if model is None:
            if given:
                raise refuse(Fault(f"options.{kind}", ", ".join(given), "none: it has no options"))
            return {}
        try:
            return {"options": model.model_validate(given)}
        except ValidationError as error:
            found = faults_of(error, model, given)
            raise refuse(*(Fault(f"options.{kind}.{f.where}", f.value, f.expected, f.hint) for f in found)) from None
