"""Emergency landings in a scenario: how a companion looks for a place when its autopilot begins to land."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, Strict

from skyrange.scenario.model.base import Model, Number, Whole


class Landing(Model):
    """How a companion finds a place to land, when its autopilot goes to LAND in flight."""

    kind: Literal["depth"] = Field(
        default="depth", description="depth: on a flat place that a range sensor that looks down shows."
    )
    clear_m: Number = Field(
        default=2.0,
        ge=0.5,
        le=5,
        description="Radius in metres of the disc that has to be flat: the aircraft, the error of its position, and a "
        "margin.",
    )
    rough_m: Number = Field(
        default=0.3, gt=0, le=2, description="Largest deviation of the disc from a plane, in metres."
    )
    slope_deg: Number = Field(default=8.0, gt=0, le=45, description="Largest slope of that plane in degrees.")
    look_m: Number = Field(
        default=6.0,
        ge=2,
        le=100,
        description="Height in metres above the highest surface below, from which it looks first; the second look is "
        "from three quarters of it.",
    )
    second_look: Annotated[bool, Strict()] = Field(
        default=True,
        description="Whether it looks again from nearer, above the place, and lands only if both looks agree.",
    )
    moves: Whole = Field(default=8, ge=0, le=100, description="How often it moves on, before it lands where it is.")


AnyLanding = Annotated[
    Landing | None,
    BeforeValidator(
        lambda value: {"kind": value} if isinstance(value, str) else value, json_schema_input_type=Landing | str | None
    ),
    Field(
        description="Emergency landing: how its companion finds a place when its autopilot goes to LAND in flight; it "
        "needs a radio medium and a LiDAR or a depth camera that looks down. Short form: depth. Default: it does not."
    ),
]
"""A landing table; the short form is the name of the kind."""
