"""Do frames survive as published curves say? Packet error against SNIR, airtime, by waveform."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from skyrange.contracts.medium import Waveform
from skyrange.radio.builtin.reception_decision import frame_success_probability
from skyrange.radio.phy import (
    LOCK_SNIR_DB,
    MIN_SNIR_DB,
    airtime_ns,
    bit_error,
    bits_success_probability,
    frame_bits,
    packet_error,
)

DSSS, OFDM, BLE, CODED = Waveform


def _snr_at(waveform: Waveform, size: int, error: float) -> float:
    """The SNIR in dB where a frame's error falls to a value."""
    low, high = -20.0, 30.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if packet_error(waveform, middle, size) > error else (low, middle)
    return low


def test_airtimes() -> None:
    """802.11-2020 15.2.3: 192 µs + 8 a byte. 17.4.3: 100 bytes at 6 Mb/s are 35 symbols, 160 + 6 µs at 2.4 GHz.

    Bluetooth Core vol. 6 part B 2.1: 37 bytes on 1M are 376 µs; 2.2: S=8 with 255 bytes 17.04 ms.
    """
    assert airtime_ns(DSSS, 100) == 992_000
    assert airtime_ns(OFDM, 100) == (20 + 35 * 4 + 6) * 1_000
    assert airtime_ns(BLE, 37) == 376_000
    assert airtime_ns(CODED, 255) == 17_040_000


def test_dsss_is_ns3s() -> None:
    """Pei & Henderson 2009, 1 Mb/s, 1024 bytes, by their formula to 0.01 dB; 0.5 lies at −4.0 dB."""
    bits = 8 * 1024 + 48
    for error in (0.5, 0.1):
        ber = 1.0 - (1.0 - error) ** (1.0 / bits)
        expected = 10.0 * math.log10(-math.log(2.0 * ber) / 22.0)
        assert _snr_at(DSSS, 1024, error) == pytest.approx(expected, abs=0.01)
    assert _snr_at(DSSS, 1024, 0.5) == pytest.approx(-4.0, abs=0.1)


def test_ofdm_is_nists() -> None:
    """Pei & Henderson 2010 fig. 4 (NIST): 6 Mb/s frames go from lost to heard between 2.5 and 4.5 dB of SNR; and the
    bound of Miller 2003 table 3.1.1 summed term by term, 1e-9."""
    for snr_db in (0.0, 2.0, 4.0, 6.0):
        p = 0.5 * math.erfc(math.sqrt(10.0 ** (0.1 * snr_db)))
        d = math.sqrt(4.0 * p * (1.0 - p))
        weights = [36, 211, 1404, 11633, 77433, 502690, 3322763, 21292910, 134365911]
        bound = min(0.5, 0.5 * sum(weight * d ** (10 + 2 * k) for k, weight in enumerate(weights)))
        assert bit_error(OFDM, 10.0 ** (0.1 * snr_db)) == pytest.approx(bound, rel=1e-9)
    assert packet_error(OFDM, 2.5, 1024) > 0.9
    assert packet_error(OFDM, 4.5, 1024) < 0.1


def test_ble_sensitivity() -> None:
    """1M: 0.1 % of bits at 2·ln(500) = 10.9 dB; S=8 loses as many frames 8 dB lower (nRF52840's data sheet: −95 and
    −103 dBm), and theory has at most 9 + 3 dB; 1.5 dB."""
    assert bit_error(BLE, 10.0**1.0943) == pytest.approx(1e-3, rel=0.01)
    gain_db = _snr_at(BLE, 37, 0.308) - _snr_at(CODED, 37, 0.308)
    assert gain_db == pytest.approx(8.0, abs=1.5)
    assert gain_db < 12.0


def test_a_data_sheets_sensitivity() -> None:
    """With a noise figure of 7 dB, 1M at 30.8 % loss: about −96 dBm; nRF52840 has −95, CC2640 −97. 1.5 dB."""
    level = -113.98 + 7.0 + _snr_at(BLE, 37, 0.308)
    assert level == pytest.approx(-96.0, abs=1.5)


@pytest.mark.parametrize("waveform", list(Waveform))
def test_thresholds_are_where_they_say(waveform: Waveform) -> None:
    """Below LEAST_SNIR_DB fewer than 1 in 100 short frames survive; at LOCK_SNIR_DB between 0.1 and 0.9."""
    assert packet_error(waveform, float(MIN_SNIR_DB[waveform]), 30) > 0.99
    assert 0.1 < packet_error(waveform, float(LOCK_SNIR_DB[waveform]), 30) < 0.9


@pytest.mark.parametrize("waveform", list(Waveform))
def test_errors_fall_with_snir_and_grow_with_length(waveform: Waveform) -> None:
    grid = [packet_error(waveform, 0.25 * k, 37) for k in range(-60, 80)]
    assert all(a >= b for a, b in pairwise(grid))
    assert grid[0] == pytest.approx(1.0)
    assert grid[-1] < 1e-9
    assert packet_error(waveform, 3.0, 200) >= packet_error(waveform, 3.0, 37)


def test_a_frame_is_judged_part_by_part() -> None:
    """Half a frame under interference: the product of both halves' survivals, the worst ratio that of one. 1e-12."""
    bits = float(frame_bits(OFDM, 100))
    begins, ends, mw = np.array([500]), np.array([2000]), np.array([1.0])
    chance, worst = frame_success_probability(int(OFDM), bits, 0, 1000, 3.0, 1.0, begins, ends, mw, 1)
    assert chance == pytest.approx(
        bits_success_probability(OFDM, 3.0, bits / 2) * bits_success_probability(OFDM, 1.5, bits / 2), rel=1e-12
    )
    assert worst == 1.5
    apart, _ = frame_success_probability(int(OFDM), bits, 0, 500, 3.0, 1.0, begins, ends, mw, 1)
    assert apart == bits_success_probability(OFDM, 3.0, bits)
