"""Scenario options of ArduPilots: the table `[autopilots.options.ardupilot]`."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field, model_validator

from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import Problem

PORT_STEP: Final = 10
"""Between the open ports of two processes, as between two instances of SITL."""


class Options(Params):
    """How the ArduPilot processes of a scenario are run."""

    physics: Literal["shared", "native"] = Field(
        default="shared",
        description="Physics that moves the aircraft: shared, the range's, in lockstep; or native, ArduPilot's own "
        "simulation, on the machine's clock.",
    )
    speedup: Number = Field(
        default=1.0,
        gt=0,
        le=100,
        description="Simulated seconds per second of the machine's clock, with native physics; a slow machine runs as "
        "fast as it can.",
    )
    rates: Literal["full", "single", "reduced"] = Field(
        default="full",
        description="Rate of the main loop, and how often it reads the gyros per iteration: full, 400 Hz and twice; "
        "single, 400 Hz and once, without checks of the gyros before arming; reduced, 100 Hz and twice.",
    )
    keep_logs: bool = Field(default=False, description="Write DataFlash logs, and keep them in the run's folder.")
    open_port: int = Field(
        default=0,
        ge=0,
        le=65_535,
        description="TCP port, on all interfaces, on which the first ArduPilot obeys a ground station; that of each "
        "further one is 10 higher. 0: none.",
    )

    def opened(self, count: int) -> list[int]:
        """The TCP ports on which `count` processes accept ground stations; none unless `open_port` is set."""
        return [self.open_port + PORT_STEP * place for place in range(count)] if self.open_port else []

    @model_validator(mode="after")
    def _check_speedup(self) -> Options:
        if self.physics == "shared" and "speedup" in self.model_fields_set:
            hint = 'Lockstep runs as fast as it can, or as --speed says; or set physics = "native".'
            raise refuse(Problem("speedup", f"{self.speedup:g}", "left out with shared physics", hint))
        return self

    @model_validator(mode="after")
    def _check_rates(self) -> Options:
        if self.physics == "native" and self.rates == "single":
            hint = "It reduces the exchanges with the range's physics, and native physics has no exchanges."
            raise refuse(Problem("rates", "'single'", "'full' or 'reduced' with native physics", hint))
        return self
