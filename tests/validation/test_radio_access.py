"""Do frames collide as often as theory says? ALOHA, Bluetooth advertising, 802.11 backoff; tolerance by sample."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.contracts.medium import (
    ANY_CHANNEL,
    RadioSpec,
    ReceptionOutcome,
    ScanSchedule,
    ScanStep,
    TxBatch,
    Waveform,
)
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.radio.builtin.medium import BuiltinMedium, fixed_positions
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.phy import airtime_ns

STILL = RadioEnvironment(chance=False)


def _ring(n: int, listening: tuple[ScanSchedule, ...], radius_m: float = 20.0) -> list[RadioSpec]:
    """Senders all as far from the receiver "~" in the middle, so that none is captured."""
    angles = 2.0 * math.pi * np.arange(n) / n
    spots = np.round(np.stack((radius_m * np.cos(angles), radius_m * np.sin(angles)), axis=1), 9).tolist()
    senders = [RadioSpec(f"s{k:04d}", (x, y, 30.0)) for k, (x, y) in enumerate(spots)]
    return [*senders, RadioSpec("~", (0.0, 0.0, 30.0), listening)]


def _batch(radio: np.ndarray, at: np.ndarray, waveform: Waveform, size: int) -> TxBatch:
    count = len(radio)
    fill = np.full(count, int(waveform))
    return TxBatch(
        radio, at, fill, np.full(count, ANY_CHANNEL), np.full(count, np.nan), np.full(count, size), np.arange(count)
    )


def test_pure_aloha() -> None:
    """Poisson arrivals of frames of length T at rate g survive with e^(−2gT) (Abramson 1970): 4 sigma of 6,000.

    BLE PDUs on one channel are that: the receiver stays on 37, the events' other PDUs are elsewhere.
    """
    frames, length = 6_000, airtime_ns(Waveform.BLE_1M, 37)
    listening = (ScanSchedule((ScanStep(37, (Waveform.BLE_1M,)),)),)
    rng = np.random.default_rng(1)
    for load in (0.05, 0.2):
        span = round(frames * length / load)
        at = np.sort(rng.integers(1, span, frames))
        medium = BuiltinMedium(_ring(200, listening), Chance(5), surroundings=STILL)
        medium.offer(0, _batch(rng.integers(0, 200, frames), at, Waveform.BLE_1M, 37))
        got = len(medium.advance(span + NS_PER_S, fixed_positions(medium.radios)).heard.key)
        expected = math.exp(-2.0 * load)
        sigma = math.sqrt(expected * (1.0 - expected) / frames)
        # equal powers: the first frame survives where the second ends up on its last bits, as SNIR 0 dB over 1 µs
        assert got / frames == pytest.approx(expected, abs=4.0 * sigma + 0.01)


def test_bluetooth_advertisers_collide_as_ghamari_says() -> None:
    """n advertisers, one event every second with a delay of 0…10 ms: each is alone on a channel with
    (1 − 2T/1 s)^(n−1) (Ghamari et al., "Detailed examination of a packet collision model for Bluetooth Low Energy
    advertising mode", IEEE Access 2018, eq. 5). 4 sigma of 3,000 events."""
    n, events = 300, 10
    length = airtime_ns(Waveform.BLE_1M, 37)
    rng = np.random.default_rng(2)
    phase = rng.integers(1, NS_PER_S, n)
    radio = np.tile(np.arange(n), events)
    at = (np.arange(events)[:, None] * NS_PER_S + phase).ravel()
    medium = BuiltinMedium(
        _ring(n, (ScanSchedule((ScanStep(38, (Waveform.BLE_1M,)),)),)), Chance(6), surroundings=STILL
    )
    medium.offer(0, _batch(radio, at, Waveform.BLE_1M, 37))
    got = len(medium.advance((events + 1) * NS_PER_S, fixed_positions(medium.radios)).heard.key)
    expected = (1.0 - 2.0 * length / NS_PER_S) ** (n - 1)
    sigma = math.sqrt(expected * (1.0 - expected) / (n * events))
    assert got / (n * events) == pytest.approx(expected, abs=4.0 * sigma + 0.01)


def test_equal_backoffs_collide() -> None:
    """k senders wait for one frame and draw from 0…15: each is alone with (15/16)^(k−1) at most; those that drew a
    number that nobody else did all get through. Expected alone: k·Σ(1/16)(15/16)^(k−1). 4 sigma of 300 rounds."""
    k, rounds = 6, 300
    medium = BuiltinMedium(
        _ring(k + 1, (ScanSchedule((ScanStep(6, (Waveform.OFDM_6M,)),)),)), Chance(7), surroundings=STILL
    )
    radio, at = [], []
    for turn in range(rounds):
        start = 1 + turn * 20 * NS_PER_MS
        radio += [k, *range(k)]
        at += [start, *(start + 60_000 + 100 * sender for sender in range(k))]
    medium.offer(0, _batch(np.array(radio), np.array(at), Waveform.OFDM_6M, 200))
    answer = medium.advance(rounds * 20 * NS_PER_MS + NS_PER_S, fixed_positions(medium.radios))
    first = np.isin(answer.heard.key, np.arange(rounds) * (k + 1)).sum()
    assert first == rounds, "who found the channel free is heard"
    alone = (len(answer.heard.key) - first) / (k * rounds)
    expected = (15.0 / 16.0) ** (k - 1)
    assert alone == pytest.approx(expected, abs=4.0 * math.sqrt(expected * (1.0 - expected) / (k * rounds)))
    middle = list(medium.radios).index(next(radio for radio in medium.radios if radio.name == "~"))
    assert medium.losses[middle, ReceptionOutcome.DECODED] == len(answer.heard.key)


def test_carrier_sense_is_fair_and_fills_the_channel() -> None:
    """Eight that always have a frame share the air within 10 %, and leave it idle for little more than DIFS and the
    shortest of eight backoffs (Bianchi 2000): busy above 75 %."""
    n, each = 8, 400
    medium = BuiltinMedium(_ring(n, ()), Chance(8), surroundings=STILL)
    radio = np.tile(np.arange(n), each)
    at = 1 + np.random.default_rng(9).integers(0, each * 5 * NS_PER_MS, n * each)
    medium.offer(0, _batch(radio, at, Waveform.OFDM_6M, 600))
    sent = medium.advance(each * 5 * NS_PER_MS, fixed_positions(medium.radios)).sent
    went = sent.fate == 0
    shares = np.bincount(sent.radio[went], minlength=n) / went.sum()
    assert shares == pytest.approx(1.0 / n, rel=0.1)
    busy = 0
    end = 0
    for start, stop in sorted(zip(sent.started_ns[went].tolist(), sent.ended_ns[went].tolist(), strict=True)):
        busy += max(stop - max(start, end), 0)
        end = max(end, stop)
    assert busy / end > 0.75
