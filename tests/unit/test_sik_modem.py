"""SiK radios: modem, error correction, time slots, frequencies and RSSI, against firmware and data sheet."""

from __future__ import annotations

from itertools import combinations
from math import comb, exp

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.radio.control_link.sik import modem
from skyrange.radio.control_link.sik.modem import (
    AIR_SPEEDS_KBPS,
    SENSITIVITY_DBM,
    air_bytes,
    airtime_ns,
    bit_error,
    coded_bytes,
    filter_khz,
    max_data_bytes,
    noise_figure_db,
    packet_success,
    rssi_of,
    sensitivity_dbm,
    word_failure,
)
from skyrange.radio.control_link.sik.timing import (
    MAX_WINDOW_MS,
    TICK_NS,
    compute_timing,
    draw_hop_order,
    find_centres_mhz,
)
from skyrange.radio.propagation.path_loss import noise_dbm


def dbm_of(rssi: int) -> float:
    """`signal_dBm = (RSSI / 1.9) - 127` (ArduPilot wiki)."""
    return rssi / 1.9 - 127


DEFAULT = compute_timing(64, ecc=False, max_window_ms=MAX_WINDOW_MS, channels=50)


def test_the_bit_error_at_the_data_sheets_sensitivity_is_a_thousandth() -> None:
    """From power to error through the noise in the filter, as a link computes it."""
    for rate, power_dbm in SENSITIVITY_DBM.items():
        assert sensitivity_dbm(rate) == pytest.approx(power_dbm, abs=1e-9)
    for rate in AIR_SPEEDS_KBPS:
        width_khz = filter_khz(rate, 915_000)
        noise = noise_dbm(noise_figure_db(rate), width_khz / 1e3)
        bit_snr = 10.0 ** (0.1 * (sensitivity_dbm(rate) - noise)) * width_khz / rate
        assert bit_error(bit_snr) == pytest.approx(0.001)
        assert bit_error(bit_snr) == pytest.approx(0.5 * exp(-bit_snr / 2))


def test_a_slower_rate_is_more_sensitive() -> None:
    levels = [sensitivity_dbm(rate) for rate in AIR_SPEEDS_KBPS]
    assert levels == sorted(levels)


def _golay23_words() -> list[int]:
    """The code of the firmware (`golay23.h`): the cyclic one of the polynomial 101011100011."""
    words = []
    for data in range(1 << 12):
        rest = data << 11
        for place in range(22, 10, -1):
            if rest >> place & 1:
                rest ^= 0b101011100011 << (place - 11)
        words.append(data << 11 | rest)
    return words


def test_the_code_corrects_three_errors_in_23_bits_and_no_more() -> None:
    """Least distance 7: spheres of radius 3 around 4096 words fill all 2^23, so a fourth error gives another word."""
    least = min(word.bit_count() for word in _golay23_words() if word)
    assert least == 7
    assert 4096 * sum(comb(23, k) for k in range(4)) == 1 << 23
    sphere = {sum(1 << place for place in places) for k in range(4) for places in combinations(range(23), k)}
    assert len(sphere) == 1 << 11


@pytest.mark.parametrize("error", [1e-3, 1e-2, 0.05, 0.2])
def test_word_failures_are_binomial(error: float) -> None:
    expected = sum(comb(23, k) * error**k * (1 - error) ** (23 - k) for k in range(4, 24))
    assert word_failure(error) == pytest.approx(expected, rel=1e-6)


@given(st.floats(1e-9, 0.49), st.integers(0, 118))
def test_packets_in_parts_are_as_likely_as_whole(error: float, size: int) -> None:
    for ecc in (False, True):
        whole = packet_success(error, size, ecc=ecc)
        parts = packet_success(error, size, 0.25, ecc=ecc) * packet_success(error, size, 0.75, ecc=ecc)
        assert parts == pytest.approx(whole, rel=1e-9, abs=1e-30)
        assert 0.0 <= whole <= 1.0


def test_error_correction_doubles_the_bytes_and_survives_weaker_signals() -> None:
    """`radio_transmit_golay`: three bytes become six, with six more bytes of network id, length and check sum."""
    assert coded_bytes(100) == 2 * (102 + 6)
    assert coded_bytes(101) == coded_bytes(103) == 2 * (105 + 6)
    assert air_bytes(100, ecc=True) - 11 == coded_bytes(100)
    assert air_bytes(100, ecc=False) == 8 + 2 + 2 + 1 + 102 + 2
    assert (max_data_bytes(ecc=False), max_data_bytes(ecc=True)) == (250, 118)
    assert coded_bytes(118) <= modem.MAX_PACKET_BYTES
    assert packet_success(0.01, 100, ecc=False) < 0.001
    assert packet_success(0.01, 100, ecc=True) > 0.7


def test_the_scale_of_rssi_is_the_wikis() -> None:
    """25 is "a few dB above the receive sensitivity of the radio (-121 dBm)", and 40 is 7.5 dB above 25."""
    assert 3.0 < dbm_of(25) - sensitivity_dbm(2) < 10.0
    assert dbm_of(40) - dbm_of(25) == pytest.approx(7.5, abs=0.5)
    assert [rssi_of(dbm_of(value)) for value in range(256)] == list(range(256))
    assert (rssi_of(-200.0), rssi_of(60.0)) == (0, 255)


def test_slot_timing_is_that_of_the_firmware() -> None:
    """`tdm_init` by hand for 64 kbit/s: 9 ticks a byte, latency 13·9 + 13 and 3·9 more for a preamble of 16 nibbles."""
    assert DEFAULT == (9, 130 + 27, 260, 3 * (130 + 250 * 9), 250)
    assert DEFAULT.window_ns == 7140 * TICK_NS
    with_ecc = compute_timing(64, ecc=True, max_window_ms=MAX_WINDOW_MS, channels=50)
    assert with_ecc == (18, 130 + 4 * 18 + 3 * 18, 2 * 202, 3 * (202 + 118 * 18), 118)
    assert compute_timing(64, ecc=False, max_window_ms=33, channels=50).window == 33 * 62
    for rate in AIR_SPEEDS_KBPS:
        for ecc in (False, True):
            timing = compute_timing(rate, ecc=ecc, max_window_ms=MAX_WINDOW_MS, channels=50)
            assert timing.window * TICK_NS <= 0.4 * NS_PER_S  # dwell time on one frequency
            assert timing.window < 1 << 13


def test_a_packet_fits_into_the_room_that_it_is_given() -> None:
    for rate in AIR_SPEEDS_KBPS[1:]:
        for ecc in (False, True):
            timing = compute_timing(rate, ecc=ecc, max_window_ms=MAX_WINDOW_MS, channels=50)
            for remaining_ns in range(0, timing.window_ns, NS_PER_MS):
                room = timing.room(remaining_ns)
                if room >= 0:
                    # the firmware rounds a byte up to whole ticks, but no fraction of the last tick
                    assert airtime_ns(rate, room, ecc=ecc) <= remaining_ns + 13 * TICK_NS
    assert DEFAULT.room(DEFAULT.window_ns) == 250
    assert DEFAULT.room((157 + 18 * 9) * TICK_NS) == 15
    assert DEFAULT.room((157 + 18 * 9) * TICK_NS - 1) == -1


def test_at_2_kbps_the_firmware_has_no_room_for_data() -> None:
    timing = compute_timing(2, ecc=False, max_window_ms=MAX_WINDOW_MS, channels=50)
    assert timing.room(timing.window_ns) == -1


@given(st.integers(0, 65_535), st.integers(1, 50))
def test_radios_hop_over_all_channels_within_the_band(netid: int, channels: int) -> None:
    assert sorted(draw_hop_order(netid, channels)) == list(range(channels))
    centres = find_centres_mhz(netid, 915_000, 928_000, channels)
    if channels >= 4:  # the distance of fewer is more than the radio can set
        assert centres[0] > 915.0
        assert centres[-1] < 928.0
    assert len(set(centres)) == channels


def test_the_hop_order_repeats_the_firmwares_generator() -> None:
    """`r_rand` seeded with 25: 25·1103515245 + 12345 mod 2^32 is 1818089694, whose upper 16 bits are 27741."""
    state, numbers = 25, []
    for _ in range(49):
        state = (state * 1_103_515_245 + 12_345) % 2**32
        numbers.append(state // 65_536 % 32_768)
    assert numbers[0] == 27_741
    order = list(range(50))
    for place, number in enumerate(numbers):
        order[place], order[number % 256 % 50] = order[number % 256 % 50], order[place]
    assert draw_hop_order(25, 50) == tuple(order)
    spacing = 13_000_000 // 52
    offset = 27_741 * 625 % 65_536
    offset -= 65_536 if offset >= 32_768 else 0
    base = 915_000_000 + spacing // 2 + offset % 2**32 % spacing
    assert find_centres_mhz(25, 915_000, 928_000, 50)[0] == pytest.approx(base / 1e6)
