"""Gain of a receiver's antenna by elevation: a patch that faces the sky receives what comes from below weakly."""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.contracts.components import Floats

ZENITH_DBIC: Final = 5.0
"""Assumed gain of a patch on a ground plane of some centimetres; u-blox asks for more than 4 dBic (GNSS antennas,
UBX-15030289, 2.2)."""
ATTENUATION_DB: Final = (
    0.00, 0.00, 0.22, 0.44, 0.67, 1.11, 1.56, 2.00, 2.44, 2.89, 3.56, 4.22, 4.89, 5.56, 6.22, 6.89, 7.56, 8.22, 8.89,
    9.78, 10.67, 11.56, 12.44, 13.33, 14.44, 15.56, 16.67, 17.78, 18.89, 20.00, 21.33, 22.67, 24.00, 25.56, 27.33,
    29.33, 31.56,
)  # fmt: skip
"""Attenuation of a patch antenna at 0, 5, … 180 degrees from its zenith (gps-sdr-sim, gpssim.c, `ant_pat_db`)."""
LEAST_DBIC: Final = -10.0
"""Assumed below the horizon: frame and arms scatter, and fill the null that the table has at the nadir."""
_STEP_DEG: Final = 5.0


def gain_dbic(elevation_deg: Floats) -> Floats:
    """Gain towards a source at elevations from the antenna's horizon (n,), dBic, for the polarisation of satellites."""
    steps = (90.0 - np.asarray(elevation_deg)) / _STEP_DEG
    attenuation = np.interp(steps, np.arange(len(ATTENUATION_DB)), ATTENUATION_DB)
    return np.asarray(np.maximum(ZENITH_DBIC - attenuation, LEAST_DBIC), dtype=np.float64)


HORIZON_DBIC: Final = float(gain_dbic(np.zeros(1))[0])
