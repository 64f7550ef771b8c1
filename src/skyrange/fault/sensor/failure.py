"""Failure of a sensor: the barometer or the compass repeats one reading, or becomes noisy."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.sensors import SampleDetector

STREAM: Final = "fault.sensor_failure"
COLUMNS: Final = {"barometer": ("baro", "baro_up_m"), "compass": ("compass", "compass_gauss")}


@sky.fault(
    "sensor.failure",
    surface=("baro", "compass"),
    effect="the estimator follows a reading that no longer moves, or one that jumps",
    cause="a hung sensor or bus, water in the pressure port, or a loose magnetometer",
    not_modelled="a sensor that stops answering, which an autopilot marks as unhealthy; a second sensor to change to",
    realism={
        "frozen readings": "assumed: the reading at the start of the fault, at every tick",
        "noise": "assumed: white, the sum of four uniforms; new with every measurement",
    },
)
class Failure(sky.OnSensors):
    """Freezes the barometer or the compass, or makes it noisy.

    A slow sensor repeats its reading until it measures again, and so does the noise.
    """

    slow = True

    vehicles: sky.Victims = sky.param("Aircraft whose sensor fails, such as ['blue/b1'].")
    sensor: Literal["barometer", "compass"] = sky.param("The sensor that fails.")
    failure: Literal["frozen", "noisy"] = sky.param(
        "frozen: it repeats the reading at the start of the fault; noisy: it adds white noise.", default="frozen"
    )
    noise_m: sky.Number = sky.param("Noise of a barometer in metres, 1 sigma.", default=3.0, gt=0, le=1_000)
    noise_gauss: sky.Number = sky.param("Noise of a compass in gauss, 1 sigma, on each axis.", default=0.1, gt=0, le=10)
    column: str
    noise: float
    chance: sky.Chance
    samples: SampleDetector
    errors: sky.Floats
    """(n, 3) Of the last measurements."""

    def prepare(self, context: sky.FaultContext) -> None:
        self.label, self.column = COLUMNS[self.sensor]
        self.noise = self.noise_m if self.sensor == "barometer" else self.noise_gauss
        self.chance, self.samples = context.chance, SampleDetector(len(self.vehicles))
        self.errors = np.zeros((len(self.vehicles), 3))

    def act(self, now: sky.Time, sensors: sky.Sensors) -> None:
        readings = getattr(sensors, self.column).reshape(len(self.vehicles), -1)  # a view, of one or three axes
        held = self.samples.raw[:, : readings.shape[1]]
        if self.failure == "noisy":
            self._measure(now, readings)
            readings += self.errors[:, : readings.shape[1]]
        elif self.begun:
            readings[:] = held
        else:
            held[:] = readings

    def _measure(self, now: sky.Time, readings: sky.Floats) -> None:
        """New noise for the sensors that measured again."""
        for row in np.flatnonzero(self.samples.fresh(now, readings)).tolist():
            who = sky.hash64(f"{self.name}|{self.vehicles[row]}")
            uniforms = np.array([self.chance.uniform4(STREAM, who, now, k) for k in range(3)])
            self.errors[row] = self.noise * np.sqrt(3.0) * (uniforms.sum(axis=1) - 2.0)  # variance of the sum: 1/3
