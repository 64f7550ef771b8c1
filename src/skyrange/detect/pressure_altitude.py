"""Pressure altitude: the height at which the standard atmosphere has a pressure."""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.detect.series import Floats

_SEA_LEVEL_HPA: Final = 1013.25
_PER_M: Final = 2.25577e-5
_EXPONENT: Final = 5.25588
"""The standard atmosphere below 11 km (ISO 2533): p = 1013.25 hPa (1 - 2.25577e-5 h / m)^5.25588."""


def pressure_altitude_m(pressure_hpa: Floats) -> Floats:
    """(n,) heights in metres above the level of 1013.25 hPa by (n,) pressures in hPa; NaN where that is not above 0."""
    share = np.where(pressure_hpa > 0.0, pressure_hpa, np.nan) / _SEA_LEVEL_HPA
    return np.asarray((1.0 - share ** (1.0 / _EXPONENT)) / _PER_M)
