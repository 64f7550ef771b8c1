"""Scenario options of ArduPilots: the table `[autopilots.options.ardupilot]`."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field, model_validator

from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import Problem

PORT_STEP: Final = 10
"""Difference between the open ports of two processes, as between two instances of SITL."""


class ProcessOptions(Params):
    """Options that all fleets of ArduPilot processes have."""

    rates: Literal["full", "single", "reduced"] = Field(
        default="full",
        description="Rate of the main loop, and gyro readings per iteration. full: 400 Hz and two; single: 400 Hz and "
        "one, without the gyro checks before arming; reduced: 100 Hz and two.",
    )
    keep_logs: bool = Field(
        default=False, description="Whether to write DataFlash logs and keep them in the run's folder."
    )
    open_port: int = Field(
        default=0,
        ge=0,
        le=65_535,
        description="TCP port on which the first ArduPilot accepts a ground station and obeys it, on all network "
        "interfaces. The port of each further ArduPilot is 10 higher; 0 opens no port.",
    )

    first_channel: Literal["link", "private"] = Field(
        default="link",
        description="Port that is ArduPilot's first MAVLink channel, which it exempts from signing. link: that of the "
        "link autopilot, or with the operator's signing the private one; private: always the private one, so that a "
        "key which is set in flight counts on the link.",
    )

    def opened(self, count: int) -> list[int]:
        """The TCP ports on which `count` processes accept ground stations; none unless `open_port` is set."""
        return [self.open_port + PORT_STEP * place for place in range(count)] if self.open_port else []


class Options(ProcessOptions):
    """Options of the ArduPilot processes of a scenario."""

    physics: Literal["shared", "native"] = Field(
        default="shared",
        description="Physics that moves the aircraft. shared: the physics of the range, in lockstep; native: "
        "ArduPilot's own simulation, on the machine's clock.",
    )
    speedup: Number = Field(
        default=1.0,
        gt=0,
        le=100,
        description="Simulated seconds per second of the machine's clock, with native physics; a slow machine does "
        "not reach a high speedup.",
    )

    @model_validator(mode="after")
    def _check_speedup(self) -> Options:
        if self.physics == "shared" and "speedup" in self.model_fields_set:
            hint = 'Omit it, and use --speed to limit the speed of lockstep; or set physics = "native".'
            raise refuse(Problem("speedup", f"{self.speedup:g}", "no speedup with shared physics", hint))
        return self

    @model_validator(mode="after")
    def _check_rates(self) -> Options:
        if self.physics == "native" and self.rates == "single":
            hint = "single reduces the exchanges with the physics of the range, which native physics does not have."
            raise refuse(Problem("rates", "'single'", "'full' or 'reduced' with native physics", hint))
        return self
