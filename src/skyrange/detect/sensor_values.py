"""Values that detectors compute of one message: pressure altitude, and fixes less the fused position and velocity."""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.core import elementwise
from skyrange.detect.series import Floats, offset_m

_SEA_LEVEL_HPA: Final = 1013.25
_PER_M: Final = 2.25577e-5
_EXPONENT: Final = 5.25588
"""The standard atmosphere below 11 km (ISO 2533): p = 1013.25 hPa (1 - 2.25577e-5 h / m)^5.25588."""


def pressure_altitude_m(pressure_hpa: Floats) -> Floats:
    """(n,) heights in metres above the level of 1013.25 hPa by (n,) pressures in hPa; NaN where that is not above 0."""
    share = np.where(pressure_hpa > 0.0, pressure_hpa, np.nan) / _SEA_LEVEL_HPA
    return np.asarray((1.0 - elementwise.power(share, 1.0 / _EXPONENT)) / _PER_M)


def fix_errors(fix: Floats, fused: Floats, age_s: Floats) -> tuple[Floats, Floats]:
    """Differences (n, 2) of position in metres and of velocity in m/s, east and north each: the fix less the estimate.

    `fix` is (n, 4): lat, lon, vel and cog of GPS_RAW_INT; `fused` is (n, 4): lat, lon, vx and vy of
    GLOBAL_POSITION_INT; both in wire units. `age_s` is the time of the fix less that of the estimate, (n,): the
    estimate is taken to the time of the fix by its velocity.
    """
    velocity = fused[:, 2:] * 1e-2
    east, north = offset_m(fused[:, 0], fused[:, 1], fix[:, 0], fix[:, 1])
    course = np.radians(fix[:, 3] * 1e-2)
    speed = fix[:, 2] * 1e-2
    away = np.column_stack([east - velocity[:, 1] * age_s, north - velocity[:, 0] * age_s])
    slip = np.column_stack(
        [speed * elementwise.sin(course) - velocity[:, 1], speed * elementwise.cos(course) - velocity[:, 0]]
    )
    return away, slip
