"""Channel changes of Wi-Fi control links: what ends know, announcements, scans, hops, and jammers that follow."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.assembly.build import build
from skyrange.contracts.channel_plans import EndReport, FrameOutcome
from skyrange.contracts.mailboxes import ChannelOrder, Outbox
from skyrange.contracts.medium import RadioTable
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.defence.control_link.channel_change import (
    FRAMES_PER_H,
    GIVEN_UP,
    AircraftPolicy,
    ChannelChange,
    HopSequence,
    StationPolicy,
    needed_in_a_row,
    next_channel,
    stay_ns,
)
from skyrange.defence.placement import Alarm
from skyrange.radio.control_link.channel_changes import ChannelChanges, FollowingJammers
from skyrange.radio.control_link.interference import BurstAtReceiver
from skyrange.radio.control_link.params import WifiParams
from skyrange.radio.control_link.wifi_link import BEACON_NS, Transmitter, WifiLink
from skyrange.radio.control_link.wifi_rates import MAX_RETRIES, RATES_MBPS
from skyrange.radio.spectrum import NoiseBurst
from skyrange.scenario import Scenario

NOISE_DBM = -94.0
STEP: Time = 20 * NS_PER_MS
LINK = "gcs:a/1"
ORDER = ChannelOrder(LINK, "station", 11, 3, 5 * NS_PER_MS)


def wifi_link() -> WifiLink:
    """A link on channel 1 with 40 dB of SNIR."""
    link = WifiLink(LINK, WifiParams(), Transmitter("ap", 18.0), Transmitter("a/1", 18.0), NOISE_DBM)
    link.successes = np.ones((2, len(RATES_MBPS)))
    for direction in (link.to_aircraft, link.to_station):
        direction.signal_dbm = NOISE_DBM + 40.0
    link.watch()
    return link


def jam(link: WifiLink) -> None:
    """Let a reactive jammer, stronger than both signals, answer every frame."""
    for direction in (link.to_aircraft, link.to_station):
        direction.interference.bursts = [BurstAtReceiver(0, 100 * NS_PER_S, 20_000, 1.0, 0.0)]


def announce(link: WifiLink) -> tuple[int, Outbox]:
    """Carry out `ORDER`; returns the number of steps until the access point has changed."""
    changes, out = ChannelChanges([link], Chance(1)), Outbox()
    link.retune(ORDER)
    for k in range(100):
        if changes.carry_out(k * STEP, out):
            return k, out
    raise AssertionError("no change")


def report(
    channel: int = 1, snr_db: float = 40.0, associated: bool = True, outcomes: tuple[FrameOutcome, ...] = ()
) -> EndReport:
    return EndReport(LINK, channel, associated, snr_db, outcomes)


def station(params: ChannelChange, hops: HopSequence | None = None) -> StationPolicy:
    return StationPolicy(params, needed_in_a_row(params.false_alarms_per_h), {LINK: Alarm("a/1")}, hops)


# ---------------------------------------------------------------- what ends know


def test_a_jammed_frame_is_eight_failed_checks_at_the_receiver_and_no_acknowledgement_at_the_sender() -> None:
    link = wifi_link()
    link.to_station.carry(0, 100, (0.5, 0.5, 0.5, 0.5))
    jam(link)
    link.to_station.carry(NS_PER_S, 100, (0.5, 0.5, 0.5, 0.5))
    sent = link.report("aircraft", -1, 2 * NS_PER_S).outcomes
    received = link.report("station", -1, 2 * NS_PER_S).outcomes
    assert [(one.own, one.ok) for one in sent] == [(True, True), (True, False)]
    assert [(one.own, one.ok, one.failures) for one in received] == [(False, True, 0), (False, False, 1 + MAX_RETRIES)]
    assert link.report("station", NS_PER_S, NS_PER_S).outcomes == []


@given(st.floats(1e-6, 3600))
def test_the_number_of_frames_follows_from_the_rate_of_false_alarms(per_h: float) -> None:
    needed = needed_in_a_row(per_h)
    assert FRAMES_PER_H * GIVEN_UP**needed <= per_h * (1 + 1e-9)
    assert needed == 1 or FRAMES_PER_H * GIVEN_UP ** (needed - 1) > per_h
    assert needed_in_a_row(0.01) == 4


# ---------------------------------------------------------------- announcements


def test_an_aircraft_that_hears_an_announcement_changes_with_its_access_point() -> None:
    link = wifi_link()
    steps, out = announce(link)
    assert (link.station.channel, link.aircraft.channel) == (11, 11)
    assert 3 * BEACON_NS <= steps * STEP < 3 * BEACON_NS + STEP  # the beacons at 102.4, 204.8 and 307.2 ms
    assert link.down_until == steps * STEP + ORDER.retune_ns
    assert out.notes[0].data == {"from": 1, "to": 11, "told": 1, "of": 1}


def test_an_aircraft_that_hears_none_stays() -> None:
    link = wifi_link()
    jam(link)
    _, out = announce(link)
    assert (link.station.channel, link.aircraft.channel) == (11, 1)
    assert out.notes[0].data["told"] == 0


# ---------------------------------------------------------------- policies


def test_an_access_point_changes_at_the_fourth_frame_in_a_row_and_not_before() -> None:
    policy = station(ChannelChange())
    lost = [FrameOutcome(k, True, False, 0) for k in range(4)]
    assert policy.step(0, [report(outcomes=tuple(lost[:3]))]) == []
    assert policy.step(STEP, [report(outcomes=(FrameOutcome(9, True, True, 0),))]) == []
    alert, order = policy.step(2 * STEP, [report(outcomes=tuple(lost))])
    assert alert.kind == "channel.jammed"  # type: ignore[union-attr]
    assert order == ChannelOrder(LINK, "station", 11, 3, 5 * NS_PER_MS)
    assert policy.step(3 * STEP, [report(outcomes=tuple(lost))]) == []  # it stays for long enough to be found
    later = 2 * STEP + 3 * BEACON_NS + stay_ns(ChannelChange())
    assert len(policy.step(later, [report(outcomes=tuple(lost))])) == 2


def test_losses_of_a_weak_signal_are_distance() -> None:
    """6 Mb/s needs 4 dB, and a lost association 20 dB more."""
    link = wifi_link()
    for direction in (link.to_aircraft, link.to_station):
        direction.signal_dbm = NOISE_DBM - 3.0
    link.to_station.carry(0, 100, (0.9999, 0.5, 0.5, 0.5))
    assert link.report("aircraft", -1, NS_PER_S).outcomes == []
    assert [one.failures for one in link.report("station", -1, NS_PER_S).outcomes] == [0]
    assert station(ChannelChange()).step(0, [report(snr_db=23.0, associated=False)]) == []
    assert len(station(ChannelChange()).step(0, [report(snr_db=25.0, associated=False)])) == 2


def test_an_aircraft_scans_while_it_has_no_association() -> None:
    policy = AircraftPolicy(ChannelChange(channels=(1, 6, 11)), Alarm("a/1"), None)
    assert policy.step(0, [report()]) == []
    alert, order = policy.step(STEP, [report(associated=False)])
    assert alert.kind == "channel.lost"  # type: ignore[union-attr]
    assert order == ChannelOrder(LINK, "aircraft", 6, action="scan")
    assert policy.step(2 * STEP, [report(6, associated=False)]) == []
    assert policy.step(7 * STEP, [report(6, associated=False)]) == [ChannelOrder(LINK, "aircraft", 11, action="scan")]
    assert policy.step(8 * STEP, [report(11)]) == []


def test_both_ends_hop_alike() -> None:
    params = ChannelChange(channels=(1, 6, 11), hop_s=0.5)
    hops = [HopSequence(NS_PER_S // 2, params.channels, Chance(3), 7) for _ in range(2)]
    ends = station(params, hops[0]), AircraftPolicy(params, Alarm("a/1"), hops[1])
    seen = []
    for k in range(1000):
        orders = [end.step(k * STEP, [report(channel=0)]) for end in ends]
        assert [order.channel for order in orders[0]] == [order.channel for order in orders[1]]  # type: ignore[union-attr]
        seen += [order.channel for order in orders[0]]  # type: ignore[union-attr]
    assert len(seen) == 40
    assert set(seen) == {1, 6, 11}


OUTCOMES = st.builds(FrameOutcome, st.integers(0, 10**12), st.booleans(), st.booleans(), st.integers(0, 8))
REPORTS = st.builds(
    EndReport,
    st.just(LINK),
    st.integers(1, 13),
    st.booleans(),
    st.floats(allow_nan=True, allow_infinity=True),
    st.lists(OUTCOMES, max_size=40),
)


@given(st.lists(REPORTS, min_size=1, max_size=30), st.lists(st.integers(1, 13), min_size=5, max_size=13, unique=True))
def test_policies_take_any_report_and_order_channels_of_their_list(
    reports: list[EndReport], numbers: list[int]
) -> None:
    params = ChannelChange(channels=tuple(numbers))
    for policy in (station(params), AircraftPolicy(params, Alarm("a/1"), None)):
        for k, one in enumerate(reports):
            for act in policy.step(k * NS_PER_S, [one]):
                assert not isinstance(act, ChannelOrder) or act.channel in numbers


@given(st.integers(1, 13))
def test_the_next_channel_does_not_overlap(channel: int) -> None:
    assert abs(next_channel(channel, (1, 6, 11)) - channel) >= 4


# ---------------------------------------------------------------- the jammer that follows


class _Path:
    """Propagation with one gain."""

    def __init__(self, gain_db: float) -> None:
        self.gain_db = gain_db

    def gains_db(self, *_: object) -> np.ndarray:
        return np.array([self.gain_db])


@pytest.mark.parametrize(("gain_db", "found"), [(-99.0, True), (-101.0, False)])
def test_a_jammer_finds_the_new_channel_after_its_search_time_if_it_hears_it(gain_db: float, found: bool) -> None:
    """The access point radiates 18 dBm; a receiver hears -82 dBm."""
    access_point = Transmitter("ap", 18.0, 11)
    access_point.row, access_point.channel_since = 0, 10 * NS_PER_S
    jammers = FollowingJammers([access_point])
    burst = NoiseBurst(1, 2412.0, 20.0, 0.0, 0, 99, 20_000, access_point.address, NS_PER_S)
    paths = {2462.0: _Path(gain_db)}
    nowhere = RadioTable(0, np.zeros((2, 3)), np.zeros((2, 3)))

    def centre(at: Time) -> float:
        return jammers.tune(at, [burst], paths, nowhere)[0].centre_mhz  # type: ignore[arg-type]

    assert centre(11 * NS_PER_S - 1) == 2412.0
    assert centre(11 * NS_PER_S) == (2462.0 if found else 2412.0)


# ---------------------------------------------------------------- what is refused

BASE = """
seed = 1
origin = { lat = 40.778, lon = -73.955 }
[radio]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = { square = { side_m = 80, alt_m = 20 } }
  [[operators.vehicles]]
  id = "b2"
  start = [20, 0]
  plan = { square = { side_m = 80, alt_m = 20 } }
"""
WIFI = '[[links]]\nmatch = "gcs:*"\nchannel = "wifi"\n'
CELLULAR = (
    '[[links]]\nmatch = "gcs:*"\nchannel = "cellular"\n'
    'cellular = { base_stations = [{ id = "west", place = [0, 0, 25] }] }\n'
)


@pytest.mark.parametrize(
    ("links", "params", "message"),
    [
        ("", "{}", 'control link over Wi-Fi.*channel = "wifi"'),
        (CELLULAR, "{}", "control link over Wi-Fi"),
        (CELLULAR, '{ vehicles = ["blue/b1"] }', "control link over Wi-Fi.*operator"),
        (WIFI, '{ vehicles = ["blue/b1"] }', "all aircraft of its access point, also blue/b2"),
        (WIFI, "{ channels = [1, 14] }", "13"),
        (WIFI, "{ channels = [1, 3] }", "at least 4 numbers apart"),
        (WIFI, "{ channels = [1, 1, 11] }", "each channel once"),
        (WIFI, "{ hop_s = 0.05 }", "0.1"),
    ],
)
def test_what_cannot_be_is_refused_before_the_run(links: str, params: str, message: str) -> None:
    table = f'[[defences]]\nid = "channel"\nkind = "control_link.channel_change"\nparams = {params}\n'
    with pytest.raises(InputError) as caught:
        build(Scenario.from_toml(BASE + links + table))
    assert re.search(message, str(caught.value), re.DOTALL), caught.value
