"""Rates of 802.11g: airtime, signal-to-noise ratio needed, probability of success, and medium access times.

A receiver loses 10 % of frames of 1,000 bytes at its minimum sensitivity, for which the standard assumes a noise figure
of 10 dB and an implementation margin of 5 dB (IEEE 802.11-2020, 17.3.10.2 and table 17-18). Without these two, and with
thermal noise of -101 dBm in 20 MHz, the table of sensitivities is one of SNIRs. Around it the error rate falls as that
of the rate of 6 Mb/s does in `skyrange.radio.phy` (assumed: the curves of higher rates are shifted, not
steeper).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from skyrange.contracts.medium import Floats
from skyrange.core import elementary, elementary_python
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_US, Time
from skyrange.radio.phy import OFDM, bits_success_probability
from skyrange.radio.propagation.path_loss import THERMAL_DBM_PER_MHZ

RATES_MBPS: Final = np.array([6.0, 9.0, 12.0, 18.0, 24.0, 36.0, 48.0, 54.0])
_SENSITIVITY_DBM: Final = np.array([-82.0, -81.0, -79.0, -77.0, -74.0, -70.0, -66.0, -65.0])
"""IEEE 802.11-2020, table 17-18, at 20 MHz."""
WIDTH_MHZ: Final = 20.0
MIN_SNIR_DB: Final = _SENSITIVITY_DBM - (THERMAL_DBM_PER_MHZ + 10.0 * elementary_python.log10(WIDTH_MHZ)) - 10.0 - 5.0
"""By rate: SNIR at which 10 % of frames of 1,000 bytes are lost."""

SIFS_NS: Final[Time] = 10 * NS_PER_US
SLOT_NS: Final[Time] = 9 * NS_PER_US
DIFS_NS: Final[Time] = SIFS_NS + 2 * SLOT_NS
CW_MIN: Final = 15
CW_MAX: Final = 1023
"""IEEE 802.11-2020, table 18-5 (short slots) and 10.3.2.3."""
MAX_RETRIES: Final = 7
"""dot11ShortRetryLimit (IEEE 802.11-2020, annex C)."""
LIFETIME_NS: Final[Time] = 500 * 1024 * NS_PER_US
"""A frame is given up after 500 time units (dot11EDCATableMSDULifetime)."""
BUSY_DBM: Final = -62.0
"""Noise of this power makes a channel of 20 MHz busy: 20 dB above the minimum sensitivity (17.3.10.6)."""
PREAMBLE_DBM: Final = -82.0
"""A frame of this power makes a channel busy, and a reactive jammer hear it (17.3.10.6)."""
ACK_BYTES: Final = 14
OVERHEAD_BYTES: Final = 24 + 2 + 16 + 8 + 20 + 8 + 4
"""Around a MAVLink frame: MAC header, QoS control, CCMP header and check, LLC, IPv4, UDP, frame check sequence."""
CCMP_BYTES: Final = 16
"""Of these, what encryption adds: header and check (12.5.3.2)."""
_ACK_RATES: Final = np.array([0, 0, 2, 2, 4, 4, 4, 4])
"""By rate: the highest mandatory rate that is not higher, by its place (10.6.6.5.2)."""


REFERENCE_DB: Final = 3.84785965731171
"""SNIR at which the model of 6 Mb/s loses 10 % of frames of 1,000 bytes: the root of `packet_error` less 0.1."""
_SHIFT_DB: Final = REFERENCE_DB - MIN_SNIR_DB


@compiled
def airtime_ns(rate: int, size_bytes: int) -> Time:
    """Duration of a frame of `size_bytes` at a rate, by its place in `RATES_MBPS` (17.4.3, with 6 µs of extension)."""
    symbols = math.ceil((16 + 6 + 8 * size_bytes) / (4.0 * RATES_MBPS[rate]))
    return int((26 + 4 * symbols) * NS_PER_US)


@compiled
def success_probability(rate: int, snir_db: float, bits: float) -> float:
    """The probability that `bits` arrive at a rate, by its place in `RATES_MBPS`."""
    equivalent_db = snir_db + _SHIFT_DB[rate]
    return bits_success_probability(OFDM, elementary.exp10(0.1 * equivalent_db), bits)


def ack_rate(rate: int) -> int:
    """The rate of the acknowledgement of a frame."""
    return int(_ACK_RATES[rate])


@compiled
def fill_successes(snir_db: Floats, bits: float, out: Floats) -> None:
    """Write into `out` (n, rates) the probability that `bits` arrive at each of n SNIRs at each rate."""
    for row in range(snir_db.shape[0]):
        for rate in range(out.shape[1]):
            out[row, rate] = success_probability(rate, snir_db[row], bits)
