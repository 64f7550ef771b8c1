"""Settings of a receiver that verifies after RFC 9575, as scenarios and defences declare them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from skyrange.contracts.params import Number

Authorities = Annotated[
    Literal["apex", "all"],
    Field(
        description="Keys that the receiver holds before the flight. apex: the root alone, so that it has to receive "
        "the Links of all authorities; all: those of all authorities of the range."
    ),
]
ClockError = Annotated[
    Number,
    Field(
        ge=-2,
        le=120,
        description="Error of the receiver's clock in seconds, positive when it is ahead. Outside these limits, every "
        "signature would be out of its time: it holds for 120 s, and clocks may differ by 2 s.",
    ),
]
VerificationRate = Annotated[
    Annotated[Number, Field(ge=1, le=100_000)] | None,
    Field(
        description="Signatures that the receiver can verify per second; what exceeds that is dropped. Default: no "
        "limit."
    ),
]
