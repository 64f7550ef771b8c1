"""Settings of the test of sight, as types that scenarios and the defence share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from skyrange.contracts.params import Number

MissedRate = Annotated[
    Number,
    Field(gt=0, lt=0.5, description="Probability that an honest aircraft is called not seen, by its own assumptions."),
]
FalseRate = Annotated[
    Number,
    Field(
        gt=0, lt=0.5, description="Probability that a claim where nothing flies is called seen, by its own assumptions."
    ),
]
PositionError = Annotated[
    Number,
    Field(
        gt=0,
        le=100,
        description="Standard deviation of a claimed position against the own one, on each axis, in metres.",
    ),
]
Air = Annotated[
    Literal["estimated", "clear"],
    Field(
        description="The air before its sensors. estimated: as thick as the returns of the map allow; clear: without "
        "rain, fog and dirt, as weather reports may say."
    ),
]
