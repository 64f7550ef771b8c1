"""Battery fade: the measured voltage sags under load as that of an aged battery does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field, model_validator

from skyrange.attack.sensor.injection import need_one
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, Params
from skyrange.core.time import NS_PER_S, Time
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin


class Fade(Params):
    """Whose battery fades, and how much."""

    vehicles: Victims = Field(description="Aircraft whose battery fades, such as ['blue/b1'].")
    resistance_ohm: Number = Field(
        default=0.05,
        ge=0,
        le=10,
        description="Resistance in ohms that comes on top of the battery's own: the voltage sags by it times current.",
    )
    drop_v: Number = Field(
        default=0.0, ge=0, le=100, description="Loss of the resting voltage in volts, such as that of a failed cell."
    )
    rise_s: Number = Field(
        default=0.0,
        ge=0,
        le=36_000,
        description="Time in seconds in which both grow from zero to their full size; 0 is at once.",
    )

    @model_validator(mode="after")
    def _is_there(self) -> Fade:
        need_one(self, "resistance_ohm", "drop_v")
        return self


@dataclass(slots=True)
class SaggingVoltage:
    """A sensor fault that lowers the measured voltage by a part that grows with the current, and a constant one."""

    name: str
    vehicles: Sequence[str]
    resistance_ohm: float
    drop_v: float
    rise_s: float
    schedule: Schedule
    _begun: bool = False

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Lower it, to no less than 0 V. Returns an act for each vehicle when it begins."""
        if now < self.schedule.start_ns:
            return []
        share = 1.0
        if self.rise_s > 0.0:
            share = min((now - self.schedule.start_ns) / NS_PER_S / self.rise_s, 1.0)
        sag_v = share * (self.resistance_ohm * sensors.battery_a + self.drop_v)
        sensors.battery_v[:] = np.maximum(sensors.battery_v - sag_v, 0.0)
        if self._begun:
            return []
        self._begun = True
        return [SensorAct(vehicle, "battery") for vehicle in self.vehicles]


def make(params: Fade, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for aircraft that are not in the scenario."""
    check_vehicles(context, params.vehicles)
    fault = SaggingVoltage(
        f"{context.id}.battery",
        params.vehicles,
        params.resistance_ohm,
        params.drop_v,
        params.rise_s,
        context.schedule,
    )
    return FaultParts(faults=[fault])


BATTERY_FADE = FaultPlugin(
    Fade,
    make,
    "Lowers the voltage that the autopilot measures, as that of an aged battery sags.",
    surface=("battery",),
    effect="the battery's failsafe fires although charge is left",
    cause="age, cold, or a failed cell",
    not_modelled="the energy: the battery gives as much power as before, for as long, and the motors lose no thrust",
    realism={
        "measured voltage": "simulated: voltage at the terminals less resistance times current",
        "size of the resistance": "assumed: nothing was measured on an aircraft; the parameter says it",
    },
)
