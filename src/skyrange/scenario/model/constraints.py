"""Constraints in a scenario: the model of `[[constraints]]`, areas that are closed to flight."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from skyrange.contracts.params import Number, items, refuse
from skyrange.core.errors import Problem
from skyrange.scenario.model.base import Id, Model

Corner = Annotated[tuple[Number, Number], BeforeValidator(items, json_schema_input_type=list[float])]


class ConstraintTable(Model):
    """One area that flight approvals keep free of flights, such as around a fire."""

    id: Id = Field(description="Name, unique among the constraints.")
    corners_m: tuple[Corner, ...] = Field(
        min_length=3, max_length=100, description="Corners of the area: east and north of the origin in metres."
    )
    lower_m: Number = Field(default=0.0, ge=-1_000, le=10_000, description="Lower limit above the origin in metres.")
    upper_m: Number = Field(default=120.0, ge=-1_000, le=10_000, description="Upper limit above the origin in metres.")
    start_s: Number = Field(default=0.0, ge=0, description="Time from which on the area is closed, in seconds.")
    end_s: Number = Field(default=86_400.0, ge=0, description="Time until which the area is closed, in seconds.")
    published_s: Number = Field(
        default=0.0,
        ge=0,
        description="Time in seconds at which approvals learn of it. Intents that were accepted before are taken back, "
        "and aircraft in flight go around or return.",
    )

    @model_validator(mode="after")
    def _has_a_volume(self) -> ConstraintTable:
        problems = []
        if not self.lower_m < self.upper_m:
            problems.append(Problem("upper_m", str(self.upper_m), f"more than lower_m, {self.lower_m}"))
        if not self.start_s < self.end_s:
            problems.append(Problem("end_s", str(self.end_s), f"more than start_s, {self.start_s}"))
        if problems:
            raise refuse(*problems)
        return self
