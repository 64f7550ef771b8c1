"""Radios of attackers beside Wi-Fi links: range, keys, associations, jammers, airtime, and what they hear."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from skyrange.contracts.frames import Fate
from skyrange.contracts.links import RadioSite
from skyrange.contracts.mailboxes import Inbox
from skyrange.contracts.medium import RadioTable
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, NS_PER_S, NS_PER_US, Time
from skyrange.radio.control_link.foreign_radio import QUEUE_BYTES, ForeignRadio
from skyrange.radio.control_link.links import STEP_NS, ControlLinks
from skyrange.radio.control_link.params import WifiParams
from skyrange.radio.control_link.propagation import Propagation
from skyrange.radio.control_link.wifi_link import Transmitter, WifiLink
from skyrange.radio.control_link.wifi_rates import DIFS_NS, MAX_RETRIES, airtime_ns
from skyrange.radio.phy import OFDM, centre_mhz
from skyrange.radio.spectrum import NoiseBurst, Spectrum

NOISE_DBM = -94.0
CENTRE = centre_mhz(OFDM, 1)
Place = tuple[float, float, float]
MIDDLE = (0.5, 0.0, 0.5, 0.5)
"""Uniforms of a frame that arrives if half of such frames do, without a backoff."""


class Air:
    """An access point, an aircraft, and a radio of somebody else on their channel; a jammer where the test wants it."""

    def __init__(
        self,
        radio_at: Place = (10.0, 0.0, 2.0),
        *,
        power_dbm: float = 18.0,
        aircraft_at: Place = (50.0, 0.0, 20.0),
        jammer_at: Place = (0.0, 5000.0, 2.0),
        noise_dbm: float | None = None,
        has_key: bool = False,
        encrypted: bool = False,
    ) -> None:
        self.spectrum = Spectrum()
        self.spectrum.radios = ["a/1", "jammer"]
        self.spectrum.table = RadioTable(0, np.array([aircraft_at, jammer_at]), np.zeros((2, 3)))
        if noise_dbm is not None:
            self.spectrum.bursts = [NoiseBurst(1, CENTRE, 20.0, noise_dbm, 0, 100 * NS_PER_S)]
        self.station = Transmitter("ap", 18.0)
        self.link = WifiLink(
            "gcs:a/1", WifiParams(encrypted=encrypted), self.station, Transmitter("a/1", 18.0), NOISE_DBM
        )
        site = RadioSite("x.radio", radio_at, power_dbm, has_key)
        self.radio = ForeignRadio(self.link, site, Transmitter("x.radio", power_dbm), NOISE_DBM)
        places = {"ap": (0.0, 0.0, 2.0), "x.radio": radio_at}
        names = [*self.spectrum.radios, *places]
        propagation = Propagation(names, [("isotropic", 0.0)] * len(names), Chance(1), None, randomness=False)
        self.agent = ControlLinks(
            [self.link],
            [],
            self.spectrum,
            places=places,
            propagation={CENTRE: propagation},
            chance=Chance(1),
            foreign=[self.radio],
        )
        self.agent.step(0, Inbox([], []))

    def inject(self, now: Time = NS_PER_MS, draws: tuple[float, float, float, float] = MIDDLE) -> Fate:
        """What becomes of a command of 57 bytes that the radio sends in the name of the station."""
        return self.radio.open("fwd").carry(now, 57, draws)[0]

    def hears(self, direction: str = "fwd", now: Time = NS_PER_MS) -> bool:
        """Whether the radio decodes a frame of an end."""
        self.link.open(direction).carry(now, 57, MIDDLE)
        return self.radio.hear(direction, MIDDLE[0]) is not None


# ---------------------------------------------------------------- one model for all radios


@settings(deadline=None)
@given(
    place=st.tuples(st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(1, 100)),
    power_dbm=st.floats(-10, 40),
    jammer_dbm=st.one_of(st.none(), st.floats(-60, 30)),
    uniform=st.floats(0.0, 1.0, exclude_max=True),
)
def test_a_forged_frame_arrives_as_one_transmission_of_a_station_with_that_place_and_power_does(
    place: Place, power_dbm: float, jammer_dbm: float | None, uniform: float
) -> None:
    """The station's eight transmissions all fail with the eighth power of the probability that one does."""
    air = Air(place, power_dbm=power_dbm, noise_dbm=jammer_dbm)
    own = WifiLink("gcs:a/1", WifiParams(encrypted=False), Transmitter("s", power_dbm), Transmitter("a", 18.0), -94.0)
    own.successes = np.ones((2, 8))
    for direction, path in ((own.to_aircraft, air.radio.to_aircraft.path), (own.to_station, air.radio.from_aircraft)):
        direction.interference.bursts = path.interference.bursts
    gain = air.agent._propagation[CENTRE].gains_db(  # independently of what the agent has written
        RadioTable(0, np.array([[50.0, 0.0, 20.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], place]), np.zeros((4, 3))),
        np.array([3]), np.array([0]), CENTRE, 0,
    ).item()  # fmt: skip
    own.to_aircraft.signal_dbm = power_dbm + gain
    own.to_station.signal_dbm = -np.inf  # it gets no acknowledgement, as a radio that forges addresses does
    missed = 1.0 - own.to_aircraft._success(0, airtime_ns(0, 57 + own.overhead_bytes), 0, 57 + own.overhead_bytes)
    assume(abs(missed - uniform) > 1e-9)
    station = own.to_aircraft.carry(NS_PER_MS, 57, (uniform ** (1 + MAX_RETRIES), 0.0, 0.5, 0.5))[0]
    assert air.inject(draws=(uniform, 0.0, 0.5, 0.5)) is station


# ---------------------------------------------------------------- what keeps a forged frame from arriving


def test_a_forged_frame_arrives_within_range_and_not_beyond() -> None:
    assert Air((100.0, 0.0, 2.0)).inject() is Fate.DELIVERED
    assert Air((9000.0, 0.0, 2.0)).inject() is Fate.LOST


def test_a_receiver_without_association_drops_it() -> None:
    air = Air()
    air.link.disconnect(0)
    assert air.inject() is Fate.LOST
    assert air.inject(NS_PER_S) is Fate.DELIVERED  # it has found its access point again
    air.link.associated = False
    assert air.inject(2 * NS_PER_S) is Fate.LOST


def test_encryption_needs_the_key_and_costs_its_bytes_on_the_air() -> None:
    assert Air(encrypted=True).inject() is Fate.LOST
    assert Air(encrypted=True, has_key=True).inject() is Fate.DELIVERED
    clear, hidden = (Air(encrypted=one).link.overhead_bytes for one in (False, True))
    assert hidden - clear == 8 + 8  # IEEE 802.11-2020, 12.5.3.2: CCMP header, and check of 128 bits' key


def test_a_jammer_near_the_aircraft_stops_it_and_one_far_away_does_not() -> None:
    assert Air(jammer_at=(55.0, 0.0, 20.0), noise_dbm=10.0).inject() is Fate.LOST
    assert Air(jammer_at=(0.0, 5000.0, 2.0), noise_dbm=10.0).inject() is Fate.DELIVERED


def test_noise_counts_where_a_frame_is_received() -> None:
    """300 m away signals have -72 dBm; a jammer 5 m from a receiver has -69 dBm there, too little to defer to."""
    at = (300.0, 0.0, 2.0)
    near_aircraft, near_attacker = ((50.0, 5.0, 20.0), (300.0, 5.0, 2.0))
    found = []
    for jammer_at in (near_aircraft, near_attacker):
        air = Air(at, jammer_at=jammer_at, noise_dbm=-15.0)
        found.append((air.inject(), air.hears("fwd"), air.hears("rev")))
    assert found == [(Fate.LOST, True, True), (Fate.DELIVERED, False, False)]


def test_an_aircraft_on_another_channel_neither_gets_it_nor_is_heard() -> None:
    air = Air()
    air.link.aircraft.channel = 11
    air.agent.step(STEP_NS, Inbox([], []))
    assert air.inject(STEP_NS) is Fate.LOST
    assert not air.hears("rev", STEP_NS)


def test_noise_at_the_attacker_keeps_the_channel_busy() -> None:
    assert Air(jammer_at=(12.0, 0.0, 2.0), noise_dbm=20.0).inject() is Fate.LOST  # given up after 500 time units


# ---------------------------------------------------------------- time on the air


def test_it_takes_airtime_from_the_ends_of_the_link() -> None:
    air = Air()
    sent = sum(air.inject(NS_PER_MS + k * 100 * NS_PER_US) is not Fate.OVERFLOW for k in range(50))
    length = airtime_ns(0, 57 + air.link.overhead_bytes)
    assert air.radio.transmitter.airtime_ns >= sent * length
    air.agent.step(STEP_NS, Inbox([], []))
    assert air.station.occupancy == pytest.approx(0.2 * sent * (length + 10_000 + airtime_ns(0, 14)) / STEP_NS)
    assert air.radio.transmitter.airtime_ns == 0


@pytest.mark.parametrize(("power_dbm", "heard"), [(18.0, False), (36.0, True)])
def test_who_is_heard_depends_on_the_power_of_the_sender(power_dbm: float, heard: bool) -> None:
    air = Air((3000.0, 0.0, 2.0), power_dbm=power_dbm)
    air.inject()
    air.agent.step(STEP_NS, Inbox([], []))
    assert (air.station.occupancy > 0.0) is heard


def test_frames_of_one_radio_follow_each_other_and_its_queue_is_bounded() -> None:
    air = Air()
    arrivals = [air.radio.open(way).carry(0, 57, MIDDLE)[1] for way in ("fwd", "rev", "fwd")]
    length = airtime_ns(0, 57 + air.link.overhead_bytes)
    assert np.diff(arrivals).tolist() == [DIFS_NS + length] * 2
    assert arrivals[0] == DIFS_NS + length + air.link.latency_ns
    fates = [air.inject(0) for _ in range(2 * QUEUE_BYTES // 57)]
    assert fates.count(Fate.OVERFLOW) > QUEUE_BYTES // 57 - 5


def test_it_defers_to_others_as_long_as_they_keep_the_channel_busy() -> None:
    free, busy = Air(), Air()
    busy.radio.transmitter.occupancy = 0.9
    four = (0.5, 0.99, 0.5, 0.5)
    waited = busy.radio.open("fwd").carry(0, 57, four)[1] - free.radio.open("fwd").carry(0, 57, four)[1]
    assert waited == pytest.approx(9 * (28 + 15 * 9) * NS_PER_US, rel=0.01)


# ---------------------------------------------------------------- hearing


def test_it_hears_what_it_decodes_and_can_decrypt() -> None:
    assert Air().hears("fwd")
    assert Air().hears("rev")
    assert not Air((9000.0, 0.0, 2.0)).hears("fwd")
    assert not Air((9000.0, 0.0, 2.0)).hears("rev")
    assert not Air(encrypted=True).hears("fwd")
    assert Air(encrypted=True, has_key=True).hears("fwd")


def test_it_hears_a_frame_that_the_aircraft_does_not_and_none_that_was_not_sent() -> None:
    air = Air(jammer_at=(50.0, 5.0, 20.0), noise_dbm=10.0)
    assert air.link.open("fwd").carry(NS_PER_MS, 57, MIDDLE)[0] is Fate.LOST
    heard = air.radio.hear("fwd", 0.5)
    assert heard is not None
    assert heard > NS_PER_MS
    air.link.associated = False
    assert air.link.open("fwd").carry(NS_PER_S, 57, MIDDLE)[0] is Fate.LOST
    assert air.radio.hear("fwd", 0.5) is None


def test_a_faster_rate_is_heard_less_far() -> None:
    far = (500.0, 0.0, 2.0)
    slow, fast = Air(far), Air(far)
    for air, rate in ((slow, 0), (fast, 7)):
        air.link.to_aircraft.rate = rate
    assert slow.hears()
    assert not fast.hears()
