"""Do the media of network simulators conform, and does each of their parts do what skyrange hands over?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from skyrange.codec.medium_protocol import (
    NOISE,
    PATH,
    TRANSMISSION,
    Advance,
    MessageType,
    decode_done,
    encode_advance,
)
from skyrange.contracts.medium import ANY_CHANNEL, RadioSpec, RadioTable, TxBatch, Waveform
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_MS
from skyrange.radio.builtin.listening import SNIFFER
from skyrange.radio.contract import MediumContext, MediumPlugin
from skyrange.radio.external.medium import ExternalMedium
from skyrange.radio.phy import airtime_ns
from skyrange.testing import check_medium
from tests.radio_engines import needs_ns3, needs_omnetpp

ENGINES = [pytest.param("ns3", marks=needs_ns3), pytest.param("omnetpp", marks=needs_omnetpp)]


@pytest.mark.parametrize("engine", ENGINES)
def test_it_conforms(engine: str) -> None:
    check_medium(MediumPlugin.find(engine))


@needs_ns3
@pytest.mark.parametrize("params", [{"error_model": "nist", "preamble_rssi_dbm": -101}, {"capture_margin_db": 5}])
def test_ns3_conforms_with_other_models(params: dict[str, object]) -> None:
    check_medium(MediumPlugin.find("ns3"), params)


@pytest.fixture(params=ENGINES)
def medium(request: pytest.FixtureRequest) -> Iterator[ExternalMedium]:
    plugin = MediumPlugin.find(request.param)
    radios = [RadioSpec(name, listening=SNIFFER) for name in "abcd"]
    made = plugin(plugin.params(), MediumContext(radios, Chance(1)))
    assert isinstance(made, ExternalMedium)
    yield made
    made.close()


def _frames(count: int, size: int, waveform: Waveform = Waveform.OFDM_6M) -> TxBatch:
    at = NS_PER_MS + 20 * NS_PER_MS * np.arange(count)
    same = np.zeros(count, dtype=np.int64)
    return TxBatch(
        same, at, same + waveform, same + ANY_CHANNEL, np.full(count, 10.0), same + size, np.arange(count)
    )  # fmt: skip


PLACES = np.array([(0.0, 0.0, 50.0), (30.0, 0.0, 50.0), (0.0, 80.0, 60.0), (np.nan, np.nan, np.nan)])


def test_airtimes_are_those_of_the_standard(medium: ExternalMedium) -> None:
    """IEEE 802.11-2020 17.4.3 and 18.3.2.4 for OFDM: the same formula as the builtin's."""
    for number, size in enumerate((36, 60, 178, 277, 1000, 2346)):
        batch = _frames(1, size)
        batch.at_ns[:] += 100 * NS_PER_MS * number
        medium.offer(batch.at_ns.item(0) - 1, batch)
        until = batch.at_ns.item(0) + 50 * NS_PER_MS
        sent = medium.advance(until, RadioTable(0, PLACES, np.zeros_like(PLACES))).sent
        assert (sent.ended_ns - sent.started_ns).tolist() == [airtime_ns(int(Waveform.OFDM_6M), size)]


def test_powers_are_those_that_were_handed_over(medium: ExternalMedium) -> None:
    table = RadioTable(0, PLACES, np.zeros_like(PLACES))
    medium.offer(0, _frames(1, 200))
    heard = medium.advance(20 * NS_PER_MS, table).heard
    assert heard.radio.tolist() == [1, 2]  # never the absent one
    paths = medium._finder.find(table, 0, 10.0, 2437.0, NS_PER_MS)
    expected = 10.0 + paths["gain_db"]
    assert np.abs(heard.rssi_dbm - expected).max() < 0.2


def test_noise_drowns_a_frame(medium: ExternalMedium) -> None:
    """Noise that is 40 dB above the frame's power at its receivers, and too weak at the sender to defer to."""
    table = RadioTable(0, PLACES, np.zeros_like(PLACES))
    medium.advance(NS_PER_MS, table)
    for drowned in (False, True):
        begin = (1 + 40 * drowned) * NS_PER_MS
        frames, noise = np.zeros(1, dtype=TRANSMISSION), np.zeros(int(drowned), dtype=NOISE)
        frames[0] = (int(drowned), begin + 5 * NS_PER_MS, 10.0, 0, 200, Waveform.OFDM_6M, 6, 0, 2, 0)
        paths = np.zeros(4, dtype=PATH)
        paths["gain_db"], paths["radio"] = (-70.0, -70.0, -70.0, -70.0), (1, 2, 1, 2)
        if drowned:
            noise[0] = (begin + 1, begin + 30 * NS_PER_MS, 2437.0, 20.0, 50.0, 3, 2, 2, 0)
        body = encode_advance(Advance(begin + 35 * NS_PER_MS, 0, PLACES, frames, noise, paths))
        kind, answer = medium._engine.request(MessageType.ADVANCE, body)
        assert kind == MessageType.DONE
        done = decode_done(answer)
        assert done.sent["fate"].tolist() == [0]
        decoded = sorted(done.heard[done.heard["outcome"] == 0]["radio"].tolist())
        assert decoded == ([] if drowned else [1, 2])
        assert drowned == bool((done.heard["outcome"] == 2).any())


def test_requests_that_cannot_be_end_it_with_a_reason(medium: ExternalMedium) -> None:
    none = np.zeros(0, dtype=TRANSMISSION), np.zeros(0, dtype=NOISE), np.zeros(0, dtype=PATH)
    wrong = np.zeros(1, dtype=TRANSMISSION)
    wrong["radio"], wrong["at_ns"] = 99, 5
    with pytest.raises(ComponentError, match="failed: an ADVANCE with a row"):
        medium._engine.request(MessageType.ADVANCE, encode_advance(Advance(10, 0, PLACES, wrong, *none[1:])))


@pytest.mark.parametrize("body", [b"", b"\xff" * 100, b"\0" * 32 + b"x"])
def test_hostile_requests_end_it_with_a_reason(medium: ExternalMedium, body: bytes) -> None:
    with pytest.raises(ComponentError, match=r"failed: a (message|count)"):
        medium._engine.request(MessageType.ADVANCE, body)


@needs_ns3
def test_ns3_computes_free_space() -> None:
    """Friis at 2.437 GHz: 20·log10(4·pi·d/λ), ITU-R P.525-4 eq. 3."""
    plugin = MediumPlugin.find("ns3")
    context = MediumContext([RadioSpec("a", listening=SNIFFER)], Chance(1), losses="engine")
    made = plugin(plugin.params.model_validate({"path_loss": "friis"}), context)
    assert isinstance(made, ExternalMedium)
    try:
        ends = np.array([(0.0, 0.0, 10.0, d, 0.0, 10.0) for d in (10.0, 100.0, 1000.0)])
        exact = 20.0 * np.log10(4.0 * np.pi * np.array([10.0, 100.0, 1000.0]) * 2.437e9 / 299_792_458.0)
        assert np.abs(made.path_losses_db(ends) - exact).max() < 0.01
    finally:
        made.close()
