"""Sensors of the aircraft: their quality and their current readings.

A sensor is a physical thing on the body, so it belongs to the world: it samples the true state at its own instants,
and a reading holds until the next one. `SensorSpec` is what a scenario sets; `SensorSuite` holds the sensors of all
aircraft of a world. Declared sensor faults are applied afterwards, in the kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import READINGS_NS, Floats, Sensors
from skyrange.core.arrays import as_read_only
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_S, Time
from skyrange.world.sensing import sensor_errors
from skyrange.world.sensing.geomagnetism import MagneticField

_NO_CHANCE = Chance(0)


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """Quality of the sensors, and the magnetic field at their place.

    `noise` multiplies every error of `sensor_errors`: 1 is a usual small aircraft, 0 is ideal (every reading is the
    truth of the tick, the fix has neither delay nor outage). `warming_k` is by how many kelvin the sensors warm up,
    `instability` scales the biases that wander in a run, and `gnss` the slow error and the velocity error of receivers:
    what a defence need not know. `field_enu_gauss` is the Earth's magnetic field there; if it is zero there is no
    compass.
    """

    noise: float = 0.0
    field_enu_gauss: MagneticField = (0.0, 0.0, 0.0)
    chance: Chance = _NO_CHANCE
    warming_k: float = 0.0
    instability: float = 0.0
    gnss: float = 1.0


IDEAL = SensorSpec()


class SensorSuite:
    """The sensors of a world's aircraft. Deep copies continue alike; the readings of an aircraft depend on no other
    aircraft.
    """

    def __init__(
        self,
        spec: SensorSpec,
        vehicles: Sequence[str],
        state: tuple[Floats, ...],
        commands: Floats,
        power: tuple[Floats, Floats, Floats],
    ) -> None:
        """`state`: the world's own arrays of rates, specific force, attitude, position, velocity, height over ground.

        `commands` (n, motors) and `power`, (n,) volts, (n,) amperes and (n, motors) rotor speeds in rad/s, are read
        too. None is written.
        """
        n = len(vehicles)
        self._level = float(spec.noise)
        self._warming_k, self._instability, self._gnss_scale = map(float, (spec.warming_k, spec.instability, spec.gnss))
        self._warm, self._drift = np.zeros((n, 7)), np.zeros((n, 6))
        self._seed = np.uint64(spec.chance.seed & 0xFFFFFFFFFFFFFFFF)
        self._who = np.array([hash64(vehicle) for vehicle in vehicles], dtype=np.uint64)
        self._field = np.array(spec.field_enu_gauss, dtype=np.float64)
        self._sampled_ns: Time | None = None
        self._compass, self._accuracy = np.zeros((n, 3)), np.zeros((n, 3))
        self._fix: NDArray[np.int64] = np.full(n, sensor_errors.FIX_RTK, dtype=np.int64)
        self._satellites: NDArray[np.int64] = np.full(n, sensor_errors.GNSS_SATELLITES, dtype=np.int64)
        self._time: NDArray[np.int64] = np.zeros(n, dtype=np.int64)
        self._utc_error: NDArray[np.int64] = np.zeros(n, dtype=np.int64)
        self._error, self._bias = np.zeros((n, 6)), np.zeros((n, 6))
        self._gyro, self._force = np.zeros((n, 3)), np.zeros((n, 3))
        self._gnss, self._gnss_vel = np.zeros((n, 3)), np.zeros((n, 3))
        self._sums, self._deltas = np.zeros((n, 6)), np.zeros((n, 6))
        self._baro, self._range = np.zeros(n), np.zeros(n)
        self._wander, self._offset = np.zeros((n, 4)), np.zeros((n, 3))
        self._phase: NDArray[np.int64] = np.zeros((n, 4), dtype=np.int64)
        self._epoch: NDArray[np.int64] = np.zeros((n, 4), dtype=np.int64)
        self._pending, self._pending_time = np.zeros((n, 6)), np.zeros(n, dtype=np.int64)
        if self._level == 0.0:
            self._accuracy[:] = 0.01
        self.bind(state, commands, power)

    def bind(self, state: tuple[Floats, ...], commands: Floats, power: tuple[Floats, Floats, Floats]) -> None:
        """Read these arrays of the world from now on (a copied world has its own)."""
        self._state = state
        rates, force, attitude, position, velocity, height = state
        if self._level == 0.0:
            shown: list[NDArray[Any]] = [rates, force, attitude, position, velocity, position[:, 2], height]
        else:
            shown = [self._gyro, self._force, attitude, self._gnss, self._gnss_vel, self._baro, self._range]
        shown += [self._compass, self._accuracy, self._fix, self._satellites, self._time, self._utc_error, *power]
        shown += [self._deltas[:, :3], self._deltas[:, 3:]]
        ideal = self._level == 0.0
        bias, *drawn = self._drawn()
        self.arguments: tuple[Any, ...] = (
            ideal,
            (attitude, self._field, self._compass, self._time),
            (
                self._level, self._seed, self._who, commands, position, height, velocity, attitude, self._field, bias,
                self._error, *drawn, *self._fixes(), self._baro, self._range, self._compass,
                self._gnss_scale, self._instability, self._warm, self._drift,
            ),
            (rates, force, self._error, self._gyro, self._force),
            (*((rates, force) if ideal else (self._gyro, self._force)), self._sums),
            self._deltas,
        )  # fmt: skip
        """Of `sensor_errors.sample`, after the first three."""
        self._shown = tuple(as_read_only(array) for array in shown)
        self._by_slice: dict[tuple[int | None, int | None, int | None], Sensors] = {}

    def __getstate__(self) -> dict[str, Any]:
        """All but the references to the world's arrays, which have to be bound again."""
        state = self.__dict__.copy()
        for key in ("_state", "_shown", "_by_slice", "arguments"):
            del state[key]
        return state

    def sample(self, now: Time) -> None:
        """Sample every sensor that is due at `now`, of all aircraft; the first call switches the sensors on."""
        last, self._sampled_ns = self._sampled_ns, now
        if last is None and self._level != 0.0:
            position = self._state[3]
            of_chance = self._seed, self._who
            sensor_errors.power_on(
                now, self._level, self._gnss_scale, *of_chance, position, *self._drawn(), *self._fixes()
            )
            sensor_errors.draw_warming(self._level, self._warming_k, *of_chance, self._warm)
        step_ns = 0 if last is None else now - last
        new = last is None or now // READINGS_NS != last // READINGS_NS
        sensor_errors.sample(now, step_ns / NS_PER_S, new, *self.arguments)

    def _drawn(self) -> tuple[NDArray[Any], ...]:
        """What was drawn, but for the noise of the inertial sensors."""
        return (
            self._bias, self._wander, self._offset, self._phase, self._epoch, self._pending, self._pending_time,
        )  # fmt: skip

    def _fixes(self) -> tuple[NDArray[Any], ...]:
        return self._gnss, self._gnss_vel, self._accuracy, self._fix, self._satellites, self._time

    def end_batch(self, last: Time) -> None:
        """Take over the ticks of a batch, the last of which was at `last`."""
        self._sampled_ns = last

    def read(self, rows: slice | NDArray[np.int64]) -> Sensors:
        """The current readings of some vehicles: for a slice, read-only views that later ticks refill; otherwise
        copies.
        """
        if isinstance(rows, slice):
            key = (rows.start, rows.stop, rows.step)
            known = self._by_slice.get(key)
            if known is None:
                known = self._by_slice[key] = Sensors(*(array[rows] for array in self._shown))
            return known
        return Sensors(*(array[rows] for array in self._shown))
