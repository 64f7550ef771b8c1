"""Geomagnetic field at a place, by a truncated World Magnetic Model.

The World Magnetic Model 2020 (NOAA NCEI and BGS, Chulliat et al., 2020), its main field truncated after degree 4 and
without its secular variation: at middle latitudes about 2 degrees of declination and 2 % of strength away from the
whole model. Both the compass of the world and the declination in the autopilot come from here, as ArduPilot carries
such a table (libraries/AP_Declination), so the truncation causes no error between them.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.core import elementary_python
from skyrange.core.geodesy import Origin

_G: Final = {  # nT, WMM2020.COF, epoch 2020.0: (g, h) by degree and order
    (1, 0): (-29404.5, 0.0), (1, 1): (-1450.7, 4652.9),
    (2, 0): (-2500.0, 0.0), (2, 1): (2982.0, -2991.6), (2, 2): (1676.8, -734.8),
    (3, 0): (1363.9, 0.0), (3, 1): (-2381.0, -82.2), (3, 2): (1236.2, 241.8), (3, 3): (525.7, -542.9),
    (4, 0): (903.1, 0.0), (4, 1): (809.4, 282.0), (4, 2): (86.2, -158.4), (4, 3): (-309.4, 199.8),
    (4, 4): (47.9, -350.1),
}  # fmt: skip
_DEGREE: Final = 4
_GAUSS_PER_NT: Final = 1e-5

MagneticField = tuple[float, float, float]
"""East, north, up in gauss."""


def magnetic_field_at(origin: Origin) -> MagneticField:
    """The field at a place, east, north, up in gauss: of magnitude 0.25 to 0.65, nearly vertical near the poles."""
    colatitude = math.radians(90.0 - origin.lat_deg)
    longitude = math.radians(origin.lon_deg)
    cosine, sine = elementary_python.cos(colatitude), max(elementary_python.sin(colatitude), 1e-9)
    value, slope = _legendre(cosine, sine)  # at the reference radius: height and flattening matter less than truncation
    north = east = up = 0.0
    for (n, m), (g, h) in _G.items():
        turn = g * elementary_python.cos(m * longitude) + h * elementary_python.sin(m * longitude)
        north += turn * slope[n, m]
        east += (
            m
            * (g * elementary_python.sin(m * longitude) - h * elementary_python.cos(m * longitude))
            * value[n, m]
            / sine
        )
        up += (n + 1) * turn * value[n, m]
    return east * _GAUSS_PER_NT, north * _GAUSS_PER_NT, up * _GAUSS_PER_NT


def _legendre(cosine: float, sine: float) -> tuple[dict[tuple[int, int], float], dict[tuple[int, int], float]]:
    """Schmidt semi-normalised associated Legendre functions of the colatitude, and their derivatives."""
    value: dict[tuple[int, int], float] = {(0, 0): 1.0}
    slope: dict[tuple[int, int], float] = {(0, 0): 0.0}
    for n in range(1, _DEGREE + 1):
        for m in range(n + 1):
            if m == n:
                factor = 1.0 if n == 1 else math.sqrt(1.0 - 0.5 / n)
                value[n, m] = factor * sine * value[n - 1, m - 1]
                slope[n, m] = factor * (sine * slope[n - 1, m - 1] + cosine * value[n - 1, m - 1])
                continue
            below, below_slope = value.get((n - 2, m), 0.0), slope.get((n - 2, m), 0.0)
            norm = math.sqrt(n * n - m * m)
            past = math.sqrt(elementary_python.square(n - 1) - m * m) if n > 1 else 0.0
            a = (2 * n - 1) / norm
            value[n, m] = a * cosine * value[n - 1, m] - past / norm * below
            slope[n, m] = a * (cosine * slope[n - 1, m] - sine * value[n - 1, m]) - past / norm * below_slope
    return value, slope
