"""Words that sensors send over SPI or I2C: readings as registers have them, and with bits that flipped on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import Floats

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
    pressure = SEA_LEVEL_PA * np.clip(1.0 - heights_m / SCALE_M, 0.0, None) ** EXPONENT
    flipped = BAROMETER.flip(pressure, masks)
    return np.where(masks == 0, heights_m, SCALE_M * (1.0 - (flipped / SEA_LEVEL_PA) ** (1.0 / EXPONENT)))
