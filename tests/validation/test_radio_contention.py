"""Do Wi-Fi radios wait, and receivers lock, as IEEE 802.11-2020 and measurements say? Clauses are of that standard."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.contracts.medium import (
    ANY_CHANNEL,
    OnAir,
    RadioSpec,
    ReceptionOutcome,
    TxBatch,
    Waveform,
)
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, NS_PER_S, NS_PER_US
from skyrange.radio.builtin.listening import SNIFFER
from skyrange.radio.builtin.medium import BuiltinMedium, fixed_positions
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.phy import WIDTH_MHZ, airtime_ns, bit_error, packet_error
from skyrange.radio.propagation.path_loss import noise_dbm

DSSS, OFDM = Waveform.DSSS_1M, Waveform.OFDM_6M
SLOT, DIFS = {DSSS: 20_000, OFDM: 9_000}, {DSSS: 50_000, OFDM: 28_000}
"""Tables 15-6 and 18-5, ns; DIFS is SIFS, 10 µs, and two slots (10.3.2.3.5)."""
ACK_NS = 304_000
"""192 µs of long preamble and header, and 14 bytes at 1 Mb/s (15.2.3)."""
SIFS_NS = 10_000
BYTES = 200


def _radio(name: str, east: float, north: float = 0.0, dbm: float = 15.0) -> RadioSpec:
    return RadioSpec(name, (east, north, 40.0), SNIFFER, wifi_dbm=dbm)


def _medium(*radios: RadioSpec, carrier_sense_dbm: float | None = None, seed: int = 1) -> BuiltinMedium:
    surroundings = RadioEnvironment(5_000.0, chance=False, carrier_sense_dbm=carrier_sense_dbm)
    return BuiltinMedium(radios, Chance(seed), surroundings=surroundings, every_pair=True)


def _send(medium: BuiltinMedium, rows: list[tuple[str, int]], waveform: Waveform = OFDM, size: int = BYTES) -> OnAir:
    """Frames by name of the sender and time, keys 0, 1, …; what came of them."""
    names = [radio.name for radio in medium.radios]
    count = len(rows)
    table = TxBatch(
        np.array([names.index(name) for name, _ in rows]), np.array([at for _, at in rows]),
        np.full(count, int(waveform)), np.full(count, ANY_CHANNEL), np.full(count, np.nan), np.full(count, size),
        np.arange(count),
    )  # fmt: skip
    medium.offer(0, table)
    return medium.advance(max(at for _, at in rows) + 2 * NS_PER_S, fixed_positions(medium.radios))


def _starts(answer: OnAir) -> dict[int, int]:
    assert (answer.sent.fate == 0).all()
    return dict(zip(answer.sent.key.tolist(), answer.sent.started_ns.tolist(), strict=True))


def _outcomes(medium: BuiltinMedium, answer: OnAir, receiver: str) -> dict[int, ReceptionOutcome]:
    row = [radio.name for radio in medium.radios].index(receiver)
    mine = answer.heard.radio == row
    pairs = zip(answer.heard.key[mine].tolist(), answer.heard.outcome[mine].tolist(), strict=True)
    return {key: ReceptionOutcome(outcome) for key, outcome in pairs}


@pytest.mark.parametrize("waveform", [DSSS, OFDM])
def test_who_receives_a_frame_defers_to_it(waveform: Waveform) -> None:
    """17.3.12 (OFDM), 15.4.6.5 (DSSS): the channel is busy for the length in a header that was received, whatever its
    power: here -86.8 dBm, below the -82 dBm that a receiver must detect at least (17.3.10.6)."""
    medium = _medium(_radio("a", -600.0), _radio("b", 600.0))
    starts = _starts(_send(medium, [("a", 1_000), ("b", 100_000)], waveform))
    waited = starts[1] - (starts[0] + airtime_ns(waveform, BYTES)) - DIFS[waveform]
    assert waited >= 0
    assert waited % SLOT[waveform] == 0
    blind = _medium(_radio("a", -600.0), _radio("b", 600.0), carrier_sense_dbm=-82.0)
    assert _starts(_send(blind, [("a", 1_000), ("b", 100_000)], waveform))[1] == 100_000 + DIFS[waveform]


def test_two_clusters_that_hear_each_other_are_one() -> None:
    """Radios that all receive each other share the channel alike (10.3.4), 20 m apart or 1,200 m: the receiver between
    hears as many frames, within 5 sigma of the samples. Senders that sense -82 dBm alone lose a third more."""
    frames, span = 1_200, 600 * NS_PER_MS

    def heard(apart_m: float, carrier_sense_dbm: float | None = None) -> float:
        rng = np.random.default_rng(4)
        radios = [_radio("~", 0.0)]
        for side, west_east in enumerate((-0.5, 0.5)):
            places = rng.uniform(-5.0, 5.0, (20, 2)) + np.array([west_east * apart_m, 0.0])
            radios += [_radio(f"{side}{k:02d}", *place) for k, place in enumerate(places.tolist())]
        medium = _medium(*radios, carrier_sense_dbm=carrier_sense_dbm)
        at = rng.integers(1, span, frames).tolist()
        rows = [(f"{k % 2}{rng.integers(20):02d}", time) for k, time in enumerate(at)]
        outcomes = _outcomes(medium, _send(medium, rows), "~")
        return sum(outcome == ReceptionOutcome.DECODED for outcome in outcomes.values()) / frames

    near, far = heard(20.0), heard(1_200.0)
    sigma = math.sqrt(2.0 * near * (1.0 - near) / frames)
    assert far == pytest.approx(near, abs=5.0 * sigma)
    assert heard(1_200.0, -82.0) < near - 10.0 * sigma


def test_a_preamble_that_was_missed_leaves_its_energy() -> None:
    """17.3.10.6: who sent while a frame began, and so missed its preamble, senses it only from -62 dBm on. Two frames
    begin at once; the longer one is still on the air when the sender of the shorter has another frame."""
    for dbm, defers in ((0.0, False), (15.0, True)):  # -69.0 and -54.0 dBm over 45 m
        medium = _medium(_radio("a", 0.0), _radio("b", 45.0, dbm=dbm), seed=3)
        names = [radio.name for radio in medium.radios]
        sizes = np.array([100, 2_000, 100])
        at = np.array([1_000, 1_000, 400_000])
        who = np.array([names.index(name) for name in "aba"])
        medium.offer(0, TxBatch(who, at, np.full(3, 1), np.full(3, 6), np.full(3, np.nan), sizes, np.arange(3)))
        starts = _starts(medium.advance(NS_PER_S, fixed_positions(medium.radios)))
        assert starts[0] == starts[1]
        end = starts[1] + airtime_ns(OFDM, 2_000)
        assert (starts[2] >= end + DIFS[OFDM]) if defers else (starts[2] == 400_000 + DIFS[OFDM])


@pytest.mark.parametrize("waveform", [DSSS, OFDM])
def test_after_an_error_a_sender_waits_for_eifs(waveform: Waveform) -> None:
    """10.3.2.3.7: EIFS is SIFS, an Ack at the lowest mandatory rate, and DIFS. A sender waits that much longer after a
    collision than after a frame that it decoded; its backoff is the same, as it is addressed by name and time. A frame
    that it decodes in the meantime ends EIFS."""
    wanted = ("c", 150_000)

    def start(*others: tuple[str, int]) -> tuple[int, int]:
        medium = _medium(_radio("a", -30.0), _radio("b", 30.0), _radio("c", 0.0), _radio("d", 0.0, 9.0, dbm=0.0))
        answer = _send(medium, [wanted, *others], waveform)
        starts = _starts(answer)
        ends = dict(zip(answer.sent.key.tolist(), answer.sent.ended_ns.tolist(), strict=True))
        return starts[0], ends[len(others)]

    after_one, end = start(("a", 1_000))
    slots, rest = divmod(after_one - end - DIFS[waveform], SLOT[waveform])
    assert rest == 0
    assert 0 < slots <= {DSSS: 31, OFDM: 15}[waveform]
    if waveform == OFDM:  # two DSSS frames of equal power do not disturb each other: the receiver despreads one
        after_two, both = start(("a", 1_000), ("b", 1_000))
        assert both == end
        assert after_two - after_one == SIFS_NS + ACK_NS


def test_a_decoded_frame_ends_eifs() -> None:
    """10.3.2.3.7: "reception of an error-free frame during the EIFS resynchronizes the STA": from then on DIFS counts.

    a and b collide at c; e, which is nearer to a and so decodes its frame, sends after DIFS, within the EIFS of c."""
    medium = _medium(_radio("a", -30.0), _radio("b", 30.0), _radio("c", 0.0), _radio("e", -29.0))
    answer = _send(medium, [("c", 150_000), ("a", 1_000), ("b", 1_000), ("e", 150_000)])
    starts = _starts(answer)
    ends = dict(zip(answer.sent.key.tolist(), answer.sent.ended_ns.tolist(), strict=True))
    assert starts[3] < ends[1] + SIFS_NS + ACK_NS + DIFS[OFDM], "e did not wait for EIFS"
    assert _outcomes(medium, answer, "c")[3] == ReceptionOutcome.DECODED
    slots, rest = divmod(starts[0] - ends[3] - DIFS[OFDM], SLOT[OFDM])
    assert rest == 0
    assert 0 <= slots <= 15


def test_another_backoff_follows_each_transmission() -> None:
    """10.3.4.3: even if no frame waits. The next frame of the radio, handed to it 1 µs after the end of one, is sent
    after DIFS and 0 to 15 slots, uniformly: mean 7.5, variance (16² − 1)/12, within 4 sigma of 400. Handed to it when
    that time is over, it waits for DIFS alone (10.3.4.2)."""
    air, rounds, each = airtime_ns(OFDM, BYTES), 400, 10 * NS_PER_MS
    rows = []
    for k in range(rounds):
        first = 1 + k * each
        end = first + DIFS[OFDM] + air
        rows += [("a", first), ("a", end + NS_PER_US), ("a", first + each // 2)]
    starts = _starts(_send(_medium(_radio("a", 0.0)), rows))
    slots = []
    for k in range(rounds):
        first = 1 + k * each
        assert starts[3 * k] == first + DIFS[OFDM]
        number, rest = divmod(starts[3 * k + 1] - (starts[3 * k] + air) - DIFS[OFDM], SLOT[OFDM])
        assert rest == 0
        slots.append(number)
        assert starts[3 * k + 2] == first + each // 2 + DIFS[OFDM]
    assert set(slots) == set(range(16))
    assert np.mean(slots) == pytest.approx(7.5, abs=4.0 * math.sqrt(255.0 / 12.0 / rounds))


def test_a_radio_contends_for_one_frame_at_a_time() -> None:
    """10.3.4: one backoff timer, and one queue. Who has many frames waiting gets the channel no sooner than who has
    one at a time: the frames of "many", all handed to it at once, leave in their order, and one that comes alone to
    "one" wins the next place as often as not: within 4 sigma, plus the ties by which both lose."""
    wins, rounds, each = 0, 300, 20 * NS_PER_MS
    rows: list[tuple[str, int]] = []
    for k in range(rounds):
        rows += [("many", 1 + k * each)] * 6 + [("one", 1 + k * each + 100 * NS_PER_US)]
    starts = _starts(_send(_medium(_radio("many", 0.0), _radio("one", 20.0)), rows))
    ties = 0
    for k in range(rounds):
        mine = [starts[7 * k + number] for number in range(7)]
        assert mine[:6] == sorted(mine[:6])
        wins += mine[6] < mine[1]
        ties += mine[6] == mine[1]
    assert ties == pytest.approx(rounds / 16.0, abs=4.0 * math.sqrt(rounds / 16.0))
    assert wins == pytest.approx((rounds - ties) / 2.0, abs=4.0 * math.sqrt(rounds) / 2.0)


@pytest.mark.parametrize(
    ("later_us", "stronger_db", "received"),
    [(0.0, 6.0, True), (3.0, 6.0, True), (5.0, 6.0, False), (15.0, 6.0, False), (5.0, 11.0, True),
     (15.0, 11.0, True), (150.0, 11.0, True), (150.0, 6.0, False), (0.0, -6.0, False), (3.0, -6.0, False)],
)  # fmt: skip
@pytest.mark.parametrize("names", ["ab", "ba"])
def test_a_receiver_locks_on_the_strongest_preamble(
    later_us: float, stronger_db: float, received: bool, names: str
) -> None:
    """Of frames that begin within aCCATime, 4 µs (17.3.10.6, table 17-21), the strongest; later on only one that is 10
    dB stronger, during the preamble or after it (Lee et al., WinTECH 2007). Names and rows do not matter."""
    first, second = names[0], names[1]
    radios = [_radio(first, -600.0, dbm=15.0), _radio(second, 600.0, dbm=15.0 + stronger_db), _radio("~", 0.0)]
    medium = _medium(*radios, carrier_sense_dbm=0.0)
    answer = _send(medium, [(first, 1_000), (second, 1_000 + round(later_us * 1e3))])
    outcomes = _outcomes(medium, answer, "~")
    assert (outcomes[1] == ReceptionOutcome.DECODED) is received
    if received:
        assert outcomes[0] == ReceptionOutcome.BUSY
    else:
        assert outcomes[1] == ReceptionOutcome.BUSY
        assert (outcomes[0] == ReceptionOutcome.DECODED) is (stronger_db < -5.0)


def test_dsss_noise_bandwidth_cancels() -> None:
    """A DBPSK bit of 1 µs is wrong with 0.5·exp(−Eb/N0) (Proakis, "Digital Communications", 5.2-69), whatever the
    width: the noise counts in 22 MHz, and so does the gain of despreading. With 20 MHz of noise it would be 0.41 dB
    off; 0.026 dB are allowed, for kT = -174 dBm/Hz."""
    noise_figure, signal_dbm = 7.0, -96.5
    snir = 10.0 ** (0.1 * (signal_dbm - float(noise_dbm(noise_figure, float(WIDTH_MHZ[DSSS])))))
    density_dbm_hz = 10.0 * math.log10(1.380649e-23 * 290.0 * 1e3) + noise_figure
    ratio = 10.0 ** (0.1 * (signal_dbm - 60.0 - density_dbm_hz))
    assert bit_error(int(DSSS), snir) == pytest.approx(0.5 * math.exp(-ratio), rel=6e-3 * ratio)


def test_ofdm_meets_the_standards_budget() -> None:
    """17.3.10.2: 1,000 octets at 6 Mb/s are lost to 10 % at -82 dBm, assuming a noise figure of 10 dB and 5 dB of
    implementation margin: a budget in 20 MHz of noise. The model comes to that within 1 dB below."""
    low, high = 0.0, 10.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if packet_error(OFDM, middle, 1_000) > 0.1 else (low, middle)
    sensitivity = float(noise_dbm(10.0, float(WIDTH_MHZ[OFDM]))) + 5.0 + high
    assert -83.0 <= sensitivity <= -82.0
