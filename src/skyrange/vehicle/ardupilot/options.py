"""What may a scenario tell of its ArduPilots? The table `[autopilots.options.ardupilot]`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from skyrange.agent.settings import Number, Params, refuse
from skyrange.core.errors import Fault


class Options(Params):
    """How the ArduPilot processes of a scenario are run."""

    physics: Literal["shared", "native"] = Field(
        default="shared",
        description="Whose forces move them: the range's, in lockstep, or those of ArduPilot's own simulation, on the "
        "machine's clock.",
    )
    speedup: Number = Field(
        default=1.0,
        gt=0,
        le=100,
        description="Simulated seconds per second of the machine's clock, with native physics; more than the machine "
        "can is as fast as it can.",
    )
    keep_logs: bool = Field(default=False, description="Write DataFlash logs, and keep them in the run's folder.")

    @model_validator(mode="after")
    def _only_native_is_sped_up(self) -> Options:
        if self.physics == "shared" and "speedup" in self.model_fields_set:
            hint = 'Lockstep goes as fast as it can, or as --speed says; or set physics = "native".'
            raise refuse(Fault("speedup", f"{self.speedup:g}", "left out with shared physics", hint))
        return self
