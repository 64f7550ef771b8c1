"""Model of a GNSS receiver under noise: C/N0 of its satellites, jitter of its code loop, and what fixes it gives."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt
from typing import Final

import numpy as np

from skyrange.attack.bases.gnss.emitter import AUTHENTIC_DBM
from skyrange.contracts.components import Floats
from skyrange.core import elementary, elementary_python, elementwise
from skyrange.core.elementary import log10
from skyrange.core.time import Time

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


def effective_db_hz(jam_dbm: Floats, satellites: int, signal_dbm: float = AUTHENTIC_DBM) -> Floats:
    """C/N0 of each satellite under noise (n, satellites), dB-Hz, for noise powers (n,) or (n, satellites) in dBm.

    `signal_dbm` is the power of a signal in the middle of the spread.
    1/(C/N0) = 1/(C/N0 without noise) + (J/S) / (Q · chip rate) (Ward in Kaplan, 1996, chapter 6).
    """
    signal = signal_dbm + np.linspace(-SPREAD_DB, SPREAD_DB, satellites)
    thermal = elementwise.exp10((NOISE_DBM_HZ - signal) / 10.0)
    jammed = elementwise.exp10((jam_dbm.reshape(len(jam_dbm), -1) - signal) / 10.0) / (QUALITY * CHIPS_PER_S)
    return np.asarray(-10.0 * elementwise.log10(thermal + jammed), dtype=np.float64)


def loss_db(satellites: int) -> float:
    """Power of noise over that of an authentic signal at which a receiver of so many satellites loses its fix, dB.

    It is where the weakest of the `LEAST_SATELLITES` strongest signals falls to `TRACKING_DB_HZ`.
    """
    signal = AUTHENTIC_DBM + float(np.linspace(-SPREAD_DB, SPREAD_DB, satellites)[-LEAST_SATELLITES])
    most = elementary.exp10(-TRACKING_DB_HZ / 10.0) - elementary.exp10((NOISE_DBM_HZ - signal) / 10.0)
    return signal + 10.0 * log10(most * QUALITY * CHIPS_PER_S) - AUTHENTIC_DBM


def total_dbm(signal_dbm: float, signals: int) -> float:
    """Power of so many equal signals together, dBm."""
    return signal_dbm + 10.0 * log10(signals) if signals > 0 else -inf


def code_jitter_m(db_hz: float) -> float:
    """Thermal code jitter of a non-coherent delay lock loop, metres, one sigma (Kaplan and Hegarty, 2006, eq. 5.23)."""
    ratio = elementary.exp10(db_hz / 10.0)
    squaring = 1.0 + 2.0 / (INTEGRATION_S * ratio * (2.0 - SPACING_CHIPS))
    return CHIP_M * sqrt(LOOP_HZ / (2.0 * ratio) * SPACING_CHIPS * squaring)


def error_growth(used_db_hz: Floats, db_hz: Floats, accuracy_m: float) -> float:
    """Factor by which the error of a fix grows, of a receiver that claims an accuracy without the noise.

    Jitter adds to the error, and dilution grows with the root of the satellites that are not used.
    """
    clean = code_jitter_m(float(effective_db_hz(np.array([-np.inf]), len(db_hz)).mean()))
    extra_m2 = elementary_python.square(code_jitter_m(float(used_db_hz.mean()))) - (clean * clean)
    return sqrt(1.0 + max(extra_m2, 0.0) / elementary_python.square(max(accuracy_m, 0.1))) * sqrt(
        len(db_hz) / len(used_db_hz)
    )


@dataclass(slots=True)
class JammedReceiver:
    """A receiver that loses satellites and its fix under noise; to find them again it needs stronger signals."""

    reacquire_ns: Time
    """Time to a new fix once it finds enough satellites."""
    has_fix: bool = True
    _clear_since: Time = -1
    """Since when one that has lost its fix finds enough satellites; -1 if it does not."""

    def track(self, time: Time, db_hz: Floats) -> Floats:
        """C/N0 of the satellites that it uses, of those of a new fix; sets `has_fix`."""
        used = db_hz[db_hz >= TRACKING_DB_HZ + (0.0 if self.has_fix else REACQUISITION_DB)]
        enough = len(used) >= LEAST_SATELLITES
        if not enough or self.has_fix:
            self._clear_since = -1
        elif self._clear_since < 0:
            self._clear_since = time
        self.has_fix = enough and (self.has_fix or time - self._clear_since >= self.reacquire_ns)
        return used

    def lose_lock(self) -> None:
        """Take the authentic signals away from it: it has to find them again."""
        self.has_fix, self._clear_since = False, -1
