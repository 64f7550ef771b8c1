"""Sensor error models: noise, bias, drift, delay and outages, as kernels over all aircraft.

Every number has its source. [S] is ArduPilot's simulator (libraries/SITL), [U] u-blox's data sheet of the SAM-M10Q
(UBX-22013293), [P] PX4's Gazebo plugins (PX4-SITL_gazebo-classic, src/gazebo_gps_plugin.cpp).

Chance is addressed by vehicle, sensor and the sensor's own sampling instant. A normal deviate is the sum of three
12-bit uniforms: mean 0 and variance 1 exactly, no value beyond three standard deviations (ArduPilot's own simulator
takes a single uniform). The noise of the inertial sensors is drawn every 10 ms and held in between, which is white to
a filter of 100 Hz; drawing it at 400 Hz would cost four times as much and be averaged away.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import READINGS_NS
from skyrange.core import elementary, elementary_python
from skyrange.core.chance import philox, uniform4
from skyrange.core.compiled import compiled, inlined
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.world.body_state import BodyArrays, BodyState, Floats, Ints

Words = NDArray[np.uint64]

# inertial: [S] SIM_Aircraft.cpp `add_noise` (0.1 deg/s and 0.3 m/s² at full throttle) above the quantisation floor of
# AP_InertialSensor_SITL.cpp (0.04 deg/s, 0.01 m/s²)
IMU_PERIOD_NS: Final = READINGS_NS
GYRO_FLOOR_RADPS: Final = math.radians(0.04)
GYRO_MOTORS_RADPS: Final = math.radians(0.1)
ACCEL_FLOOR_MPS2: Final = 0.01
ACCEL_MOTORS_MPS2: Final = 0.3
# what calibration leaves: of a gyroscope after ArduPilot's at boot, which stops at 0.1 deg/s of change
# (AP_InertialSensor.cpp `_init_gyro`); of an accelerometer 5 mg of the 20 mg of an ICM-42688-P
GYRO_BIAS_RADPS: Final = math.radians(0.05)
ACCEL_BIAS_MPS2: Final = 0.05

# drift, none by default: temperature coefficient of a TDK ICP-10110 (data sheet: 0.5 Pa/K, at 12 Pa/m) as one standard
# deviation. *Assumed*: 0.005 deg/s/K and 0.15 mg/K of inertial sensors, the time constant with which electronics warm
# up, and the instability of a bias in a run, 10 deg/h and 0.1 mg over 100 s
WARMING_S: Final = 300.0
GYRO_PER_K: Final = math.radians(0.005)
ACCEL_PER_K: Final = 0.15e-3 * 9.80665
BARO_PER_K: Final = 0.5 / 12.0
DRIFT_PERIOD_NS: Final = NS_PER_S
DRIFT_S: Final = 100.0
GYRO_INSTABILITY_RADPS: Final = math.radians(10.0) / 3600.0
ACCEL_INSTABILITY_MPS2: Final = 0.1e-3 * 9.80665

# GNSS: rate [S] SIM_GPS1_HZ 5 and GPS_RATE_MS 200; delay AP_GPS_UBLOX.cpp `get_lag` 0.12 s (M8 and later)
GNSS_PERIOD_NS: Final = 200 * NS_PER_MS
GNSS_LAG_NS: Final = 120 * NS_PER_MS
GNSS_WANDER_M: Final = 1.5 / 1.1774
"""Per horizontal axis: [U] 1.5 m circular error probable, which is 1.1774 standard deviations of one axis."""
GNSS_WANDER_UP_M: Final = 1.5 * GNSS_WANDER_M
"""Vertical over horizontal as EKF3 assumes it (AP_NavEKF3_Measurements.cpp, 1.5 times the horizontal noise)."""
GNSS_WANDER_S: Final = 60.0
"""Correlation time: [P] gps_correlation_time."""
GNSS_WHITE_M: Final = 0.05
GNSS_SPEED_MPS: Final = 0.05
"""[U] velocity accuracy, 50 % at 30 m/s; the white part of position is the resulting error between two fixes."""
GNSS_ACCURACY: Final = (1.5, 2.5, 0.2)
"""What the receiver reports: horizontal m, vertical m, speed m/s; typical of u-blox receivers under an open sky."""
GNSS_SATELLITES: Final = 10
"""[S] SIM_GPS1_NUMSATS."""
OUTAGE_BIN_NS: Final = 10 * NS_PER_S
OUTAGE_CHANCE: Final = 0.005
OUTAGE_MIN_S: Final = 0.4
OUTAGE_MAX_S: Final = 3.0
"""A loss of the fix about every half hour, for up to 3 s. An assumption: no data sheet gives it."""
FIX_NONE: Final = 1
FIX_3D: Final = 3
FIX_RTK: Final = 6

# barometer: ArduCopter reads it at 10 Hz (Copter.cpp, update_altitude); noise [S] SIM_BARO_RND 0.2, which is the
# half-width of a uniform; drift of the weather, a few metres an hour, nothing at the start (calibrated at boot)
BARO_PERIOD_NS: Final = 100 * NS_PER_MS
BARO_NOISE_M: Final = 0.2 / math.sqrt(3.0)
BARO_DRIFT_M: Final = 1.0
BARO_DRIFT_S: Final = 1800.0

# compass: read at 10 Hz (Copter.cpp, update_batt_compass); noise 3 mgauss as an LIS3MDL's (data sheet, table 3:
# 3.2 to 4.1 mgauss); what calibration leaves of hard iron, 5 mgauss, is about 1 degree of heading
COMPASS_PERIOD_NS: Final = 100 * NS_PER_MS
COMPASS_NOISE_GAUSS: Final = 0.003
COMPASS_OFFSET_GAUSS: Final = 0.005

# rangefinder: LightWare SF11/C, 20 Hz, 0.1 m at most (data sheet): three standard deviations
RANGE_PERIOD_NS: Final = 50 * NS_PER_MS
RANGE_NOISE_M: Final = 0.033

_S_IMU: Final = np.uint64(hash64("sensor.imu"))
_S_GNSS: Final = np.uint64(hash64("sensor.gnss"))
_S_OUTAGE: Final = np.uint64(hash64("sensor.gnss_outage"))
_S_BARO: Final = np.uint64(hash64("sensor.baro"))
_S_COMPASS: Final = np.uint64(hash64("sensor.compass"))
_S_RANGE: Final = np.uint64(hash64("sensor.rangefinder"))
_S_START: Final = np.uint64(hash64("sensor.start"))
_S_DRIFT: Final = np.uint64(hash64("sensor.drift"))
_0: Final = np.uint64(0)
_12: Final = np.uint64(12)
_FIELD: Final = np.uint64(0xFFF)
_MEAN: Final = 6142.5  # of three fields, each 0 … 4095
_SPREAD: Final = 2048.0  # their standard deviation, to a part in 10⁷

_GNSS_KEEP = elementary_python.exp(-GNSS_PERIOD_NS / NS_PER_S / GNSS_WANDER_S)
_GNSS_STIR = math.sqrt(1.0 - _GNSS_KEEP * _GNSS_KEEP)
_BARO_KEEP = elementary_python.exp(-BARO_PERIOD_NS / NS_PER_S / BARO_DRIFT_S)
_BARO_STIR = math.sqrt(1.0 - _BARO_KEEP * _BARO_KEEP)
_DRIFT_KEEP = elementary_python.exp(-DRIFT_PERIOD_NS / NS_PER_S / DRIFT_S)
_DRIFT_STIR = math.sqrt(1.0 - _DRIFT_KEEP * _DRIFT_KEEP)
_ACCURACY_H, _ACCURACY_V, _ACCURACY_S = GNSS_ACCURACY

GNSS, BARO, COMPASS, RANGE = 0, 1, 2, 3
"""Columns of `epoch` and `phase`."""
PERIODS: Final = (GNSS_PERIOD_NS, BARO_PERIOD_NS, COMPASS_PERIOD_NS, RANGE_PERIOD_NS)


class Quality(NamedTuple):
    """What the errors of all sensors are drawn by."""

    level: float
    """Multiplies every error."""
    gnss: float
    """Scales the slow error and the velocity error of the receiver."""
    instability: float
    """Scales the bias that wanders in a run."""
    seeds: Words
    """(rows,) seeds of the aircraft's runs."""
    who: Words
    """(rows,) addresses of the aircraft in chance."""
    field: Floats
    """(3,) the Earth's field: east, north, up."""


class Drawn(NamedTuple):
    """Errors that were drawn and hold until the next draw, and when that is."""

    bias: Floats
    """(rows, 6): of gyroscopes and accelerometers, as `error`, `drift` and the first of `warm`."""
    error: Floats
    warm: Floats
    """(rows, 7): what a full warming adds; the last is the barometer's."""
    drift: Floats
    """The bias that wanders in a run."""
    offset: Floats
    """(rows, 3): the compass."""
    wander: Floats
    """(rows, 4): the position error of GNSS, and the barometer's drift."""
    phase: Ints
    """(rows, 4): the phase of each slow sensor."""
    epoch: Ints
    """(rows, 4): the number of its last sample."""
    pending: Floats
    """(rows, 6): the fix that is being delayed."""
    pending_time: Ints


class Shown(NamedTuple):
    """Readings, which hold until the next sample."""

    gyro: Floats
    force: Floats
    gnss_enu_m: Floats
    gnss_vel: Floats
    accuracy: Floats
    fix: Ints
    satellites: Ints
    gnss_time: Ints
    baro: Floats
    rangefinder: Floats
    compass: Floats
    sums: Floats
    """(rows, 6): integrals of the inertial readings, angles before velocities."""
    deltas: Floats
    """(rows, 6): what is shown of these."""


class Sensing(NamedTuple):
    """The sensors of all aircraft, and the bodies that they sense."""

    ideal: bool
    quality: Quality
    bodies: BodyState
    drawn: Drawn
    shown: Shown


SensingArrays = tuple[bool, tuple[Any, ...], BodyArrays, tuple[Any, ...], tuple[Any, ...]]
"""The fields of a `Sensing` in their order, in plain tuples (see `body_state`)."""


def take_arrays(sensing: Sensing) -> SensingArrays:
    """Of a `Sensing`, for compiled functions that are called in every tick."""
    ideal, quality, bodies, drawn, shown = sensing
    return ideal, tuple(quality), tuple(bodies), tuple(drawn), tuple(shown)


@compiled
def name_arrays(arrays: SensingArrays) -> Sensing:
    """The opposite of `take_arrays`."""
    ideal, quality, bodies, drawn, shown = arrays
    return Sensing(ideal, Quality(*quality), BodyState(*bodies), Drawn(*drawn), Shown(*shown))


@compiled
def normal6(
    seed: np.uint64, stream: np.uint64, who: np.uint64, when: int, k: np.uint64
) -> tuple[float, float, float, float, float, float]:
    """Six independent deviates, mean 0 and variance 1, of one address (see the module)."""
    a, b, c, d = philox(seed, stream, who, np.uint64(when), k, _0)
    total0 = np.int64(a & _FIELD) + np.int64((a >> _12) & _FIELD) + np.int64((a >> np.uint64(24)) & _FIELD)
    total1 = np.int64(b & _FIELD) + np.int64((b >> _12) & _FIELD) + np.int64((b >> np.uint64(24)) & _FIELD)
    total2 = np.int64(c & _FIELD) + np.int64((c >> _12) & _FIELD) + np.int64((c >> np.uint64(24)) & _FIELD)
    total3 = np.int64(d & _FIELD) + np.int64((d >> _12) & _FIELD) + np.int64((d >> np.uint64(24)) & _FIELD)
    total4 = np.int64((a >> np.uint64(36)) & _FIELD) + np.int64(a >> np.uint64(52)) + np.int64(b >> np.uint64(52))
    total5 = np.int64((c >> np.uint64(36)) & _FIELD) + np.int64(c >> np.uint64(52)) + np.int64(d >> np.uint64(52))
    return (
        (total0 - _MEAN) / _SPREAD,
        (total1 - _MEAN) / _SPREAD,
        (total2 - _MEAN) / _SPREAD,
        (total3 - _MEAN) / _SPREAD,
        (total4 - _MEAN) / _SPREAD,
        (total5 - _MEAN) / _SPREAD,
    )


@compiled
def body_field(attitude: Floats, field: Floats, out: Floats) -> None:
    """The Earth's field (east, north, up) in the body frame of one aircraft."""
    w, x, y, z = attitude[0], attitude[1], attitude[2], attitude[3]
    e, n, u = field[0], field[1], field[2]
    out[0] = (1 - 2 * (y * y + z * z)) * e + 2 * (x * y + w * z) * n + 2 * (x * z - w * y) * u
    out[1] = 2 * (x * y - w * z) * e + (1 - 2 * (x * x + z * z)) * n + 2 * (y * z + w * x) * u
    out[2] = 2 * (x * z + w * y) * e + 2 * (y * z - w * x) * n + (1 - 2 * (x * x + y * y)) * u


@compiled
def read_ideal(now: int, field: Floats, bodies: BodyState, shown: Shown) -> None:
    """The two readings of ideal sensors that are not copies of the state: magnetic field and time of the fix."""
    attitude, compass = bodies.attitude, shown.compass
    for i in range(attitude.shape[0]):
        body_field(attitude[i], field, compass[i])
        shown.gnss_time[i] = now


@compiled
def in_outage(seed: np.uint64, who: np.uint64, at: int, level: float) -> bool:
    """Whether a receiver has no fix at a time: at most one outage per bin, drawn by bin."""
    power_on = at // OUTAGE_BIN_NS * OUTAGE_BIN_NS
    u = uniform4(seed, _S_OUTAGE, who, np.uint64(power_on), _0)
    if u[0] >= OUTAGE_CHANCE * level:
        return False
    length = (OUTAGE_MIN_S + (OUTAGE_MAX_S - OUTAGE_MIN_S) * u[1]) * NS_PER_S
    begin = u[2] * (OUTAGE_BIN_NS - length)
    return begin <= at - power_on < begin + length


@compiled
def power_on(now: int, quality: Quality, bodies: BodyState, drawn: Drawn, shown: Shown) -> None:
    """Switch all sensors on: draw biases and phases, and give each receiver its first fix, at rest."""
    level, gnss, seeds, who = quality.level, quality.gnss, quality.seeds, quality.who
    bias, wander, offset, phase, epoch = drawn.bias, drawn.wander, drawn.offset, drawn.phase, drawn.epoch
    pending, gnss_enu_m, accuracy = drawn.pending, shown.gnss_enu_m, shown.accuracy
    for i in range(who.shape[0]):
        g = normal6(seeds[i], _S_START, who[i], 0, np.uint64(0))
        m = normal6(seeds[i], _S_START, who[i], 0, np.uint64(1))
        w = normal6(seeds[i], _S_START, who[i], 0, np.uint64(2))
        u = uniform4(seeds[i], _S_START, who[i], np.uint64(0), np.uint64(3))
        for axis in range(3):
            bias[i, axis] = level * GYRO_BIAS_RADPS * g[axis]
            bias[i, 3 + axis] = level * ACCEL_BIAS_MPS2 * g[3 + axis]
            offset[i, axis] = level * COMPASS_OFFSET_GAUSS * m[axis]
        wander[i, 0] = level * gnss * GNSS_WANDER_M * w[0]
        wander[i, 1] = level * gnss * GNSS_WANDER_M * w[1]
        wander[i, 2] = level * gnss * GNSS_WANDER_UP_M * w[2]
        wander[i, 3] = 0.0  # the barometer was calibrated here
        for k in range(4):
            period = PERIODS[k]
            phase[i, k] = np.int64(u[k] * period) // IMU_PERIOD_NS * IMU_PERIOD_NS
            epoch[i, k] = (now - phase[i, k]) // period - (0 if k == GNSS else 1)  # all but GNSS are read at once
        for axis in range(3):
            gnss_enu_m[i, axis] = bodies.position[i, axis] + wander[i, axis]
            shown.gnss_vel[i, axis] = 0.0
            pending[i, axis] = gnss_enu_m[i, axis]
            pending[i, 3 + axis] = 0.0
        shown.gnss_time[i] = now - GNSS_LAG_NS
        drawn.pending_time[i] = shown.gnss_time[i]
        accuracy[i, 0], accuracy[i, 1], accuracy[i, 2] = _ACCURACY_H, _ACCURACY_V, _ACCURACY_S
        shown.fix[i] = FIX_3D
        shown.satellites[i] = GNSS_SATELLITES


@compiled
def draw_warming(quality: Quality, warming_k: float, warm: Floats) -> None:
    """Draw what a warming of `warming_k` kelvin adds to gyroscopes, accelerometers and barometer: `warm` (rows, 7)."""
    level, seeds, who = quality.level, quality.seeds, quality.who
    for i in range(who.shape[0]):
        w = normal6(seeds[i], _S_START, who[i], 0, np.uint64(4))
        b = normal6(seeds[i], _S_START, who[i], 0, np.uint64(5))
        for axis in range(3):
            warm[i, axis] = level * warming_k * GYRO_PER_K * w[axis]
            warm[i, 3 + axis] = level * warming_k * ACCEL_PER_K * w[3 + axis]
        warm[i, 6] = level * warming_k * BARO_PER_K * b[0]


@compiled
def read_inertial(rates: Floats, accel: Floats, error: Floats, gyro: Floats, force: Floats) -> None:
    """Gyroscopes and accelerometers of all rows: truth plus the error that was drawn last (rows, 6)."""
    for i in range(rates.shape[0]):
        for axis in range(3):
            gyro[i, axis] = rates[i, axis] + error[i, axis]
            force[i, axis] = accel[i, axis] + error[i, 3 + axis]


@compiled
def show_integrals(sums: Floats, deltas: Floats) -> None:
    """Show integrals (rows, 6) as deltas, and begin anew."""
    for i in range(sums.shape[0]):
        for k in range(6):
            deltas[i, k] = sums[i, k]
            sums[i, k] = 0.0


@compiled
def integrate_inertial(gyro: Floats, force: Floats, step_s: float, sums: Floats) -> None:
    """Add the readings of a tick, held for `step_s`, to the integrals (rows, 6): angles in rad, then velocities."""
    for i in range(sums.shape[0]):
        for axis in range(3):
            sums[i, axis] += gyro[i, axis] * step_s
            sums[i, 3 + axis] += force[i, axis] * step_s


@inlined
def _is_due(now: int, phase: int, epoch: int, period: int) -> bool:
    """Whether a sensor has a new sample since its `epoch`-th: a multiplication, where their count takes a division."""
    return now - phase >= (epoch + 1) * period


@compiled
def draw_errors(now: int, quality: Quality, bodies: BodyState, drawn: Drawn, shown: Shown) -> None:
    """Do what is due every 10 ms: new inertial noise, and the slow sensors that sample at `now`."""
    level, gnss, instability = quality.level, quality.gnss, quality.instability
    seeds, who, commands = quality.seeds, quality.who, bodies.commands
    bias, error, warm, drift = drawn.bias, drawn.error, drawn.warm, drawn.drift
    wander, offset, phase, epoch = drawn.wander, drawn.offset, drawn.phase, drawn.epoch
    pending, pending_time, gnss_time, compass = drawn.pending, drawn.pending_time, shown.gnss_time, shown.compass
    heat = 1.0 - elementary.exp(-now / NS_PER_S / WARMING_S)
    for i in range(who.shape[0]):
        if instability > 0.0 and now % DRIFT_PERIOD_NS == 0:
            d = normal6(seeds[i], _S_DRIFT, who[i], now, _0)
            for axis in range(3):
                size = level * instability
                drift[i, axis] = _DRIFT_KEEP * drift[i, axis] + _DRIFT_STIR * size * GYRO_INSTABILITY_RADPS * d[axis]
                drift[i, 3 + axis] = (
                    _DRIFT_KEEP * drift[i, 3 + axis] + _DRIFT_STIR * size * ACCEL_INSTABILITY_MPS2 * d[3 + axis]
                )
        throttle = 0.0
        for m in range(commands.shape[1]):
            if commands[i, m] > 0.0:  # a NaN turns no motor
                throttle += min(commands[i, m], 1.0)
        throttle /= commands.shape[1]
        z = normal6(seeds[i], _S_IMU, who[i], now, _0)
        gyro_sd = level * (GYRO_FLOOR_RADPS + GYRO_MOTORS_RADPS * throttle)
        accel_sd = level * (ACCEL_FLOOR_MPS2 + ACCEL_MOTORS_MPS2 * throttle)
        for axis in range(3):
            of_gyro = drift[i, axis] + heat * warm[i, axis]
            of_accel = drift[i, 3 + axis] + heat * warm[i, 3 + axis]
            error[i, axis] = bias[i, axis] + of_gyro + gyro_sd * z[axis]
            error[i, 3 + axis] = bias[i, 3 + axis] + of_accel + accel_sd * z[3 + axis]

        if _is_due(now, phase[i, GNSS], epoch[i, GNSS], GNSS_PERIOD_NS):
            count = (now - phase[i, GNSS]) // GNSS_PERIOD_NS
            epoch[i, GNSS] = count
            at = count * GNSS_PERIOD_NS + phase[i, GNSS]
            w = normal6(seeds[i], _S_GNSS, who[i], at, _0)
            v = normal6(seeds[i], _S_GNSS, who[i], at, np.uint64(1))
            for axis in range(3):
                size = level * gnss * (GNSS_WANDER_UP_M if axis == 2 else GNSS_WANDER_M)
                wander[i, axis] = _GNSS_KEEP * wander[i, axis] + _GNSS_STIR * size * w[axis]
                pending[i, axis] = bodies.position[i, axis] + wander[i, axis] + level * GNSS_WHITE_M * w[3 + axis]
                pending[i, 3 + axis] = bodies.velocity[i, axis] + level * gnss * GNSS_SPEED_MPS * v[axis]
            pending_time[i] = now
        if pending_time[i] != gnss_time[i] and now >= pending_time[i] + GNSS_LAG_NS:
            if in_outage(seeds[i], who[i], pending_time[i], level):
                pending_time[i] = gnss_time[i]
                shown.fix[i] = FIX_NONE
                shown.satellites[i] = 3
            else:
                gnss_time[i] = pending_time[i]
                for axis in range(3):
                    shown.gnss_enu_m[i, axis] = pending[i, axis]
                    shown.gnss_vel[i, axis] = pending[i, 3 + axis]
                shown.fix[i] = FIX_3D
                shown.satellites[i] = GNSS_SATELLITES

        if _is_due(now, phase[i, BARO], epoch[i, BARO], BARO_PERIOD_NS):
            count = (now - phase[i, BARO]) // BARO_PERIOD_NS
            epoch[i, BARO] = count
            b = normal6(seeds[i], _S_BARO, who[i], count * BARO_PERIOD_NS + phase[i, BARO], _0)
            wander[i, 3] = _BARO_KEEP * wander[i, 3] + _BARO_STIR * level * BARO_DRIFT_M * b[0]
            shown.baro[i] = bodies.position[i, 2] + wander[i, 3] + heat * warm[i, 6] + level * BARO_NOISE_M * b[1]
        if _is_due(now, phase[i, COMPASS], epoch[i, COMPASS], COMPASS_PERIOD_NS):
            count = (now - phase[i, COMPASS]) // COMPASS_PERIOD_NS
            epoch[i, COMPASS] = count
            c = normal6(seeds[i], _S_COMPASS, who[i], count * COMPASS_PERIOD_NS + phase[i, COMPASS], _0)
            body_field(bodies.attitude[i], quality.field, compass[i])
            for axis in range(3):
                compass[i, axis] += offset[i, axis] + level * COMPASS_NOISE_GAUSS * c[axis]
        if _is_due(now, phase[i, RANGE], epoch[i, RANGE], RANGE_PERIOD_NS):
            count = (now - phase[i, RANGE]) // RANGE_PERIOD_NS
            epoch[i, RANGE] = count
            r = normal6(seeds[i], _S_RANGE, who[i], count * RANGE_PERIOD_NS + phase[i, RANGE], _0)
            shown.rangefinder[i] = max(bodies.height[i] + level * RANGE_NOISE_M * r[0], 0.0)


@compiled
def sample(now: int, step_s: float, new: bool, sensing: Sensing) -> None:  # noqa: FBT001
    """Sample all sensors at the end of a tick of `step_s`; `new` at the first tick of each `READINGS_NS`."""
    ideal, quality, bodies, drawn, shown = sensing
    gyro, force = shown.gyro, shown.force
    if ideal:
        read_ideal(now, quality.field, bodies, shown)
        gyro, force = bodies.rates, bodies.accel
    else:
        if new:
            draw_errors(now // READINGS_NS * READINGS_NS, quality, bodies, drawn, shown)
        read_inertial(bodies.rates, bodies.accel, drawn.error, gyro, force)
    integrate_inertial(gyro, force, step_s, shown.sums)
    if new:
        show_integrals(shown.sums, shown.deltas)


@compiled
def sample_arrays(now: int, step_s: float, new: bool, arrays: SensingArrays) -> None:  # noqa: FBT001
    """`sample`, of sensors in plain tuples."""
    sample(now, step_s, new, name_arrays(arrays))
