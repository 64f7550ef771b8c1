"""Electromagnetic interference on sensor buses: the flight controller reads words in which bits have flipped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

import skyrange.plugin as sky
from skyrange.attack.bases.sensors import SampleDetector
from skyrange.contracts.components import Floats
from skyrange.contracts.params import items
from skyrange.core import elementwise
from skyrange.core.ids import hash64

Words = NDArray[np.int64]

SEA_LEVEL_PA: Final = 101_325.0
SCALE_M: Final = 44_330.769
"""Height at which the pressure of the ICAO standard atmosphere would be zero: 288.15 K / 6.5 K/km (ICAO Doc 7488)."""
EXPONENT: Final = 5.25588
"""Of the same: g M / (R L)."""
LOWEST_PA, HIGHEST_PA = 1_000.0, 120_000.0
"""Range of an MS5611, the barometer of a Pixhawk 4 (data sheet of TE Connectivity: 10 to 1200 mbar, 24 bits)."""


@dataclass(frozen=True, slots=True)
class Register:
    """A register of `bits` bits, two's complement over ±`full_scale`, or unsigned over `least` to `full_scale`."""

    bits: int
    full_scale: float
    least: float | None = None

    def flip(self, values: Floats, masks: Words) -> Floats:
        """The values with the bits of `masks` flipped; where no bit flips, the value stays as it is to the last bit."""
        top = 1 << self.bits
        if self.least is None:
            unit, low, lowest = self.full_scale / (top // 2), -(top // 2), 0.0
        else:
            unit, low, lowest = (self.full_scale - self.least) / (top - 1), 0, self.least
        whole = np.nan_to_num(np.rint((values - lowest) / unit), nan=0.0)
        words = np.clip(whole, low, low + top - 1).astype(np.int64) & (top - 1)
        words ^= masks
        words = np.where(words >= low + top, words - top, words)
        return np.where(masks == 0, values, lowest + words * unit)


GYRO: Final = Register(16, np.radians(2000.0))
"""±2000 deg/s (data sheets of the ICM-20689 and BMI055, the inertial sensors of a Pixhawk 4)."""
ACCELEROMETER: Final = Register(16, 16.0 * 9.80665)
"""±16 g (ArduPilot's AP_InertialSensor_Invensense.cpp sets it)."""
COMPASS: Final = Register(16, 16.0)
"""±16 gauss in 16 bits (data sheet of the IST8310: ±1600 µT, of which it uses 14)."""
BAROMETER: Final = Register(24, HIGHEST_PA, LOWEST_PA)
"""Pressure. The sensor sends a raw value from which its driver computes this; both are close to linear."""


def flip_height(heights_m: Floats, masks: Words) -> Floats:
    """Heights by a barometer, in the standard atmosphere from sea level up, with bits of the pressure flipped."""
    pressure = SEA_LEVEL_PA * elementwise.power(np.clip(1.0 - heights_m / SCALE_M, 0.0, None), EXPONENT)
    flipped = BAROMETER.flip(pressure, masks)
    return np.where(masks == 0, heights_m, SCALE_M * (1.0 - elementwise.power(flipped / SEA_LEVEL_PA, 1.0 / EXPONENT)))


_STREAM: Final = "attack.sensor_bus"
_PER_DRAW: Final = 4
_BITS: Final = 16
Bus = Literal["gyro", "accel", "compass", "baro"]
_AXES: Final = {"gyro": (3, _BITS), "accel": (3, _BITS), "compass": (3, _BITS), "baro": (1, 24)}
"""By sensor: its words in a transfer, and their bits."""


@sky.attack(
    "sensor.bus",
    technique="EX-0014.03",
    surface=("gyro", "accel", "compass", "baro"),
    effect="all sensors on the buses of the flight controller are noise at once: the motors answer it, and the "
    "aircraft falls",
    knowledge="the flight controller's model, and so the frequency at which its traces and wires receive",
    position="beside the aircraft: 10 cm with 12.6 W and 50 cm with 100 W, of a Pixhawk 4; 148 kW at 100 m, computed",
    equipment="a signal generator, an amplifier, and an antenna that is larger than the aircraft",
    budget="a sinusoid for as long as it acts; the first control cycle is enough",
    placement="the same field beside another aircraft",
    realism={
        "effect and powers": "cited: Jang et al., Paralyzing drones via EMI signal injection on sensory communication "
        "channels, NDSS 2023, as its group and reviewers summarize it; the paper itself was not read",
        "words on the bus": "simulated: two's complement registers of 16 bits over the full scales of a Pixhawk 4, and "
        "24 bits of pressure",
        "bits that flip": "assumed: each with the same probability, apart from all others; how field and probability "
        "are related is a parameter",
        "GNSS": "assumed: unaltered, because it is on a UART",
        "drivers": "assumed: no checks; ArduPilot's drop samples of an accelerometer whose temperature jumps, and "
        "heights of a barometer that are not plausible (AP_InertialSensor_Invensense.cpp, AP_Baro.cpp)",
        "filters": "simulated: those of the autopilot; the builtin has none on its gyroscopes",
    },
)
class SensorBus(sky.OnSensors):
    """Flips bits of all that the sensors of an aircraft send to its flight controller over SPI and I2C.

    One field disturbs all buses of a board, whatever the sensors are. A slow sensor repeats its last reading until it
    measures again.
    """

    vehicles: sky.Victims = sky.param("Aircraft whose flight controllers are disturbed, such as ['blue/b1'].")
    sensors: Annotated[tuple[Bus, ...], BeforeValidator(items), Field(min_length=1)] = sky.param(
        "Sensors on the buses that are disturbed.", default=("gyro", "accel", "compass", "baro")
    )
    bit_error_rate: sky.Number = sky.param(
        "Probability that a bit flips; with 0.5 a word is uniformly distributed over its range.",
        default=0.5,
        gt=0,
        le=0.5,
    )
    chance: sky.Chance
    who: np.ndarray
    """(n,) addresses of the aircraft."""
    samples: dict[str, SampleDetector] = sky.state(dict)
    """Of the slow sensors."""
    shown: dict[str, Floats] = sky.state(dict)
    """Their last readings, with flipped bits."""

    def prepare(self, context: sky.AttackContext) -> None:
        self.chance = context.chance
        self.who = np.array([hash64(f"{self.id}|{vehicle}") for vehicle in self.vehicles], dtype=np.uint64)

    def on_sensors(self, now: sky.Time, sensors: sky.Sensors) -> list[sky.SensorAct]:
        """Flip bits. Returns an act for each sensor of each vehicle when it begins."""
        acts = super().on_sensors(now, sensors)
        return [sky.SensorAct(act.vehicle, sensor) for act in acts for sensor in self.sensors]

    def act(self, now: sky.Time, sensors: sky.Sensors) -> None:
        if "gyro" in self.sensors:
            sensors.gyro_radps[:] = GYRO.flip(sensors.gyro_radps, self.draw_masks(now, "gyro"))
        if "accel" in self.sensors:
            sensors.accel_mps2[:] = ACCELEROMETER.flip(sensors.accel_mps2, self.draw_masks(now, "accel"))
        if "compass" in self.sensors:
            fresh = self.find_fresh(now, "compass", sensors.compass_gauss)
            flipped = COMPASS.flip(sensors.compass_gauss, self.draw_masks(now, "compass"))
            self.shown["compass"][fresh] = flipped[fresh]
            sensors.compass_gauss[:] = self.shown["compass"]
        if "baro" in self.sensors:
            heights_m = sensors.baro_up_m[:, None]
            fresh = self.find_fresh(now, "baro", heights_m)
            self.shown["baro"][fresh] = flip_height(heights_m, self.draw_masks(now, "baro"))[fresh]
            sensors.baro_up_m[:] = self.shown["baro"][:, 0]

    def find_fresh(self, now: sky.Time, sensor: str, readings: Floats) -> np.ndarray:
        """(n,) Which of the slow sensors have measured again."""
        if sensor not in self.samples:
            self.samples[sensor] = SampleDetector(len(self.vehicles))
            self.shown[sensor] = readings.copy()
        return self.samples[sensor].fresh(now, readings)

    def draw_masks(self, now: sky.Time, sensor: str) -> Words:
        """(n, words) The bits that flip in a transfer, by aircraft, sensor and time."""
        words, bits = _AXES[sensor]
        draws = -(-words * bits // _PER_DRAW)
        count = len(self.vehicles)
        place = np.tile(np.arange(draws, dtype=np.uint64), count)
        who = np.repeat(self.who ^ np.uint64(hash64(sensor)), draws)
        uniforms = self.chance.uniforms(_STREAM, who, np.full(count * draws, now), place)
        flips = uniforms.reshape(count, draws * _PER_DRAW)[:, : words * bits].reshape(count, words, bits)
        masks: Words = ((flips < self.bit_error_rate) << np.arange(bits)).sum(axis=2)
        return masks
