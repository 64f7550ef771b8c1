"""Model of a GNSS receiver under noise: C/N0 of its satellites, loss of track, and jitter of its code loop."""

from __future__ import annotations

from math import sqrt
from typing import Final

import numpy as np

from skyrange.attack.gnss.emitter import AUTHENTIC_DBM
from skyrange.contracts.components import Floats

NOISE_DBM_HZ: Final = -171.0
"""Thermal noise of −174 dBm/Hz and a noise figure of 3 dB."""
CHIPS_PER_S: Final = 1.023e6
QUALITY: Final = 2.0
"""Resistance of the C/A code to wide-band noise, Q (Ward in Kaplan, Understanding GPS, 1996, chapter 6)."""
SPREAD_DB: Final = 5.0
"""Signals of the satellites lie evenly within ± this: an assumption (gain of a patch antenna by elevation)."""
TRACKING_DB_HZ: Final = 28.0
"""C/N0 at which carrier tracking of an unaided receiver is lost (same source)."""
REACQUISITION_DB: Final = 7.0
"""Reacquisition needs so much more: −160 dBm against −167 dBm for tracking (data sheet of the u-blox SAM-M10Q)."""
CHIP_M: Final = 293.05
LOOP_HZ: Final = 1.0
SPACING_CHIPS: Final = 0.5
INTEGRATION_S: Final = 0.02
LEAST_SATELLITES: Final = 4
"""For a fix in three dimensions."""


def effective_db_hz(jam_dbm: Floats, satellites: int) -> Floats:
    """C/N0 of each satellite under noise (n, satellites), dB-Hz, for noise powers (n,) in dBm.

    1/(C/N0) = 1/(C/N0 without noise) + (J/S) / (Q · chip rate) (Ward in Kaplan, 1996, chapter 6).
    """
    signal = AUTHENTIC_DBM + np.linspace(-SPREAD_DB, SPREAD_DB, satellites)
    thermal = 10.0 ** ((NOISE_DBM_HZ - signal) / 10.0)
    jammed = 10.0 ** ((jam_dbm[:, None] - signal) / 10.0) / (QUALITY * CHIPS_PER_S)
    return np.asarray(-10.0 * np.log10(thermal + jammed), dtype=np.float64)


def code_jitter_m(db_hz: float) -> float:
    """Thermal code jitter of a non-coherent delay lock loop, metres, one sigma (Kaplan and Hegarty, 2006, eq. 5.23)."""
    ratio = 10.0 ** (db_hz / 10.0)
    squaring = 1.0 + 2.0 / (INTEGRATION_S * ratio * (2.0 - SPACING_CHIPS))
    return CHIP_M * sqrt(LOOP_HZ / (2.0 * ratio) * SPACING_CHIPS * squaring)
