"""The engine of OMNeT++ and INET: conformance, exact powers, channel access, own losses, and how it fails."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from skyrange.codec.medium_protocol import (
    NO_RADIO,
    NOISE,
    PATH,
    TRANSMISSION,
    Advance,
    Building,
    Done,
    EngineRadio,
    Hello,
    MessageType,
    decode_done,
    decode_losses,
    decode_ready,
    encode_advance,
    encode_hello,
    encode_path_losses,
)
from skyrange.contracts.medium import ReceptionOutcome, TransmissionFate, Waveform
from skyrange.core.errors import ComponentError
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_MS, NS_PER_S, NS_PER_US
from skyrange.io.processes.program_socket import EngineSocket
from skyrange.radio.external.omnetpp import OMNETPP, find_command
from skyrange.radio.phy import airtime_ns
from skyrange.testing import check_medium
from tests.radio_engines import needs_omnetpp

pytestmark = needs_omnetpp

OFDM, DSSS = int(Waveform.OFDM_6M), int(Waveform.DSSS_1M)
SLOT_NS, SIFS_NS = 9 * NS_PER_US, 10 * NS_PER_US
"""IEEE 802.11-2020 table 18-5, with the short slot time."""
DIFS_NS = SIFS_NS + 2 * SLOT_NS
"""IEEE 802.11-2020 10.3.7."""
LIGHT_M_PER_NS = 0.299792458
Frame = tuple[int, int, int, int, int]
"""Key, sender, time, waveform, size; on channel 6 with 15 dBm unless said otherwise."""


class Engine:
    """An engine with `count` radios, all of which hear each other with `gain_db`."""

    def __init__(
        self, places: NDArray[np.float64], gain_db: float = -70.0, params: Mapping[str, str] | None = None,
        names: Sequence[str] = (), seed: int = 1, own_losses: bool = False, buildings: Sequence[Building] = (),
    ) -> None:  # fmt: skip
        self.places, self.gain_db = np.asarray(places, dtype=np.float64), gain_db
        names = names or [f"r{k:03d}" for k in range(len(self.places))]
        radios = [EngineRadio(name, hash64(name), 7.0) for name in names]
        self.socket = EngineSocket("omnetpp", find_command(), 60.0)
        hello = Hello(seed, 1e5, own_losses, radios, params or {}, buildings)
        try:
            self.ready = decode_ready(self.socket.request(MessageType.HELLO, encode_hello(hello))[1])
        except BaseException:
            self.socket.close()
            raise

    def advance(
        self, until: int, frames: Sequence[Frame] = (), noise: Sequence[tuple[int, int, float, float, float]] = (),
        *, channel: int = 6, dbm: float = 15.0,
    ) -> Done:  # fmt: skip
        """Noise rows: from, to, centre, width, dBm at every radio."""
        everyone = range(len(self.places))
        paths: list[tuple[float, int, int]] = []
        sent, noises = np.zeros(len(frames), dtype=TRANSMISSION), np.zeros(len(noise), dtype=NOISE)
        for row, (key, sender, at, waveform, size) in enumerate(frames):
            others = [(self.gain_db, k, 0) for k in everyone if k != sender]
            sent[row] = (key, at, dbm, sender, size, waveform, channel, len(paths), len(others), 0)
            paths += others
        for row, (begin, end, centre, width, power) in enumerate(noise):
            noises[row] = (begin, end, centre, width, 0.0, NO_RADIO, len(paths), len(self.places), 0)
            paths += [(power, k, 0) for k in everyone]
        body = encode_advance(Advance(until, 0, self.places, sent, noises, np.array(paths, dtype=PATH)))
        kind, answer = self.socket.request(MessageType.ADVANCE, body)
        assert kind == MessageType.DONE
        return decode_done(answer)


@pytest.fixture
def start() -> Iterator[Any]:
    made: list[Engine] = []

    def begin(*arguments: Any, **options: Any) -> Engine:
        made.append(Engine(*arguments, **options))
        return made[-1]

    yield begin
    for engine in made:
        engine.socket.close()


def _ring(count: int, radius_m: float = 25.0) -> NDArray[np.float64]:
    angle = 2.0 * math.pi * np.arange(count) / count
    return np.column_stack((radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(count, 40.0)))


@pytest.mark.parametrize(
    "params",
    [
        {},
        {"sensitivity_dbm": -110.0, "snir_threshold_db": 0.0, "error_model": "yans"},
        {"snir_mode": "mean"},
    ],
)
def test_it_conforms(params: dict[str, Any]) -> None:
    check_medium(OMNETPP, params)


def test_it_says_what_it_is(start: Any) -> None:
    ready = start(_ring(2)).ready
    assert ready.name == "OMNeT++"
    assert "INET 4." in ready.release
    assert ready.waveforms == 1 << DSSS | 1 << OFDM


@pytest.mark.parametrize("waveform", [DSSS, OFDM])
@pytest.mark.parametrize("size", [28, 29, 180, 2346])
def test_airtimes_are_those_of_the_standard(start: Any, waveform: int, size: int) -> None:
    """IEEE 802.11-2020 15.2.3 (DSSS), and 17.4.3 with the signal extension of 18.3.2.4 (OFDM in the 2.4 GHz band)."""
    sent = start(_ring(2)).advance(100 * NS_PER_MS, [(1, 0, NS_PER_MS, waveform, size)]).sent
    assert (sent["ended_ns"] - sent["started_ns"]).tolist() == [airtime_ns(waveform, size)]
    assert sent["started_ns"].tolist() == [NS_PER_MS]  # the channel has been idle for more than DIFS and any backoff


def test_powers_and_times_are_exact(start: Any) -> None:
    engine = start([(0.0, 0.0, 10.0), (1500.0, 0.0, 10.0)], gain_db=-83.0625)
    done = engine.advance(10 * NS_PER_MS, [(5, 0, 1, OFDM, 200)], dbm=17.5)
    heard = done.heard
    assert heard["rssi_dbm"].tolist() == [17.5 - 83.0625]
    # thermal noise (k·290 K·20 MHz) and the noise figure of 7 dB
    noise_dbm = 10.0 * math.log10(1.380649e-23 * 290.0 * 20e6 * 1e3) + 7.0
    assert heard["snir_db"][0] == pytest.approx(17.5 - 83.0625 - noise_dbm, abs=1e-6)
    assert (heard["ended_ns"] - done.sent["ended_ns"]).tolist() == [int(1500.0 / LIGHT_M_PER_NS)]


def test_times_before_zero_are_simulated(start: Any) -> None:
    done = start(_ring(2)).advance(0, [(5, 0, -2 * NS_PER_S, OFDM, 200)])
    assert done.sent["started_ns"].tolist() == [-2 * NS_PER_S]


def test_a_frame_waits_for_difs_and_whole_slots(start: Any) -> None:
    """IEEE 802.11-2020 10.3.4.3: DIFS after the medium became idle, then a backoff of 0 to CWmin = 15 slots."""
    seen = set()
    for seed in range(12):
        engine = start([(0.0, 0.0, 10.0), (0.0, 0.0, 11.0)], seed=seed)
        done = engine.advance(20 * NS_PER_MS, [(1, 0, NS_PER_MS, OFDM, 500), (2, 1, NS_PER_MS + 1_000, OFDM, 200)])
        first_end, start_ns = done.sent["ended_ns"][0], done.sent["started_ns"][1]
        delay = int(2.0 * 0.5 / LIGHT_M_PER_NS)  # radios that are one metre apart
        slots, rest = divmod(int(start_ns - first_end) - delay - DIFS_NS, SLOT_NS)
        assert rest == 0
        assert 0 <= slots <= 15
        seen.add(slots)
    assert len(seen) > 3  # the seed decides


@pytest.mark.parametrize("count", [2, 10, 30, 100])
def test_many_contend_and_all_are_told_of(start: Any, count: int) -> None:
    frames = [(k, k, NS_PER_MS + 9_973 * k % NS_PER_MS, OFDM, 180) for k in range(count)]
    done = start(_ring(count)).advance(NS_PER_S, sorted(frames, key=lambda frame: frame[2]))
    assert done.active == 0
    assert sorted(done.sent["key"].tolist()) == list(range(count))
    assert set(done.sent["fate"].tolist()) == {TransmissionFate.SENT}
    assert len(done.heard) == count * (count - 1)  # every pair has an outcome
    begins, ends = np.sort(done.sent["started_ns"]), np.sort(done.sent["ended_ns"])
    decoded = float((done.heard["outcome"] == ReceptionOutcome.DECODED).mean())
    if count == 2:
        assert decoded == 1.0
        assert begins[1] >= ends[0] + DIFS_NS
    else:
        assert decoded < 1.0  # some drew the same slot
    overlap = (done.sent["started_ns"][:, None] < done.sent["ended_ns"]) & (
        done.sent["started_ns"] < done.sent["ended_ns"][:, None]
    )
    alone = done.sent["key"][overlap.sum(axis=1) == 1]
    lost = done.heard[np.isin(done.heard["key"], alone) & (done.heard["outcome"] != ReceptionOutcome.DECODED)]
    assert len(lost) == 0  # at 39 dB above noise only collisions lose frames


def test_a_second_radio_far_off_changes_no_draw(start: Any) -> None:
    """The same frames among more radios: draws are addressed by names, not by rows."""
    frames = [(k, k, NS_PER_MS, OFDM, 180) for k in range(5)]
    few = start(_ring(5), names=[f"m{k}" for k in range(5)]).advance(NS_PER_S, frames)
    engine = start(np.vstack((_ring(5), [(0.0, 0.0, 9.0)])), names=["m0", "m1", "m2", "m3", "m4", "z"])
    more = engine.advance(NS_PER_S, frames)
    assert few.sent.tolist() == more.sent.tolist()
    assert few.heard.tolist() == more.heard[more.heard["radio"] < 5].tolist()


def test_noise_delays_frames_until_they_are_given_up(start: Any) -> None:
    engine = start(_ring(3))
    noise = [(1 + k * 100 * NS_PER_MS, 1 + (k + 1) * 100 * NS_PER_MS, 2437.0, 20.0, -70.0) for k in range(7)]
    frames = [(1, 0, NS_PER_MS, OFDM, 180), (2, 0, 2 * NS_PER_MS, OFDM, 180), (3, 1, 300 * NS_PER_MS, OFDM, 180)]
    sent = {int(row["key"]): row for row in engine.advance(2 * NS_PER_S, frames, noise).sent}
    assert [int(sent[key]["fate"]) for key in (1, 2, 3)] == [TransmissionFate.NO_ACCESS] * 2 + [TransmissionFate.SENT]
    assert [int(sent[key]["ended_ns"]) for key in (1, 2)] == [501 * NS_PER_MS, 502 * NS_PER_MS]
    assert int(sent[3]["started_ns"]) >= 700 * NS_PER_MS + DIFS_NS
    assert (int(sent[3]["started_ns"]) - 1 - 700 * NS_PER_MS - DIFS_NS) % SLOT_NS == 0


@pytest.mark.parametrize(("centre_mhz", "share"), [(2437.0, 1.0), (2447.0, 0.5), (2457.0, 0.0)])
def test_the_share_of_noise_in_the_band_counts(start: Any, centre_mhz: float, share: float) -> None:
    engine = start(_ring(2), gain_db=-95.0)
    noise = [(1, 50 * NS_PER_MS, centre_mhz, 20.0, -87.0)]
    row = engine.advance(60 * NS_PER_MS, [(1, 0, 10 * NS_PER_MS, OFDM, 180)], noise).heard[0]
    thermal_mw = 1.380649e-23 * 290.0 * 20e6 * 1e3 * 10.0**0.7
    expected = -80.0 - 10.0 * math.log10(thermal_mw + share * 10.0**-8.7)
    assert row["snir_db"] == pytest.approx(expected, abs=1e-6)
    assert row["outcome"] == ReceptionOutcome.DECODED


def test_outcomes_tell_collisions_from_weak_signals(start: Any) -> None:
    engine = start(_ring(3), gain_db=-98.0)
    quiet = engine.advance(20 * NS_PER_MS, [(1, 0, 10 * NS_PER_MS, OFDM, 180)]).heard
    noise = [(20 * NS_PER_MS + 1, 90 * NS_PER_MS, 2437.0, 20.0, -86.0)]
    covered = engine.advance(90 * NS_PER_MS, [(2, 0, 30 * NS_PER_MS, OFDM, 180)], noise).heard
    weak = engine.advance(120 * NS_PER_MS, [(3, 0, 100 * NS_PER_MS, OFDM, 180)], dbm=12.0).heard
    assert set(quiet["outcome"].tolist()) == {ReceptionOutcome.DECODED}
    assert set(covered["outcome"].tolist()) == {ReceptionOutcome.COLLIDED}
    assert set(weak["outcome"].tolist()) == {ReceptionOutcome.WEAK}  # -86 dBm, below INET's sensitivity


def test_two_that_begin_together_do_not_hear_each_other(start: Any) -> None:
    engine = start([(0.0, 0.0, 10.0), (300.0, 0.0, 10.0), (150.0, 1.0, 10.0)])
    heard = engine.advance(NS_PER_S, [(1, 0, NS_PER_MS, OFDM, 180), (2, 1, NS_PER_MS, OFDM, 180)]).heard
    outcome = {(int(row["key"]), int(row["radio"])): int(row["outcome"]) for row in heard}
    assert outcome[1, 1] == outcome[2, 0] == ReceptionOutcome.SENDING
    assert sorted((outcome[1, 2], outcome[2, 2])) == [ReceptionOutcome.COLLIDED, ReceptionOutcome.BUSY]


def test_a_radio_sends_one_frame_at_a_time_whatever_its_channel(start: Any) -> None:
    engine = start(_ring(2))
    first = engine.advance(NS_PER_MS, [(1, 0, 1, OFDM, 180)], channel=1)
    both = engine.advance(
        50 * NS_PER_MS, [(2, 0, NS_PER_MS + 1, DSSS, 180), (3, 0, NS_PER_MS + 1, OFDM, 180)], channel=11
    )
    assert first.sent["channel"].tolist() == [1]
    assert both.sent["key"].tolist() == [2, 3]
    assert both.sent["started_ns"][1] > both.sent["ended_ns"][0]
    assert both.heard["outcome"].tolist() == [ReceptionOutcome.DECODED] * 2


def test_a_frame_of_the_other_waveform_is_sensed_from_its_middle(start: Any) -> None:
    """The interface that senses is made while the frame is on the air."""
    frames = [(1, 0, NS_PER_MS, DSSS, 180), (2, 1, NS_PER_MS + 500 * NS_PER_US, OFDM, 180)]
    sent = start(_ring(2)).advance(50 * NS_PER_MS, frames).sent
    assert sent["key"].tolist() == [1, 2]
    assert sent["started_ns"][1] >= sent["ended_ns"][0] + DIFS_NS


@pytest.mark.parametrize("size", [0, 27, 2347])
def test_sizes_without_a_frame_are_refused(start: Any, size: int) -> None:
    sent = start(_ring(2)).advance(NS_PER_S, [(1, 0, NS_PER_MS, OFDM, size)]).sent
    assert sent["fate"].tolist() == [TransmissionFate.REFUSED]


def test_an_absent_radio_does_not_send(start: Any) -> None:
    engine = start([(0.0, 0.0, 10.0), (math.nan,) * 3])
    sent = engine.advance(NS_PER_S, [(1, 1, NS_PER_MS, OFDM, 180)]).sent
    assert sent["fate"].tolist() == [TransmissionFate.NO_ACCESS]


def _losses(start: Any, ends: Any, buildings: Sequence[Building] = (), **params: str) -> list[float]:
    engine = start(_ring(2), own_losses=True, buildings=buildings, params=params)
    found = engine.socket.request(MessageType.PATH_LOSSES, encode_path_losses(np.array(ends)))[1]
    return [float(loss) for loss in decode_losses(found)]


def test_own_losses_are_those_of_inets_models(start: Any) -> None:
    """Free space: ITU-R P.525-4 eq. 3. Two rays beyond the crossover distance: Rappaport 2002, eq. 4.52."""
    wavelength = 299_792_458.0 / 2.437e9
    ends = [(0.0, 0.0, 1.5, d, 0.0, 1.5) for d in (100.0, 1000.0)]
    free = [20.0 * math.log10(4.0 * math.pi * d / wavelength) for d in (100.0, 1000.0)]
    assert _losses(start, ends) == pytest.approx(free, abs=1e-9)
    crossover = 4.0 * math.pi * 1.5 * 1.5 / wavelength
    assert 100.0 < crossover < 1000.0
    far = 40.0 * math.log10(1000.0) - 20.0 * math.log10(1.5 * 1.5)
    assert _losses(start, ends, path_loss="two_ray") == pytest.approx([free[0], far], abs=1e-9)


def test_buildings_block_where_they_stand(start: Any) -> None:
    # an L: not convex, turning right
    corners = np.array([(100, 0), (100, 30), (110, 30), (110, 10), (130, 10), (130, 0)], dtype=np.float64)
    buildings = [Building(5.0, 20.0, corners)]
    through = (90.0, 5.0, 12.0, 140.0, 5.0, 12.0)
    clear = [
        (90.0, 5.0, 25.0, 140.0, 5.0, 25.0),  # above
        (90.0, 5.0, 4.0, 140.0, 5.0, 4.0),  # below its base
        (112.0, 12.0, 12.0, 150.0, 25.0, 12.0),  # in the notch
        (90.0, -1.0, 12.0, 140.0, -1.0, 12.0),  # beside
    ]
    top = (90.0, 5.0, 19.9, 140.0, 5.0, 19.9)
    open_ground = _losses(start, [through, top, *clear], buildings)
    ideal = _losses(start, [through, top, *clear], buildings, obstacle_loss="ideal")
    dielectric = _losses(start, [through, top, *clear], buildings, obstacle_loss="dielectric", material="glass")
    assert ideal[:2] == [math.inf] * 2
    assert ideal[2:] == open_ground[2:] == dielectric[2:]
    assert all(1.0 < a - b < 20.0 for a, b in zip(dielectric[:2], open_ground[:2], strict=True))


def test_a_frame_does_not_reach_behind_a_building(start: Any) -> None:
    wall = [Building(0.0, 50.0, np.array([(10.0, -50.0), (12.0, -50.0), (12.0, 50.0), (10.0, 50.0)]))]
    places = [(0.0, 0.0, 10.0), (30.0, 0.0, 10.0), (0.0, 30.0, 10.0)]
    engine = start(places, 3.0, {"obstacle_loss": "ideal"}, own_losses=True, buildings=wall)
    heard = engine.advance(NS_PER_S, [(1, 0, NS_PER_MS, OFDM, 180)]).heard
    free = 20.0 * math.log10(4.0 * math.pi * 30.0 * 2.437e9 / 299_792_458.0)
    assert heard["radio"].tolist() == [2]
    assert heard["rssi_dbm"][0] == pytest.approx(15.0 + 3.0 - free, abs=1e-9)  # 3 dB: the antennas


def test_a_fork_goes_on_alike(start: Any) -> None:
    engine = start(_ring(8))
    frames = [(k, k, NS_PER_MS + 1_000 * k, OFDM, 180) for k in range(8)]
    engine.advance(2 * NS_PER_MS, frames)  # one is on the air, others wait
    twin = object.__new__(Engine)
    twin.__dict__.update(engine.__dict__)
    twin.socket = engine.socket.fork()
    try:
        one, other = (each.advance(NS_PER_S) for each in (twin, engine))
        assert one.sent.tolist() == other.sent.tolist()
        assert one.heard.tolist() == other.heard.tolist()
        assert len(one.sent) > 0
    finally:
        twin.socket.close()


@pytest.mark.parametrize(
    ("params", "reason"),
    [
        ({"error_model": "perfect"}, "failed: error_model perfect: expected one of nist, yans"),
        ({"sensitivity_dbm": "loud"}, "failed: sensitivity_dbm loud: expected a number"),
        ({"colour": "red"}, "failed: the unknown parameter colour"),
    ],
)
def test_parameters_that_cannot_be_fail_with_a_reason(start: Any, params: dict[str, str], reason: str) -> None:
    with pytest.raises(ComponentError, match=reason):
        start(_ring(2), params=params)


def test_an_error_within_a_module_fails_with_a_reason(start: Any) -> None:
    """INET throws from a module of a radio if its own noise counts as a busy channel."""
    engine = start(_ring(2), params={"energy_detection_dbm": "-120"})
    with pytest.raises(ComponentError, match=r"failed: Receiver is busy without any ongoing .* in module"):
        engine.advance(NS_PER_S, [(1, 0, NS_PER_MS, OFDM, 180)])
