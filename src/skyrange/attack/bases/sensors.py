"""Bases of kinds that alter sensor readings, between sensors and autopilots, and acts on readings without a method.

A kind with the base `OnSensors` that has an act on readings as its `act` needs no method. A reading is a column of
`Sensors` by its name, such as `baro_up_m`. The sham leaves the readings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from math import pi
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Acting, Facts
from skyrange.attack.params import Victims, check_vehicles
from skyrange.contracts.components import Floats, Ints, SensorAct, Sensors
from skyrange.contracts.params import Enu, Number, refuse
from skyrange.contracts.plugins.form import Kind, param, place_of, reads_fields, state
from skyrange.core.elementary import sin
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

SAMPLE_NS: Final = 100 * NS_PER_MS
"""A reading that did not change for so long was measured again."""
SAMPLED: Final = frozenset({"baro_up_m", "compass_gauss"})
"""Columns of sensors that repeat a reading until they measure again; inertial sensors measure at every tick."""


class AltersSensors(Acting):
    """Alters readings of the aircraft that its parameter `vehicles` names, or of all if it has no such parameter.

    One instance is the sensor fault of the whole attack. `on_sensors` writes into arrays whose rows are `vehicles`.
    """

    attack_facts: ClassVar[Facts] = {
        "counterfactual": "mute",
        "persists": "acts",
    }

    needs: ClassVar[tuple[str, ...]] = ("on_sensors",)
    slow: ClassVar[bool] = False
    """Whether it needs new readings alone: see `SensorHook`."""

    vehicles: Sequence[str]
    label: str
    """The sensor that labels name: the first of the kind's surface, such as "gnss", unless `prepare` sets another."""
    name: str
    """The actor in labels."""

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`. Raises `InputError` for aircraft that the scenario does not have, or no surface."""
        if "vehicles" not in type(self).declared_params:
            self.vehicles = tuple(sorted(context.vehicles))
        check_vehicles(context, self.vehicles)
        self.label = find_label(self)
        self.allocate(len(self.vehicles))
        return super().assemble(context)

    def allocate(self, count: int) -> None:
        """Set what has a row for each of `count` vehicles, before `prepare`."""

    def build(self, context: AttackContext) -> Attack:
        """Itself as a sensor fault."""
        self.name = f"{self.id}.{self.label}"
        return Attack(sensor_hooks=[self])

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        """Write into the readings once it acts, and return the acts to be labelled: see `SensorHook`."""
        raise NotImplementedError


class OnSensors(AltersSensors):
    """Alters readings from its start on: `act` writes them. The sham leaves them, and tells the same acts."""

    attack_facts: ClassVar[Facts] = {
        "load": "none, because a sensor signal takes no airtime of the range's links",
        "content": "the sham: the same act with unaltered readings",
    }

    needs: ClassVar[tuple[str, ...]] = ("act",)

    vehicles: Victims = param("Aircraft whose sensors are altered, such as ['blue/b1'].")
    begun: bool = False
    """Whether it has acted before."""
    held_readings: dict[str, Floats] = state(dict)
    """By column: the readings that `hold_reading` keeps."""

    def act(self, now: Time, sensors: Sensors) -> None:
        """Write into the readings of a tick."""
        raise NotImplementedError

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Alter them. Returns an act for each vehicle when it begins."""
        if now < self.schedule.start_ns:
            return []
        if not self.sham:
            self.act(now, sensors)
        if self.begun:
            return []
        self.begun = True
        return [SensorAct(vehicle, self.label) for vehicle in self.vehicles]

    def share(self, now: Time, rise_s: float) -> float:
        """Share of its full size of an error that grows from 0 at the start to 1 within `rise_s`; 0 is at once."""
        return min((now - self.schedule.start_ns) / NS_PER_S / rise_s, 1.0) if rise_s > 0.0 else 1.0


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


@dataclass(frozen=True, slots=True)
class Signal:
    """A signal that is added to a column of readings; the other fields name parameters, numbers or vectors."""

    column: Literal["gyro_radps", "accel_mps2", "baro_up_m", "compass_gauss"]
    constant: str
    amplitude: str
    unit: Callable[[float], float] = float
    """Converts a component of both to the unit of the column."""

    def of(self, size: Any) -> Floats:
        """The value of a parameter in the unit of the column, (axes,)."""
        return np.array([self.unit(component) for component in np.atleast_1d(size).tolist()])


class AddsSignal(OnSensors):
    """Adds an error to what a sensor measures: a constant and a sinusoid, which rise together from the start on.

    A slow sensor repeats its last reading until it measures again: the error is that of the time at which the reading
    changed.
    """

    attack_facts: ClassVar[Facts] = {"technique": "EX-0014.03"}

    needs: ClassVar[tuple[str, ...]] = ("signal",)
    signal: ClassVar[Signal]

    vehicles: Victims = param("Aircraft whose sensor is attacked, such as ['blue/b1'].")
    rise_s: Number = param(
        "Time in seconds in which the error grows from zero to its full size; 0 is at once.",
        default=0.0, ge=0, le=3_600,
    )  # fmt: skip
    frequency_hz: float
    constant: Floats
    amplitude: Floats
    samples: SampleDetector
    errors: Floats
    """(n, axes) Of the last measurements."""

    def find_problems(self) -> Iterator[Problem]:
        """No signal."""
        sizes = (self.signal.constant, self.signal.amplitude)
        return need_one(self, *[name for name in type(self).declared_params if name in sizes])

    def prepare(self, context: AttackContext) -> None:
        """Convert units."""
        self.constant, self.amplitude = (
            self.signal.of(getattr(self, name)) for name in (self.signal.constant, self.signal.amplitude)
        )
        self.samples = SampleDetector(len(self.vehicles))
        self.errors = np.zeros((len(self.vehicles), len(self.constant)))

    def act(self, now: Time, sensors: Sensors) -> None:
        """Add it."""
        column = self.signal.column
        readings = getattr(sensors, column)
        wave = sin(2.0 * pi * self.frequency_hz * ((now - self.schedule.start_ns) / NS_PER_S))
        error = self.share(now, self.rise_s) * (self.constant + wave * self.amplitude)
        if column in SAMPLED:
            readings = readings.reshape(self.errors.shape)  # a view, of one axis for the barometer
            self.errors[self.samples.fresh(now, readings)] = error
            readings += self.errors
        else:
            readings += error


def find_label(kind: Kind) -> str:
    """What labels of its acts name: the first of its surface. Raises `InputError` for a kind without one."""
    surface: Sequence[str] = kind.plugin.surface
    if not surface:
        raise InputError.one(place_of(type(kind)), "surface", "missing", "what it acts on, such as ('gnss',)")
    return surface[0]


def need_one(kind: Kind, *names: str) -> Iterator[Problem]:
    """A problem if all of these parameters, numbers or vectors, are zero."""
    if not any(np.any(np.asarray(getattr(kind, name))) for name in names):
        yield Problem(names[0], "zero", f"one of {', '.join(names)} other than zero")


def within(least: float, most: float, what: str) -> AfterValidator:
    """A validator of `Enu`: each component from `least` to `most`."""

    def check(vector: Any) -> Any:
        if not all(least <= component <= most for component in vector):
            raise refuse(Problem("", repr(list(vector)), f"each component from {least:g} to {most:g} {what}"))
        return vector

    return AfterValidator(check)


COLUMNS: Final = tuple(field.name for field in fields(Sensors))
"""Names of all readings."""


def alter_reading(column: str, change: str | Callable[[Any, Floats], Any]) -> Any:
    """Alter a reading: `change` is a function of the kind and the values, or the name of a parameter that is added.

    The values have a row for each aircraft; whole ones, such as a number of satellites, are rounded. Raises
    `InputError` for a reading that does not exist.
    """
    _check(column)

    def act(self: Any, now: Time, sensors: Sensors) -> None:
        true = getattr(sensors, column)
        false = np.asarray(true + np.asarray(getattr(self, change)) if isinstance(change, str) else change(self, true))
        true[...] = np.rint(false) if true.dtype.kind == "i" and false.dtype.kind == "f" else false

    return reads_fields(act, change)


def hold_reading(column: str) -> Any:
    """Keep a reading as it was when the act began.

    Raises `InputError` for a reading that does not exist.
    """
    _check(column)

    def act(self: Any, now: Time, sensors: Sensors) -> None:
        true = getattr(sensors, column)
        true[...] = self.held_readings.setdefault(column, true.copy())

    return act


def _check(column: str) -> None:
    if column not in COLUMNS:
        raise InputError.one("act", "reading", column, ", ".join(COLUMNS), nearest(column, COLUMNS))


SOUND_AT_AIRCRAFT: Final = {
    "amplitude at the aircraft": "assumed: a parameter, because it depends on sensor, distance and housing"
}
"""Realism of readings that sound alters."""
Accelerations = Annotated[Enu, within(-160.0, 160.0, "m/s²")]
"""Forward, left and up, up to 16 g: full scale of usual accelerometers."""
Rates = Annotated[Enu, within(-2_000.0, 2_000.0, "deg/s")]
"""About forward, left and up, up to the full scale of usual gyroscopes."""


class AddsSound(AddsSignal):
    """Adds the error that sound at the resonance of a MEMS sensor makes of its readings."""

    attack_facts: ClassVar[Facts] = {"equipment": "a loudspeaker and amplifier for the resonance"}
