"""Battery fade: the measured voltage sags under load as that of an aged battery does."""

from __future__ import annotations

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.sensors import need_one


@sky.fault(
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
class Fade(sky.OnSensors):
    """Lowers the voltage that the autopilot measures, as that of an aged battery sags."""

    vehicles: sky.Victims = sky.param("Aircraft whose battery fades, such as ['blue/b1'].")
    resistance_ohm: sky.Number = sky.param(
        "Resistance in ohms on top of its own: the voltage sags by it times current.", default=0.05, ge=0, le=10
    )
    drop_v: sky.Number = sky.param(
        "Loss of the resting voltage in volts, such as that of a failed cell.", default=0.0, ge=0, le=100
    )
    rise_s: sky.Number = sky.param(
        "Time in seconds in which both grow from zero to their full size; 0 is at once.", default=0.0, ge=0, le=36_000
    )

    def find_problems(self) -> sky.Problems:
        return need_one(self, "resistance_ohm", "drop_v")

    def act(self, now: sky.Time, sensors: sky.Sensors) -> None:
        sag_v = self.share(now, self.rise_s) * (self.resistance_ohm * sensors.battery_a + self.drop_v)
        sensors.battery_v[:] = np.maximum(sensors.battery_v - sag_v, 0.0)
