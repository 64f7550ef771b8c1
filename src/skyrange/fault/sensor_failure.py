"""Failure of a sensor: the barometer or the compass repeats one reading, or becomes noisy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from pydantic import Field

from skyrange.attack.sensor.injection import SampleDetector
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.contracts.components import Floats, SensorAct, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, Params
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import Time
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin

STREAM: Final = "fault.sensor_failure"
_COLUMNS: Final = {"barometer": ("baro", "baro_up_m"), "compass": ("compass", "compass_gauss")}


class Failure(Params):
    """Whose sensor fails, and how."""

    vehicles: Victims = Field(description="Aircraft whose sensor fails, such as ['blue/b1'].")
    sensor: Literal["barometer", "compass"] = Field(description="The sensor that fails.")
    failure: Literal["frozen", "noisy"] = Field(
        default="frozen",
        description="frozen: it repeats the reading that it had at the start of the fault; noisy: it adds white noise.",
    )
    noise_m: Number = Field(
        default=3.0, gt=0, le=1_000, description="Standard deviation in metres of the noise of a barometer."
    )
    noise_gauss: Number = Field(
        default=0.1, gt=0, le=10, description="Standard deviation in gauss, on each axis, of the noise of a compass."
    )


@dataclass(slots=True)
class FailedSensor:
    """A sensor fault that freezes a sensor, or adds `noise` to each of its measurements.

    A slow sensor repeats its reading until it measures again, and so does the noise.
    """

    name: str
    vehicles: Sequence[str]
    sensor: str
    column: str
    noise: float
    """Standard deviation, in the unit of the column; 0 for a frozen sensor."""
    chance: Chance
    schedule: Schedule
    slow: bool = True
    _begun: bool = False
    _samples: SampleDetector = field(init=False)
    _errors: Floats = field(init=False)

    def __post_init__(self) -> None:
        self._samples = SampleDetector(len(self.vehicles))
        self._errors = np.zeros((len(self.vehicles), 3))

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Freeze it, or add noise. Returns an act for each vehicle when it begins."""
        if now < self.schedule.start_ns:
            return []
        readings = getattr(sensors, self.column).reshape(len(self.vehicles), -1)
        raw = self._samples.raw[:, : readings.shape[1]]
        if self.noise:
            self._measure(now, readings)
            readings += self._errors[:, : readings.shape[1]]
        elif self._begun:
            readings[:] = raw
        else:
            raw[:] = readings
        getattr(sensors, self.column)[:] = readings.reshape(getattr(sensors, self.column).shape)
        if self._begun:
            return []
        self._begun = True
        return [SensorAct(vehicle, self.sensor) for vehicle in self.vehicles]

    def _measure(self, now: Time, readings: Floats) -> None:
        """New noise for the sensors that measured again."""
        for row in np.flatnonzero(self._samples.fresh(now, readings)).tolist():
            who = hash64(f"{self.name}|{self.vehicles[row]}")
            uniforms = np.array([self.chance.uniform4(STREAM, who, now, k) for k in range(3)])
            self._errors[row] = self.noise * np.sqrt(3.0) * (uniforms.sum(axis=1) - 2.0)  # variance of the sum: 1/3


def make(params: Failure, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for aircraft that are not in the scenario."""
    check_vehicles(context, params.vehicles)
    sensor, column = _COLUMNS[params.sensor]
    noise = params.noise_m if params.sensor == "barometer" else params.noise_gauss
    fault = FailedSensor(
        f"{context.id}.{sensor}",
        params.vehicles,
        sensor,
        column,
        noise if params.failure == "noisy" else 0.0,
        context.chance,
        context.schedule,
    )
    return FaultParts(faults=[fault])


SENSOR_FAILURE = FaultPlugin(
    Failure,
    make,
    "Freezes the barometer or the compass, or makes it noisy.",
    surface=("baro", "compass"),
    effect="the estimator follows a reading that no longer moves, or one that jumps",
    cause="a hung sensor or bus, water in the pressure port, or a loose magnetometer",
    not_modelled="a sensor that stops answering, which an autopilot marks as unhealthy; a second sensor to change to",
    realism={
        "frozen readings": "assumed: the reading at the start of the fault, at every tick",
        "noise": "assumed: white, the sum of four uniforms; new with every measurement",
    },
)
