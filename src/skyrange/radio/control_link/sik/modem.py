"""Modem of a SiK radio: rates, filters, bit and packet errors, error correction, airtime, and the scale of RSSI.

File names are those of the firmware, ArduPilot/SiK at commit 50189f2, in `Firmware/radio`. "Data sheet" is that of the
Si4430/31/32-B1, whose radio the Si1000 of an HM-TRP module contains.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

from skyrange.core import elementary, elementary_python
from skyrange.core.time import NS_PER_US, Time
from skyrange.radio.propagation.path_loss import THERMAL_DBM_PER_MHZ

AIR_SPEEDS_KBPS: Final = (2, 4, 8, 16, 19, 24, 32, 48, 64, 96, 128, 192, 250)
"""Air data rates (`radio_443x.c: air_data_rates`)."""
SENSITIVITY_DBM: Final = {2: -121.0, 40: -108.0, 100: -104.0, 125: -101.0}
"""By air data rate in kbit/s: input power at which one bit in a thousand is wrong (data sheet, table 3, typical)."""
SENSITIVITY_BIT_ERROR: Final = 0.001
MAX_PACKET_BYTES: Final = 252
"""`radio.h: MAX_PACKET_LENGTH`."""
TRAILER_BYTES: Final = 2
"""Control word at the end of every packet (`tdm.c: struct tdm_trailer`, without encryption)."""
PREAMBLE_BYTES: Final = 8
"""16 nibbles (`radio_443x.c: radio_configure`)."""
SYNC_BYTES: Final = 2
HEADER_BYTES: Final = 2
"""The network id, which the radio checks; with error correction it is part of the data (`radio_configure`)."""
LENGTH_BYTES: Final = 1
CRC_BYTES: Final = 2
ECC_EXTRA_BYTES: Final = 6
"""Before coding: network id, length, and a check sum, each filled up to 3 bytes (`radio_transmit_golay`)."""
TURN_ON_NS: Final[Time] = 208 * NS_PER_US
"""From reception to transmission: the 13 ticks of 16 µs that the firmware counts for each packet (`tdm_init`)."""
GOLAY_BITS: Final = 23
"""Bits of a code word: the firmware sends 24, and does not read the last (`golay.c: golay_decode24`)."""
_CORRECTED: Final = 3
"""Wrong bits that are corrected in each word; the code is perfect, so with four the word is wrong."""
RSSI_PER_DB: Final = 1.9
RSSI_OFFSET_DB: Final = 127.0
"""dBm = RSSI/1.9 − 127 (ArduPilot wiki, "SiK Radio — Advanced Configuration", approximate)."""

_FILTERS_KHZ: Final = {
    0x01: 75.2, 0x05: 112.1, 0x0B: 468.4 / 3, 0x16: 64.1, 0x27: 34.7, 0x2B: 468.4 / 12, 0x2E: 620.7 / 12,
    0x88: 335.5, 0x8A: 420.2, 0x8C: 518.8, 0x8D: 577.0, 0x9A: 420.2 / 2,
}  # fmt: skip
"""By the register 1Ch: bandwidth of the filter (data sheet, "Filter Bandwidth Parameters"; a set of coefficients has a
third of its bandwidth with the decimator by 3, and half with each decimation by 2, which gives 0Bh, 2Bh, 2Eh, 9Ah)."""
_SLOW_433: Final = (0x27, 0x27, 0x27, 0x2E, 0x16, 0x01)
_SLOW_470: Final = (0x2B, 0x2B, 0x2B, 0x2E, 0x16, 0x01)
_SLOW_900: Final = (0x01,) * 6
_FAST: Final = (0x05, 0x0B, 0x9A, 0x88, 0x8A, 0x8C, 0x8D)
"""Register 1Ch by band and rate (`radio_443x.c: reg_table_433`, `reg_table_470`, `reg_table_868`, `reg_table_915`)."""


def filter_khz(air_speed_kbps: int, frequency_khz: float) -> float:
    """Bandwidth of the receiver's filter; it depends on the board, which `frequency_khz` tells."""
    low = _SLOW_433 if frequency_khz <= 460_000 else _SLOW_470
    slow = low if frequency_khz < 800_000 else _SLOW_900
    return _FILTERS_KHZ[(*slow, *_FAST)[AIR_SPEEDS_KBPS.index(air_speed_kbps)]]


def bit_error(bit_snr: float) -> float:
    """Probability that a bit is wrong, for a ratio Eb/N0: ½·exp(−Eb/2N0).

    Orthogonal binary FSK with non-coherent detection (Proakis & Salehi, "Digital Communications", 5th ed., 4.5).
    """
    return 0.5 * float(elementary.exp(-0.5 * bit_snr))


def _ideal_sensitivity_dbm(air_speed_kbps: int) -> float:
    """Input power at which one bit in a thousand is wrong, with thermal noise alone."""
    needed = -2.0 * elementary_python.log(2.0 * SENSITIVITY_BIT_ERROR)
    thermal = THERMAL_DBM_PER_MHZ + 10.0 * elementary_python.log10(air_speed_kbps / 1e3)
    return thermal + 10.0 * elementary_python.log10(needed)


def _implied_noise_figure_db(air_speed_kbps: int) -> float:
    """The noise figure with which `bit_error` gives the data sheet's sensitivity at one of its rates."""
    return SENSITIVITY_DBM[air_speed_kbps] - _ideal_sensitivity_dbm(air_speed_kbps)


_NOISE_FIGURES_DB: Final = [
    (elementary_python.log(rate), _implied_noise_figure_db(rate)) for rate in sorted(SENSITIVITY_DBM)
]


def noise_figure_db(air_speed_kbps: int) -> float:
    """Noise figure that stands for all losses of the receiver, from the data sheet's sensitivities.

    Between its rates it is linear in the logarithm of the rate; above 125 kbit/s it is that of 125 (assumed).
    """
    at = elementary_python.log(air_speed_kbps)
    for (low, figure), (high, other) in pairwise(_NOISE_FIGURES_DB):
        if at <= high:
            return figure + (other - figure) * max(at - low, 0.0) / (high - low)
    return _NOISE_FIGURES_DB[-1][1]


def sensitivity_dbm(air_speed_kbps: int) -> float:
    """Input power at which one bit in a thousand is wrong, without other noise."""
    return _ideal_sensitivity_dbm(air_speed_kbps) + noise_figure_db(air_speed_kbps)


def max_data_bytes(*, ecc: bool) -> int:
    """The most data in one packet (`tdm.c: tdm_init`)."""
    if ecc:
        return MAX_PACKET_BYTES // 2 - (ECC_EXTRA_BYTES + TRAILER_BYTES)
    return MAX_PACKET_BYTES - TRAILER_BYTES


def coded_bytes(data_bytes: int) -> int:
    """Length after Golay coding of a packet with so much data (`radio_443x.c: radio_transmit_golay`)."""
    return 2 * (3 * ((data_bytes + TRAILER_BYTES + 2) // 3) + ECC_EXTRA_BYTES)


def air_bytes(data_bytes: int, *, ecc: bool) -> int:
    """All bytes on the air of a packet with so much data."""
    if ecc:
        return PREAMBLE_BYTES + SYNC_BYTES + LENGTH_BYTES + coded_bytes(data_bytes)
    return PREAMBLE_BYTES + SYNC_BYTES + HEADER_BYTES + LENGTH_BYTES + data_bytes + TRAILER_BYTES + CRC_BYTES


def airtime_ns(air_speed_kbps: int, data_bytes: int, *, ecc: bool) -> Time:
    """Time that a radio takes to send a packet with so much data, turn-on included."""
    return TURN_ON_NS + -(-air_bytes(data_bytes, ecc=ecc) * 8_000_000 // air_speed_kbps)


def detection_probability(error: float) -> float:
    """Probability that a receiver finds a packet's sync word, for a bit error probability; it finds the preamble."""
    return _none_wrong(error, 8 * SYNC_BYTES)


def packet_success(error: float, data_bytes: int, share: float = 1.0, *, ecc: bool) -> float:
    """Probability that a receiver accepts that share of a packet, for a bit error probability below ½.

    Without error correction no bit of sync word, header, length, data and CRC may be wrong; with it none of sync word
    and length, and at most three in each code word. A CRC that does not notice an error is left out.
    """
    if not ecc:
        checked = 8 * (air_bytes(data_bytes, ecc=False) - PREAMBLE_BYTES)
        return _none_wrong(error, checked * share)
    words = 8 * coded_bytes(data_bytes) / (GOLAY_BITS + 1)
    uncoded = _none_wrong(error, 8 * (SYNC_BYTES + LENGTH_BYTES) * share)
    return uncoded * float(elementary.exp(words * share * elementary.log1p(-word_failure(error))))


def untouched_probability(error: float, data_bytes: int) -> float:
    """Probability that none of the code words of a packet with error correction needs it."""
    return _none_wrong(error, 8 * coded_bytes(data_bytes) * GOLAY_BITS // (GOLAY_BITS + 1))


def word_failure(error: float) -> float:
    """Probability that more than three of the 23 bits of a code word are wrong."""
    right, chosen, correct = 1.0 - error, 1.0, 0.0
    for wrong in range(_CORRECTED + 1):
        term = chosen
        for place in range(GOLAY_BITS):
            term *= error if place < wrong else right
        correct += term
        chosen = chosen * (GOLAY_BITS - wrong) / (wrong + 1)
    return min(max(1.0 - correct, 0.0), 1.0 - 1e-12)


def rssi_of(power_dbm: float) -> int:
    """The RSSI that a radio reads at its input, 0…255."""
    return min(max(int(RSSI_PER_DB * (power_dbm + RSSI_OFFSET_DB) + 0.5), 0), 255)


def _none_wrong(error: float, bits: float) -> float:
    return float(elementary.exp(bits * elementary.log1p(-error)))
