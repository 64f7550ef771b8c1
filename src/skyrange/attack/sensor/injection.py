"""Injected sensor signals: a constant or oscillating error that a physical signal adds to a sensor's readings.

The error is added to what the sensor measures, between the world and the autopilots. It is 0 at the start of the attack
and reaches its full size after `rise_s`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import pi, sin
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.gnss.false_fixes import within
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.contracts.components import Floats, Ints, SensorAct, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, Params, refuse
from skyrange.core.errors import Problem
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

Column = Literal["gyro_radps", "accel_mps2", "baro_up_m", "compass_gauss"]
SAMPLE_NS: Final = 100 * NS_PER_MS
"""A reading that did not change for so long was measured again."""

Rates = Annotated[Enu, within(-2_000.0, 2_000.0, "deg/s")]
"""Full scale of usual gyroscopes."""
Accelerations = Annotated[Enu, within(-160.0, 160.0, "m/s²")]
"""16 g, full scale of usual accelerometers."""
Fields = Annotated[Enu, within(-10.0, 10.0, "gauss")]


class Injected(Params):
    """Whose sensors, and how fast the error grows."""

    vehicles: Victims = Field(description="Aircraft whose sensor is attacked, such as ['blue/b1'].")
    rise_s: Number = Field(
        default=0.0,
        ge=0,
        le=3_600,
        description="Time in seconds in which the error grows from zero to its full size; 0 is at once.",
    )


def need_one(params: Params, *names: str) -> None:
    """Raises an error if all of these parameters, numbers or vectors, are zero."""
    if not any(np.any(np.asarray(getattr(params, name))) for name in names):
        raise refuse(
            Problem(names[0], "zero", f"one of {', '.join(names)} other than zero" if names[1:] else "another")
        )


@dataclass(frozen=True, slots=True)
class Signal:
    """An error over time: a constant part and a sinusoid, per axis, that rise together."""

    constant: Place
    amplitude: Place
    frequency_hz: float
    rise_s: float

    def at(self, seconds: float) -> Floats:
        """The error (3,) so long after the start."""
        share = min(seconds / self.rise_s, 1.0) if self.rise_s > 0.0 else 1.0
        wave = sin(2.0 * pi * self.frequency_hz * seconds)
        return share * (np.array(self.constant) + wave * np.array(self.amplitude))


@dataclass(slots=True)
class SampleDetector:
    """Finds which of `count` slow sensors have measured again: their reading changed, or is as old as a sample."""

    count: int
    raw: Floats = field(init=False)
    """(count, 3) the last measurements, of as many axes as the sensor has."""
    _at: Ints = field(init=False)

    def __post_init__(self) -> None:
        self.raw = np.full((self.count, 3), np.nan)
        self._at = np.zeros(self.count, dtype=np.int64)

    def fresh(self, now: Time, readings: Floats) -> NDArray[np.bool_]:
        """(count,) whether each has measured again, by its `readings` (count, axes), which are kept."""
        known = self.raw[:, : readings.shape[1]]
        fresh = np.asarray((readings != known).any(axis=1) | (now - self._at >= SAMPLE_NS))
        known[fresh] = readings[fresh]
        self._at[fresh] = now
        return fresh


@dataclass(slots=True)
class Injection:
    """A fault that adds a signal to one sensor of its vehicles.

    A slow sensor (`sampled`) repeats its last reading until it measures again: the error is that of the time at which
    the reading changed. Inertial sensors measure at every tick.
    """

    name: str
    vehicles: Sequence[str]
    sensor: str
    column: Column
    sampled: bool
    signal: Signal
    schedule: Schedule
    sham: bool
    _begun: bool = False
    _samples: SampleDetector = field(init=False)
    _errors: Floats = field(init=False)

    def __post_init__(self) -> None:
        self._samples = SampleDetector(len(self.vehicles))
        self._errors = np.zeros((len(self.vehicles), 3))

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Add the signal. Returns an act for each vehicle when it begins."""
        if self.schedule.start_ns > now:
            return []
        readings = getattr(sensors, self.column)
        if not self.sham:
            error = self.signal.at((now - self.schedule.start_ns) / NS_PER_S)
            if self.sampled:
                self._errors[self._samples.fresh(now, readings.reshape(len(self.vehicles), -1))] = error
                readings += self._errors[:, 0] if readings.ndim == 1 else self._errors
            else:
                readings += error
        if self._begun:
            return []
        self._begun = True
        return [SensorAct(vehicle, self.sensor) for vehicle in self.vehicles]


def inject(params: Injected, signal: Signal, column: Column, context: AttackContext) -> Attack:
    """The attack on one sensor, or its sham. Raises `InputError` for aircraft that are not in the scenario."""
    check_vehicles(context, params.vehicles)
    sensor = {"gyro_radps": "gyro", "accel_mps2": "accel", "baro_up_m": "baro", "compass_gauss": "compass"}[column]
    sampled = column in ("baro_up_m", "compass_gauss")
    fault: Any = Injection(
        f"{context.id}.{sensor}", params.vehicles, sensor, column, sampled, signal, context.schedule, context.sham
    )
    return Attack(faults=[fault])
