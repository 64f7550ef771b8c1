"""Extinction of light by rain and fog: how much of a beam's power a metre of air takes away.

Not modelled: light that drops throw back to the sensor. So rain weakens returns here, but causes none.
"""

from __future__ import annotations

import math
from typing import Final, Literal, NamedTuple

from skyrange.core import elementary_python
from skyrange.core.errors import InputError, Problem

RainLaw = Literal["p1814", "goodin"]
"""`p1814`: ITU-R P.1814-1. `goodin`: Goodin et al. 2019, about thirty times as much."""
_NEPER_PER_DB: Final = elementary_python.log(10.0) / 10.0
_P1814: Final = 1.2924, 0.6436
"""ITU-R P.1814-1 (09/2025), specific attenuation by rain in dB/km, for drops of shape parameter 0: those of Marshall
and Palmer, whose number falls exponentially with their size."""
_GOODIN: Final = 0.01, 0.6
"""Goodin, Carruth, Doude & Hudson, "Predicting the Influence of Rain on LIDAR in ADAS", Electronics 8(1), 89, 2019: per
metre. It is more than what falling drops cover, so it is an upper bound here."""
_CONTRAST: Final = 0.02
"""Least contrast that is seen at the distance of visibility (Koschmieder; ITU-R P.1814-1)."""
_GREEN_UM: Final = 0.55


class Weather(NamedTuple):
    """Weather between a sensor and what it sees; the same everywhere."""

    rain_mmph: float = 0.0
    """Rain rate in mm/h."""
    visibility_m: float = math.inf
    """Meteorological visibility in fog or haze, in green light."""
    rain_law: RainLaw = "p1814"


def find_extinction(weather: Weather, wavelength_um: float) -> float:
    """The extinction coefficient in 1/m: of a beam's power, `exp(-coefficient · distance)` passes a distance.

    Raises `InputError` for numbers that no weather has.
    """
    problems = []
    if not 0.0 <= weather.rain_mmph < math.inf:
        problems.append(Problem("rain_mmph", repr(weather.rain_mmph), "0 or more mm/h"))
    if not weather.visibility_m > 0.0:
        problems.append(Problem("visibility_m", repr(weather.visibility_m), "a positive number of metres"))
    if problems:
        raise InputError("weather", problems)
    return _by_rain(weather) + _by_fog(weather.visibility_m, wavelength_um)


def _by_rain(weather: Weather) -> float:
    if weather.rain_mmph == 0.0:
        return 0.0
    factor, exponent = _P1814 if weather.rain_law == "p1814" else _GOODIN
    extinction = factor * elementary_python.power(weather.rain_mmph, exponent)
    return extinction * _NEPER_PER_DB / 1000.0 if weather.rain_law == "p1814" else extinction


def _by_fog(visibility_m: float, wavelength_um: float) -> float:
    """Kruse's formula with Kim's exponents, as in ITU-R P.1814-1 (specific attenuation by suspended particles)."""
    if visibility_m == math.inf:
        return 0.0
    km = visibility_m / 1000.0
    if km > 50.0:
        exponent = 1.6
    elif km > 6.0:
        exponent = 1.3
    elif km >= 1.0:
        exponent = 0.16 * km + 0.34
    else:
        exponent = max(km - 0.5, 0.0)
    in_green = -elementary_python.log(_CONTRAST) / visibility_m
    return in_green * elementary_python.power(_GREEN_UM / wavelength_um, exponent)
