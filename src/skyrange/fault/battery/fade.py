"""Battery fade: the measured voltage sags under load as that of an aged battery does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from skyrange.attack.bases.sensors import OnSensors, need_one
from skyrange.attack.victims import Victims
from skyrange.contracts.components import Sensors
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.errors import Problem
from skyrange.core.time import Time
from skyrange.fault.declaration import fault


@fault(
    "battery.fade",
    surface=("battery",),
    effect="the battery's failsafe fires although charge is left",
    cause="age, cold, or a failed cell",
    not_modelled="the energy: the battery gives as much power as before, for as long, and the motors lose no thrust",
    realism={
        "measured voltage": "simulated: voltage at the terminals less resistance times current",
        "size of the resistance": "assumed: nothing was measured on an aircraft; the parameter says it",
    },
)
class Fade(OnSensors):
    """Lowers the voltage that the autopilot measures, as that of an aged battery sags."""

    vehicles: Victims = param("Aircraft whose battery fades, such as ['blue/b1'].")
    resistance_ohm: Number = param(
        "Resistance in ohms that comes on top of the battery's own: the voltage sags by it times current.",
        default=0.05, ge=0, le=10,
    )  # fmt: skip
    drop_v: Number = param(
        "Loss of the resting voltage in volts, such as that of a failed cell.", default=0.0, ge=0, le=100
    )
    rise_s: Number = param(
        "Time in seconds in which both grow from zero to their full size; 0 is at once.", default=0.0, ge=0, le=36_000
    )

    def find_problems(self) -> Iterator[Problem]:
        """No sag."""
        return need_one(self, "resistance_ohm", "drop_v")

    def act(self, now: Time, sensors: Sensors) -> None:
        """Lower it, to no less than 0 V."""
        sag_v = self.share(now, self.rise_s) * (self.resistance_ohm * sensors.battery_a + self.drop_v)
        sensors.battery_v[:] = np.maximum(sensors.battery_v - sag_v, 0.0)
