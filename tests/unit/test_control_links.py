"""Control links over the air: rates, retries, queues, associations, hand-overs, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.assembly.build import build
from skyrange.codec.wifi_management import (
    FrameRequest,
    decode_management,
    encode_deauthentication,
    pack_request,
    unpack_request,
)
from skyrange.contracts.frames import Fate
from skyrange.contracts.medium import Waveform
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S, NS_PER_US, Time
from skyrange.radio.control_link.cellular_link import EFFICIENCY, MIN_SNIR_DB, CellularLink, block_error, quality_of
from skyrange.radio.control_link.interference import BurstAtReceiver, Interference
from skyrange.radio.control_link.params import BaseStation, CellularParams, WifiParams
from skyrange.radio.control_link.wifi_link import Transmitter, WifiLink
from skyrange.radio.control_link.wifi_rates import (
    MAX_RETRIES,
    RATES_MBPS,
    REFERENCE_DB,
    airtime_ns,
    success_probability,
)
from skyrange.radio.control_link.wifi_rates import MIN_SNIR_DB as WIFI_SNIR_DB
from skyrange.radio.phy import packet_error
from skyrange.scenario import Link, Scenario

NOISE_DBM = -94.0


def wifi_link(snir_db: float = 40.0, rate: int = 0, **params: object) -> WifiLink:
    """A Wi-Fi link both of whose directions have `snir_db` and use a rate."""
    link = WifiLink(
        "gcs:a/1", WifiParams.model_validate(params), Transmitter("ap", 18.0), Transmitter("a/1", 18.0), NOISE_DBM
    )
    link.successes = np.ones((2, len(RATES_MBPS)))
    for direction in (link.to_aircraft, link.to_station):
        direction.signal_dbm, direction.rate = NOISE_DBM + snir_db, rate
    return link


def draws(seed: int, count: int) -> Sequence[tuple[float, float, float, float]]:
    chance = Chance(seed)
    return [chance.uniform4("test", 1, k) for k in range(count)]


# ---------------------------------------------------------------- Wi-Fi


def test_a_tenth_of_long_frames_is_lost_at_the_least_snir() -> None:
    for rate, snir_db in enumerate(WIFI_SNIR_DB):
        assert success_probability(rate, snir_db, 8000.0 + 24) == pytest.approx(0.9, abs=0.003)
    assert pytest.approx(WIFI_SNIR_DB[0], abs=0.1) == 4.0  # -82 dBm without 10 dB of noise figure and 5 dB of margin


def test_the_reference_of_the_curves_is_where_the_model_of_6_mbps_loses_a_tenth() -> None:
    low, high = -5.0, 20.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if packet_error(Waveform.OFDM_6M, middle, 1000) > 0.1 else (low, middle)
    assert pytest.approx(high, abs=1e-12) == REFERENCE_DB


def test_airtimes_are_those_of_the_standard() -> None:
    """802.11-2020, 17.4.3: 20 µs of preamble and header, 6 µs of extension, 4 µs a symbol of 24 to 216 bits."""
    assert airtime_ns(0, 14) == 50 * NS_PER_US  # an acknowledgement at 6 Mb/s: 6 symbols
    assert airtime_ns(7, 1500) == (26 + 4 * 56) * NS_PER_US


def test_losses_follow_the_error_rate_and_retries() -> None:
    """Each of eight attempts succeeds with p, so a frame is lost with (1 - p) to the eighth."""
    snir_db = 2.9
    p = success_probability(0, snir_db, 8.0 * (100 + 82))
    assert 0.02 < p < 0.5
    lost = 0
    numbers = draws(3, 4000)
    for k, four in enumerate(numbers):
        fate, _, _ = wifi_link(snir_db).to_aircraft.carry(k * NS_PER_S, 100, four)
        lost += fate is Fate.LOST
    expected = (1.0 - p) ** (1 + MAX_RETRIES)
    assert lost / len(numbers) == pytest.approx(expected, abs=4.0 * (expected / len(numbers)) ** 0.5)


@given(st.floats(0, 1, exclude_max=True), st.floats(0, 1, exclude_max=True), st.floats(-5, 40), st.integers(1, 280))
def test_a_frame_arrives_later_than_it_was_sent_and_frames_in_order(
    u: float, v: float, snir_db: float, size: int
) -> None:
    link = wifi_link(snir_db)
    last = 0
    for k in range(20):
        now = k * 100 * NS_PER_US
        fate, arrival, twin = link.to_aircraft.carry(now, size, (u, v, v, u))
        assert twin is None
        if fate is Fate.DELIVERED:
            assert arrival >= now + link.latency_ns
            assert arrival > last
            last = arrival


def test_a_queue_overflows_by_bytes_that_wait() -> None:
    link = wifi_link(queue_bytes=1000)
    fates = [link.to_aircraft.carry(0, 300, (0.5, 0.5, 0.5, 0.5))[0] for _ in range(5)]
    assert fates == [Fate.DELIVERED] * 3 + [Fate.OVERFLOW] * 2
    assert link.to_aircraft.carry(NS_PER_S, 300, (0.5, 0.5, 0.5, 0.5))[0] is Fate.DELIVERED


def test_links_of_one_access_point_share_its_time() -> None:
    station = Transmitter("ap", 18.0)
    links = [WifiLink(f"gcs:a/{n}", WifiParams(), station, Transmitter(f"a/{n}", 18.0), NOISE_DBM) for n in range(2)]
    for link in links:
        link.successes = np.ones((2, len(RATES_MBPS)))
        link.to_aircraft.signal_dbm = link.to_station.signal_dbm = NOISE_DBM + 40.0
    first, second = (link.to_aircraft.carry(0, 200, (0.5, 0.0, 0.5, 0.5))[1] for link in links)
    assert second - first >= airtime_ns(0, 282)


def test_occupancy_delays_and_noise_above_the_threshold_blocks() -> None:
    free, busy = wifi_link(), wifi_link()
    busy.station.occupancy = 0.9
    four = (0.5, 0.99, 0.5, 0.5)
    waited = busy.to_aircraft.carry(0, 100, four)[1] - free.to_aircraft.carry(0, 100, four)[1]
    assert waited == pytest.approx(9 * (28 + 15 * 9) * NS_PER_US, rel=0.01)
    jammed = wifi_link()
    jammed.to_aircraft.interference.bursts = [BurstAtReceiver(0, 40 * NS_PER_MS, 0, 0.0, -50.0)]
    assert jammed.to_aircraft.carry(0, 100, four)[1] > 40 * NS_PER_MS
    jammed = wifi_link()
    jammed.to_aircraft.interference.bursts = [BurstAtReceiver(0, 4 * NS_PER_S, 0, 0.0, -50.0)]
    assert jammed.to_aircraft.carry(0, 100, four)[0] is Fate.LOST  # after 500 time units


def test_a_reactive_jammer_destroys_what_follows_its_turnaround() -> None:
    loud_mw = 10.0 ** (-4.0)
    for turnaround_us, fate in ((20, Fate.LOST), (5000, Fate.DELIVERED)):
        link = wifi_link()
        link.to_aircraft.interference.bursts = [
            BurstAtReceiver(0, NS_PER_S, turnaround_us * NS_PER_US, loud_mw, -200.0)
        ]
        assert link.to_aircraft.carry(NS_PER_MS, 100, (0.3, 0.3, 0.3, 0.3))[0] is fate


def test_a_lost_answer_repeats_a_frame_that_has_arrived() -> None:
    """Noise at the station alone: the aircraft decodes the first attempt, and the radio goes on for all eight."""
    link = wifi_link()
    link.to_station.interference.bursts = [BurstAtReceiver(0, NS_PER_S, 0, 1e-4, -200.0)]
    fate, arrival, _ = link.to_aircraft.carry(0, 100, (0.5, 0.0, 0.5, 0.5))
    assert fate is Fate.DELIVERED
    assert arrival < 2 * NS_PER_MS
    assert link.station.busy_until > 8 * airtime_ns(0, 182)


def test_an_association_ends_after_seven_beacons_and_takes_time_to_return() -> None:
    link = wifi_link(reassociation_ms=400)
    times = range(0, 3 * NS_PER_S, 20 * NS_PER_MS)
    changes = [
        (t / NS_PER_S, link.update_association(t, beacons_heard=not 500 * NS_PER_MS <= t < 2 * NS_PER_S)) for t in times
    ]
    changes = [(at, why) for at, why in changes if why]
    assert changes == [(1.2, "no beacons"), (2.0, "beacons")]
    assert link.down_until == 2_400 * NS_PER_MS
    assert link.to_aircraft.carry(2_399 * NS_PER_MS, 50, (0.5,) * 4)[0] is Fate.LOST
    assert link.to_aircraft.carry(2_401 * NS_PER_MS, 50, (0.5,) * 4)[0] is Fate.DELIVERED


# ---------------------------------------------------------------- interference


bursts = st.lists(
    st.builds(
        BurstAtReceiver, st.integers(0, 900), st.integers(1, 1000), st.sampled_from([0, 0, 40]), st.floats(0, 1),
        st.just(-200.0),
    ),
    max_size=6,
)  # fmt: skip


@given(bursts, st.integers(0, 900), st.integers(1, 300))
def test_pieces_cover_a_frame_with_the_noise_of_each_instant(
    found: list[BurstAtReceiver], start: Time, length: Time
) -> None:
    noise = Interference(0.0)
    noise.bursts = found
    end = start + length
    pieces = noise.pieces(start, end)
    assert sum(share for share, _ in pieces) == pytest.approx(1.0)
    at = float(start)
    for share, power in pieces:
        middle = at + 0.5 * share * length
        met = [b.receiver_mw for b in found if max(b.from_ns, start + b.turnaround_ns) <= middle < min(b.to_ns, end)]
        assert power == pytest.approx(1.0 + sum(met))
        at += share * length


# ---------------------------------------------------------------- cellular


def cellular_link(cells: int = 2, **params: object) -> CellularLink:
    stations = [{"id": f"c{n}", "place": [0.0, 500.0 * n, 30.0]} for n in range(cells)]
    model = CellularParams.model_validate({"base_stations": stations, **params})
    return CellularLink("gcs:a/1", model, "a/1", -95.0, -110.0)


def test_qualities_are_those_of_the_formula() -> None:
    assert len(EFFICIENCY) == 15
    assert (np.diff(MIN_SNIR_DB) > 0).all()
    for quality, snir_db in enumerate(MIN_SNIR_DB.tolist()):
        assert quality_of(snir_db + 1e-9) == quality
        assert block_error(quality, snir_db) == pytest.approx(0.1)
    assert quality_of(-40.0) == 0
    assert block_error(0, -40.0, 4) > 0.999


def test_the_event_a3_waits_for_its_time_to_trigger() -> None:
    link = cellular_link(time_to_trigger_ms=600, hysteresis_db=3.0, interruption_ms=50)
    changes = []
    for k in range(40):
        now = k * 100 * NS_PER_MS
        powers = np.array([-80.0, -90.0 if k < 10 else -70.0])
        change = link.measure(now, powers)
        if change:
            changes.append((now // NS_PER_MS, change))
    assert changes[0] == (0, ("", "c0"))
    # at 1.0 s the filtered neighbour is equal, at 1.2 s 5 dB better; the event has held for 600 ms at 1.8 s
    assert changes[1:] == [(1800, ("c0", "c1"))]
    assert link.interrupted_until == 1_850 * NS_PER_MS


def test_no_hand_over_within_the_hysteresis() -> None:
    link = cellular_link()
    for k in range(100):
        link.measure(k * 200 * NS_PER_MS, np.array([-80.0, -77.5 if k else -90.0]))
    assert link.cell == "c0"


def test_a_weak_cell_is_lost_after_t310_and_found_again() -> None:
    link = cellular_link(reestablishment_ms=200)
    said = []
    for k in range(300):
        now = k * 20 * NS_PER_MS
        link.measure(now, np.array([-80.0, -90.0]))
        why = link.monitor(now, -10.0 if 50 <= k < 200 else 5.0)
        if why:
            said.append((now // NS_PER_MS, why))
    assert said == [(2000, "failure"), (4000, "cell found")]
    assert link.interrupted_until == 4_200 * NS_PER_MS


def test_hybrid_arq_delays_by_eight_milliseconds_and_gives_up_after_four() -> None:
    link = cellular_link()
    link.measure(0, np.array([-80.0, -90.0]))
    link.to_aircraft.signal_dbm = -95.0 + float(MIN_SNIR_DB[5])
    link.to_aircraft.quality = 5
    first = link.to_aircraft.carry(NS_PER_S, 100, (0.5, 0, 0, 0))[1] - NS_PER_S
    second = link.to_aircraft.carry(2 * NS_PER_S, 100, (0.05, 0, 0, 0))[1] - 2 * NS_PER_S
    assert second - first == 8 * NS_PER_MS
    link.to_aircraft.signal_dbm -= 30.0
    assert link.to_aircraft.carry(3 * NS_PER_S, 100, (0.5, 0, 0, 0))[0] is Fate.LOST


# ---------------------------------------------------------------- frames, bad input


@given(st.binary(max_size=80))
def test_hostile_requests_are_refused(payload: bytes) -> None:
    with pytest.raises(DecodeError):
        unpack_request(payload)
    with pytest.raises(DecodeError):
        unpack_request(b"\x1f\x01" + payload)


def test_a_deauthentication_is_an_802_11_frame() -> None:
    one, other = b"\x02\0\0\0\0\1", b"\x02\0\0\0\0\2"
    frame = encode_deauthentication(one, other, other, 5)
    assert len(frame) == 30
    assert frame[:2] == b"\xc0\x00"
    assert frame[24:26] == b"\x07\x00"
    header = decode_management(frame)
    assert (header.subtype, header.source, header.bssid) == (12, other, other)
    assert header.is_for(one)
    assert not header.is_for(other)
    assert unpack_request(pack_request(FrameRequest(1, 2000, frame))) == (1, 2000, frame)
    with pytest.raises(DecodeError, match="check sequence"):
        decode_management(frame[:-1] + bytes([frame[-1] ^ 1]))


HEAD = 'name = "x"\nduration_s = 5\norigin = [40.0, -73.0]\n'
FLEET = (
    '[[operators]]\nid = "blue"\n[[operators.vehicles]]\nid = "b1"\nplan = { square = { side_m = 20, alt_m = 10 } }\n'
)


@pytest.mark.parametrize(
    ("tables", "text"),
    [
        ('[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "lte"\n', "channel"),
        ('[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "cellular"\n', "base stations"),
        ('[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "wifi"\nloss = 0.1\n', "no such key, because channel is wifi"),
        ('[radio]\n[[links]]\nmatch = "gcs:*"\nwifi = { channel = 3 }\n', 'channel = "wifi"'),
        ('[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "wifi"\nwifi = { channel = 14 }\n', "13"),
        (
            '[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "cellular"\ncellular = { base_stations = '
            '[{ id = "a", place = [0, 0, 9] }, { id = "a", place = [9, 0, 9] }] }\n',
            "ids that differ",
        ),
    ],
)
def test_wrong_channels_are_refused(tables: str, text: str) -> None:
    with pytest.raises(InputError) as error:
        Scenario.from_toml(HEAD + tables + FLEET)
    assert text in str(error.value)


@pytest.mark.parametrize(
    ("tables", "text"),
    [
        ('[[links]]\nmatch = "gcs:*"\nchannel = "wifi"\n', "a radio medium"),
        ('[radio]\n[[links]]\nmatch = "log:*"\nchannel = "wifi"\n', "a gcs link"),
        (
            '[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "wifi"\nwifi = { place = [0, 0, -3] }\n',
            "a place on the ground",
        ),
        (
            '[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "cellular"\ncellular = { base_stations = '
            '[{ id = "a", place = [0, 0, -9] }] }\n',
            "a place on the ground",
        ),
    ],
)
def test_links_that_cannot_be_on_the_air_are_refused(tables: str, text: str) -> None:
    with pytest.raises(InputError) as error:
        build(Scenario.from_toml(HEAD + tables + FLEET))
    assert text in str(error.value)


def test_the_last_rule_says_what_a_channel_is() -> None:
    scenario = Scenario.from_toml(HEAD + '[radio]\n[[links]]\nmatch = "*"\nlatency_ms = 5\n' + FLEET)
    rules = (*scenario.links, Link(match="gcs:*", channel="wifi"), Link(match="gcs:blue/b1", channel="fixed"))
    assert scenario.model_copy(update={"links": rules}).over_air("gcs:blue/b1") is None
    assert scenario.model_copy(update={"links": rules[:2]}).over_air("gcs:blue/b1") == WifiParams()
    assert BaseStation(id="a", place=(0, 0, 9)).power_dbm == 46.0
