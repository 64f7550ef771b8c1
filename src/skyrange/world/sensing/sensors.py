"""Sensors of the aircraft: their quality and their current readings.

A sensor is a physical thing on the body, so it belongs to the world: it samples the true state at its own instants,
and a reading holds until the next one. `SensorSpec` is what a scenario sets; `SensorSuite` holds the sensors of all
aircraft of a world. Declared sensor faults are applied afterwards, in the kernel.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import READINGS_NS, Sensors
from skyrange.core.arrays import as_read_only
from skyrange.core.time import NS_PER_S, Time
from skyrange.world.body_state import BodyState
from skyrange.world.sensing import sensor_errors
from skyrange.world.sensing.geomagnetism import MagneticField
from skyrange.world.sensing.sensor_errors import Drawn, Quality, Sensing, Shown, Words


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
    warming_k: float = 0.0
    instability: float = 0.0
    gnss: float = 1.0


IDEAL = SensorSpec()


class SensorSuite:
    """The sensors of a world's aircraft. Deep copies continue alike; the readings of an aircraft depend on no other
    aircraft.
    """

    def __init__(self, spec: SensorSpec, seeds: Words, who: Words, bodies: BodyState) -> None:
        """The sensors read the world's `bodies` and write none of them.

        `seeds` (n,) and the addresses `who` (n,) are those of the aircraft in chance.
        """
        n = len(who)
        self._warming_k = float(spec.warming_k)
        self._quality = Quality(
            level=float(spec.noise),
            gnss=float(spec.gnss),
            instability=float(spec.instability),
            seeds=seeds,
            who=who,
            field=np.array(spec.field_enu_gauss, dtype=np.float64),
        )
        self._sampled_ns: Time | None = None
        self._utc_error: NDArray[np.int64] = np.zeros(n, dtype=np.int64)
        self._drawn = Drawn(
            bias=np.zeros((n, 6)),
            error=np.zeros((n, 6)),
            warm=np.zeros((n, 7)),
            drift=np.zeros((n, 6)),
            offset=np.zeros((n, 3)),
            wander=np.zeros((n, 4)),
            phase=np.zeros((n, 4), dtype=np.int64),
            epoch=np.zeros((n, 4), dtype=np.int64),
            pending=np.zeros((n, 6)),
            pending_time=np.zeros(n, dtype=np.int64),
        )
        self._readings = Shown(
            gyro=np.zeros((n, 3)),
            force=np.zeros((n, 3)),
            gnss_enu_m=np.zeros((n, 3)),
            gnss_vel=np.zeros((n, 3)),
            accuracy=np.zeros((n, 3)),
            fix=np.full(n, sensor_errors.FIX_RTK, dtype=np.int64),
            satellites=np.full(n, sensor_errors.GNSS_SATELLITES, dtype=np.int64),
            gnss_time=np.zeros(n, dtype=np.int64),
            baro=np.zeros(n),
            rangefinder=np.zeros(n),
            compass=np.zeros((n, 3)),
            sums=np.zeros((n, 6)),
            deltas=np.zeros((n, 6)),
        )
        if self._quality.level == 0.0:
            self._readings.accuracy[:] = 0.01
        self.bind(bodies)

    def bind(self, bodies: BodyState) -> None:
        """Read these arrays of the world from now on (a copied world has its own)."""
        readings, ideal = self._readings, self._quality.level == 0.0
        self._bodies = bodies
        self.arrays = sensor_errors.take_arrays(Sensing(ideal, self._quality, bodies, self._drawn, readings))
        shown = Sensors(
            gyro_radps=bodies.rates if ideal else readings.gyro,
            accel_mps2=bodies.accel if ideal else readings.force,
            attitude=bodies.attitude,
            gnss_enu_m=bodies.position if ideal else readings.gnss_enu_m,
            gnss_vel_enu_mps=bodies.velocity if ideal else readings.gnss_vel,
            baro_up_m=bodies.position[:, 2] if ideal else readings.baro,
            rangefinder_m=bodies.height if ideal else readings.rangefinder,
            compass_gauss=readings.compass,
            gnss_accuracy=readings.accuracy,
            gnss_fix=readings.fix,
            gnss_satellites=readings.satellites,
            gnss_time_ns=readings.gnss_time,
            gnss_utc_error_ns=self._utc_error,
            battery_v=bodies.battery_v,
            battery_a=bodies.battery_a,
            rotor_radps=bodies.rotor_radps,
            delta_angle_rad=readings.deltas[:, :3],
            delta_velocity_mps=readings.deltas[:, 3:],
        )
        self._shown = tuple(as_read_only(getattr(shown, field.name)) for field in fields(Sensors))
        self._by_slice: dict[tuple[int | None, int | None, int | None], Sensors] = {}

    def __getstate__(self) -> dict[str, Any]:
        """All but the references to the world's arrays, which have to be bound again."""
        state = self.__dict__.copy()
        for key in ("arrays", "_bodies", "_shown", "_by_slice"):
            del state[key]
        return state

    def sample(self, now: Time) -> None:
        """Sample every sensor that is due at `now`, of all aircraft; the first call switches the sensors on."""
        last, self._sampled_ns = self._sampled_ns, now
        if last is None and self._quality.level != 0.0:
            sensor_errors.power_on(now, self._quality, self._bodies, self._drawn, self._readings)
            sensor_errors.draw_warming(self._quality, self._warming_k, self._drawn.warm)
        step_ns = 0 if last is None else now - last
        new = last is None or now // READINGS_NS != last // READINGS_NS
        sensor_errors.sample_arrays(now, step_ns / NS_PER_S, new, self.arrays)

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
