"""Rates of LTE: efficiency and signal-to-noise ratio of each channel quality, block errors, and hybrid ARQ.

A terminal uses the highest quality whose efficiency is within log2(1 + SNIR/Γ), Γ = −ln(5·BER)/1.5 with a bit error
rate of 0.00005: G. Piro, N. Baldo, M. Miozzo, "An LTE module for the ns-3 network simulator" (2011), as in ns-3's
`LteAmc`. The efficiencies are those of TS 36.213, table 7.2.3-1.

Block errors: a tenth at the SNIR of a quality, which is what terminals report it for (TS 36.213, 7.2.3), and a decade
of odds per dB around it (assumed; turbo codes fall from 90 to 1 % within 2 dB). The k-th transmission of a block gains
10·log10(k) dB (chase combining).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from skyrange.core.time import NS_PER_MS, Time

EFFICIENCY: Final = np.array(
    [0.1523, 0.2344, 0.3770, 0.6016, 0.8770, 1.1758, 1.4766, 1.9141, 2.4063, 2.7305, 3.3223, 3.9023, 4.5234, 5.1152,
     5.5547]
)  # fmt: skip
"""Bits per second and Hz of the qualities 1 to 15."""
_GAP: Final = -math.log(5.0 * 0.00005) / 1.5
MIN_SNIR_DB: Final = 10.0 * np.log10(_GAP * (2.0**EFFICIENCY - 1.0))
"""By quality: least SNIR."""
HARQ_NS: Final[Time] = 8 * NS_PER_MS
"""Round trip of a retransmission, eight subframes (TS 36.321, 7.7)."""
MAX_TRANSMISSIONS: Final = 4
Q_OUT_DB: Final = -8.0
Q_IN_DB: Final = -6.0
"""SNIRs at which the control channel loses 10 % and 2 % of blocks (TS 36.133, 7.6; the usual figures, assumed)."""
T310_NS: Final[Time] = 1000 * NS_PER_MS
"""A cell below Qout for this long is lost (TS 36.331, 7.3 and the default configuration of 9.2.2)."""
MEASUREMENT_NS: Final[Time] = 200 * NS_PER_MS
"""Period of measurements (TS 36.133, 8.1.2.2)."""
FILTER: Final = 0.5
"""Weight of a new measurement: filter coefficient 4 (TS 36.331, 5.5.3.2)."""


def quality_of(snir_db: float) -> int:
    """The highest quality for an SNIR, by its place in `EFFICIENCY`; the lowest one below all."""
    return max(int(np.searchsorted(MIN_SNIR_DB, snir_db, side="right")) - 1, 0)


def block_error(quality: int, snir_db: float, transmission: int = 1) -> float:
    """The probability that a block is not decoded after so many transmissions."""
    above_db = snir_db + 10.0 * math.log10(transmission) - float(MIN_SNIR_DB[quality])
    odds: float = 9.0 * 10.0 ** min(max(above_db, -30.0), 30.0)
    return 1.0 / (1.0 + odds)
