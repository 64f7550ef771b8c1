"""Control links over SiK radios: throughput, latency, full buffers, losses, jammers, searching, and what is refused."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.assembly.build import build
from skyrange.contracts.frames import Fate
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.radio.control_link.interference import BurstAtReceiver, Interference
from skyrange.radio.control_link.sik.link import Conditions, SikLink, make_conditions
from skyrange.radio.control_link.sik.modem import bit_error, packet_success, rssi_of, sensitivity_dbm
from skyrange.radio.control_link.sik.params import SikParams
from skyrange.radio.control_link.sik.radio import RECEIVE_BUFFER, SikRadio
from skyrange.radio.control_link.sik.slots import AIRCRAFT, STATION
from skyrange.radio.control_link.sik.updates import SLOTS
from skyrange.scenario import Link, Scenario

CLOSE_DB = -60.0
NO_DRAWS = (0.5, 0.5, 0.5, 0.5)
STEP = 20 * NS_PER_MS


def make_link(seed: int = 1, /, **params: object) -> SikLink:
    model = SikParams.model_validate(params)
    radios = (
        SikRadio("ground", model.power_dbm, model.serial_bps),
        SikRadio("a/1", model.aircraft_dbm, model.serial_bps),
    )
    return SikLink("gcs:a/1", model, model.netid, radios, Chance(seed))


class Flight:
    """A link whose conditions are renewed every 20 ms."""

    def __init__(self, link: SikLink, gain_db: float = CLOSE_DB) -> None:
        self.link = link
        self.gain_db = gain_db
        self.bursts: Mapping[int, list[BurstAtReceiver]] = {}
        self.changes: list[tuple[str, bool]] = []
        self._due = 0

    def go_to(self, now: Time) -> None:
        while self._due <= now:
            noise = (Interference(self.link.noise_dbm[0]), Interference(self.link.noise_dbm[1]))
            for end, bursts in self.bursts.items():
                noise[end].bursts = bursts
            conditions = make_conditions(self.link, self.gain_db, noise)
            present = self.link.slots.number_at(self._due)
            table: dict[int, Conditions] = dict.fromkeys(range(present, present + SLOTS), conditions)
            self.changes += self.link.update(self._due, table)
            self._due += STEP

    def send(self, now: Time, direction: str, size: int) -> tuple[Fate, Time]:
        self.go_to(now)
        fate, arrival, twin = self.link.open(direction).carry(now, size, NO_DRAWS)
        assert twin is None
        return fate, arrival


def saturate(directions: Iterable[str], seconds: int = 10, size: int = 40, **params: object) -> dict[str, float]:
    """Throughput in kbit/s by direction, with as many frames as the serial lines carry."""
    flight = Flight(make_link(1, **params))
    gap = size * 10 * NS_PER_S // flight.link.params.serial_bps
    arrived = dict.fromkeys(directions, 0)
    for now in range(0, seconds * NS_PER_S, gap):
        for direction in arrived:
            arrived[direction] += flight.send(now, direction, size)[0] is Fate.DELIVERED
    return {direction: count * size * 8 / seconds / 1e3 for direction, count in arrived.items()}


# ---------------------------------------------------------------- throughput and latency


def test_one_direction_has_about_90_percent_of_the_air_rate_and_half_with_error_correction() -> None:
    """ArduPilot wiki, "Choosing the air data rate": "around 90% of the AIR_SPEED", "halved" with ECC."""
    plain = saturate(["rev"], air_speed_kbps=64, serial_bps=115_200)["rev"]
    coded = saturate(["rev"], air_speed_kbps=64, serial_bps=115_200, ecc=True)["rev"]
    assert 0.8 * 64 < plain < 0.95 * 64
    assert 0.35 * plain < coded < 0.5 * plain


def test_the_serial_line_bounds_a_fast_radio() -> None:
    assert saturate(["rev"], air_speed_kbps=250)["rev"] == pytest.approx(57.6 * 0.8, rel=0.02)


def test_two_busy_radios_share_the_air_equally() -> None:
    both = saturate(["fwd", "rev"], air_speed_kbps=64, serial_bps=115_200)
    assert both["fwd"] == pytest.approx(both["rev"], rel=0.03)
    alone = saturate(["rev"], air_speed_kbps=64, serial_bps=115_200)["rev"]
    assert 0.9 * alone < sum(both.values()) < 1.05 * alone


@pytest.mark.parametrize("percent", [10, 40])
def test_a_duty_cycle_bounds_the_throughput(percent: int) -> None:
    """Without bound a radio whose other one is idle sends nearly all the time."""
    free, bound = (
        saturate(["rev"], seconds=20, air_speed_kbps=128, ecc=True, serial_bps=115_200, duty_percent=most)["rev"]
        for most in (100, percent)
    )
    assert 0.9 * percent < 100 * bound / free < 1.5 * percent


def test_an_idle_radio_waits_for_the_next_window() -> None:
    """A frame that comes just after both gave up a window waits for the next: at most slot, packet and both lines."""
    flight = Flight(make_link())
    slot_ns = flight.link.slots.timing.slot_ns
    delays = []
    for k in range(200):
        now = k * 317 * NS_PER_MS + k * 12_345
        fate, arrival = flight.send(now, "fwd" if k % 2 else "rev", 30)
        assert fate is Fate.DELIVERED
        delays.append(arrival - now)
    lines = 2 * 30 * 10 * NS_PER_S // 57_600
    assert max(delays) < lines + slot_ns + 20 * NS_PER_MS
    assert min(delays) > lines
    assert sum(delays) / len(delays) == pytest.approx(0.5 * slot_ns + lines, rel=0.25)


def test_frames_share_a_packet_and_are_not_divided() -> None:
    """Frames of one packet arrive one behind the other at the speed of the serial line."""
    flight = Flight(make_link())
    now = 3 * flight.link.slots.timing.slot_ns - 40 * NS_PER_MS  # behind what the aircraft has given up
    arrivals = [flight.send(now, "fwd", 50)[1] for _ in range(4)]
    line_ns = 50 * flight.link.radios[AIRCRAFT].byte_ns
    for earlier, later in pairwise(arrivals):
        assert line_ns <= later - earlier < line_ns + 8 * 50 * NS_PER_S // 64_000 + NS_PER_MS


def test_a_frame_that_is_too_long_for_a_packet_is_sent_in_parts() -> None:
    link = make_link(ecc=True)
    assert link.keeps_whole(118 - 13)
    assert not link.keeps_whole(118 - 12)
    fate, arrival = Flight(link).send(0, "fwd", 280)
    assert fate is Fate.DELIVERED
    assert arrival > 3 * link.slots.airtime_ns(93)
    assert not make_link(mavlink=False).keeps_whole(10)


@settings(max_examples=25)
@given(
    st.lists(st.tuples(st.integers(0, 200), st.booleans(), st.integers(8, 280)), min_size=1, max_size=60),
    st.sampled_from([(64, False), (64, True), (250, False), (16, True)]),
    st.floats(-135, -60),
)
def test_frames_arrive_in_order_and_not_before_they_can(
    frames: list[tuple[int, bool, int]], rate: tuple[int, bool], gain_db: float
) -> None:
    flight = Flight(make_link(air_speed_kbps=rate[0], ecc=rate[1]), gain_db)
    now, last = 0, {"fwd": 0, "rev": 0}
    for wait_ms, up, size in frames:
        now += wait_ms * NS_PER_MS
        direction = "rev" if up else "fwd"
        fate, arrival = flight.send(now, direction, size)
        if fate is Fate.DELIVERED:
            assert arrival > now + 2 * size * 10 * NS_PER_S // 57_600
            assert arrival > last[direction]
            last[direction] = arrival


# ---------------------------------------------------------------- buffers


def test_a_full_buffer_drops_frames_and_tells_so() -> None:
    flight = Flight(make_link(air_speed_kbps=4))
    fates, least = [], 100
    for k in range(400):
        now = k * 10 * NS_PER_MS
        fates.append(flight.send(now, "rev", 40)[0])
        least = min(least, flight.link.report(AIRCRAFT, now).free_percent)
    assert Fate.OVERFLOW in fates
    first = fates.index(Fate.OVERFLOW)
    assert first >= RECEIVE_BUFFER // 40
    assert least <= 2
    assert flight.link.report(STATION, now).free_percent == 100
    later = now + 60 * NS_PER_S
    flight.go_to(later)
    assert flight.link.report(AIRCRAFT, later).free_percent == 100


def test_a_full_queue_of_the_computer_drops_frames() -> None:
    flight = Flight(make_link(queue_bytes=200))
    fates = [flight.send(NS_PER_S, "fwd", 50)[0] for _ in range(6)]
    assert fates == [Fate.DELIVERED] * 4 + [Fate.OVERFLOW] * 2


# ---------------------------------------------------------------- losses


@pytest.mark.parametrize("ecc", [False, True])
def test_losses_are_those_of_packets(ecc: bool) -> None:
    link = make_link(ecc=ecc)
    level = -109.5 if ecc else -105.0
    flight = Flight(link, level - link.params.power_dbm)
    frames = 1500
    lost = sum(flight.send(k * 300 * NS_PER_MS, "fwd", 60)[0] is Fate.LOST for k in range(frames))
    noise = link.noise_dbm[AIRCRAFT]
    error = bit_error(10 ** (0.1 * (level - noise)) * link.width_mhz * 1e3 / 64)
    expected = 1.0 - packet_success(error, 60, ecc=ecc)
    assert 0.05 < expected < 0.95
    assert lost / frames == pytest.approx(expected, abs=4.0 * (expected * (1 - expected) / frames) ** 0.5)


def test_error_correction_reaches_farther_and_counts_what_it_corrects() -> None:
    level = sensitivity_dbm(64) - 1.5
    outcomes = {}
    for ecc in (False, True):
        flight = Flight(make_link(ecc=ecc), level - 20)
        fates = [flight.send(k * 300 * NS_PER_MS, "rev", 60)[0] for k in range(200)]
        outcomes[ecc] = fates.count(Fate.DELIVERED)
        report = flight.link.report(STATION, 60 * NS_PER_S)
        assert report.receive_errors > 0
        assert (report.corrected_packets > 0) == ecc
    assert outcomes[True] > 2 * outcomes[False]


def test_a_jammer_on_the_frequencies_takes_the_packets_of_its_time() -> None:
    flight = Flight(make_link())
    flight.bursts = {AIRCRAFT: [BurstAtReceiver(5 * NS_PER_S, 10 * NS_PER_S, 0, 1e-4, -200.0)]}  # -40 dBm, as strong
    fates = {}
    for k in range(150):
        now = k * 100 * NS_PER_MS
        fates[now] = flight.send(now, "fwd", 30)[0], flight.send(now, "rev", 30)[0]
    jammed = [pair for now, pair in fates.items() if 5 * NS_PER_S <= now < 9.5 * NS_PER_S]
    others = [pair for now, pair in fates.items() if now < 4.5 * NS_PER_S or now > 10.5 * NS_PER_S]
    assert {fwd for fwd, _ in jammed} == {Fate.LOST}
    assert {rev for _, rev in jammed} == {Fate.DELIVERED}
    assert {fate for pair in others for fate in pair} == {Fate.DELIVERED}
    assert flight.link.report(AIRCRAFT, 15 * NS_PER_S).noise < rssi_of(-100)


# ---------------------------------------------------------------- what radios know


def test_radios_report_signal_and_noise_of_both_ends() -> None:
    link = make_link(power_dbm=20, aircraft_dbm=10, station_noise_rise_db=12)
    flight = Flight(link, -90.0)
    flight.go_to(30 * NS_PER_S)
    ground, air = (link.report(end, 30 * NS_PER_S) for end in (STATION, AIRCRAFT))
    assert 0 <= rssi_of(-80) - ground.rssi <= 7  # the firmware's average sticks up to 7 below: (x + 7·avg)/8 truncated
    assert 0 <= rssi_of(-70) - air.rssi <= 7
    assert 0 <= rssi_of(link.noise_dbm[STATION]) - ground.noise <= 3
    assert 0 <= rssi_of(link.noise_dbm[AIRCRAFT]) - air.noise <= 3
    assert ground.noise - air.noise == pytest.approx(12 * 1.9, abs=3)
    assert (ground.remote_rssi, ground.remote_noise) == (air.rssi, air.noise)
    assert (air.remote_rssi, air.remote_noise) == (ground.rssi, ground.noise)


def test_a_lost_link_is_searched_after_20_s_and_found_within_a_round_of_frequencies() -> None:
    """`link_update`: what the other told is forgotten after six half seconds, the lock after 41."""
    flight = Flight(make_link())
    flight.go_to(10 * NS_PER_S)
    flight.gain_db = -300.0
    flight.go_to(12 * NS_PER_S)
    assert flight.link.report(STATION, 12 * NS_PER_S).remote_rssi > 0
    flight.go_to(15 * NS_PER_S)
    assert flight.link.report(STATION, 15 * NS_PER_S).remote_rssi == 0
    assert flight.changes == []
    flight.go_to(32 * NS_PER_S)
    assert flight.changes == [("ground", False), ("a/1", False)]
    flight.gain_db = CLOSE_DB
    all_frequencies = 50 * flight.link.slots.timing.slot_ns
    flight.go_to(32 * NS_PER_S + 2 * all_frequencies + NS_PER_S)
    assert sorted(flight.changes[2:]) == [("a/1", True), ("ground", True)]
    assert flight.send(50 * NS_PER_S, "fwd", 30)[0] is Fate.DELIVERED


# ---------------------------------------------------------------- determinism


def test_a_copy_continues_as_the_link_does() -> None:
    flight = Flight(make_link(), sensitivity_dbm(64) + 1.0 - 20)
    for k in range(40):
        flight.send(k * 50 * NS_PER_MS, "rev", 45)
    twin = copy.deepcopy(flight)
    again = [
        [one.send(2 * NS_PER_S + k * 40 * NS_PER_MS, "fwd" if k % 3 else "rev", 45) for k in range(60)]
        for one in (flight, twin)
    ]
    assert again[0] == again[1]
    assert {fate for fate, _ in again[0]} == {Fate.DELIVERED, Fate.LOST}


def test_more_frames_do_not_change_the_luck_of_others() -> None:
    """A packet's draw is addressed by its sender and time: frames in packets of the same times meet the same draws."""
    level = sensitivity_dbm(64) - 0.5 - 20
    fates = []
    for extra in (False, True):
        flight = Flight(make_link(), level)
        alone = []
        for k in range(150):
            now = k * 2 * flight.link.slots.timing.slot_ns
            alone.append(flight.send(now, "rev", 40)[0])
            if extra and k % 10 == 0:
                flight.send(now + NS_PER_MS, "fwd", 40)
        fates.append(alone)
    same = sum(one is other for one, other in zip(*fates, strict=True))
    assert same >= 0.9 * len(fates[0])


# ---------------------------------------------------------------- what is refused

HEAD = 'name = "x"\nduration_s = 5\norigin = [40.0, -73.0]\n'
FLEET = (
    '[[operators]]\nid = "blue"\n[[operators.vehicles]]\nid = "b1"\nplan = { square = { side_m = 20, alt_m = 10 } }\n'
)


@pytest.mark.parametrize(
    ("params", "text"),
    [
        ("air_speed_kbps = 57", "one of 4, 8, 16"),
        ("air_speed_kbps = 2", "data fit into a window"),
        ("air_speed_kbps = 64, max_window_ms = 3", "longer max_window_ms"),
        ("serial_bps = 56000", "57600"),
        ("min_khz = 500000, max_khz = 510000", "414000 to 460000"),
        ("min_khz = 928000, max_khz = 915000", "868000 to 935000"),
        ("min_khz = 445000, max_khz = 470000", "a band within"),
        ("channels = 51", "50"),
        ("channels = 1", "as many that their distance"),
        ("power_dbm = 31", "30"),
        ("power_dbm = -1", "0"),
        ('ecc = "yes"', "true or false"),
        ("netid = 65536", "65535"),
        ("opp_resend = true", "opp_resend"),
    ],
)
def test_wrong_parameters_are_refused(params: str, text: str) -> None:
    with pytest.raises(InputError) as error:
        Scenario.from_toml(f'{HEAD}[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "sik"\nsik = {{ {params} }}\n{FLEET}')
    assert text in str(error.value)


@pytest.mark.parametrize(
    ("tables", "text"),
    [
        ('[[links]]\nmatch = "gcs:*"\nchannel = "sik"\n', "a radio medium"),
        ('[radio]\n[[links]]\nmatch = "log:*"\nchannel = "sik"\n', "a gcs link"),
        ('[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "sik"\nsik = { place = [0, 0, -3] }\n', "sik.place"),
        (
            '[radio]\n[[links]]\nmatch = "gcs:*"\nchannel = "sik"\n[[attacks]]\nid = "x"\nkind = "mavlink.command"\n'
            'start_s = 1\n[attacks.params]\nvehicles = ["blue/b1"]\ncommand = "NAV_LAND"\nplace = "air"\n'
            "radio_m = [6, 2, 2]\n",
            "follows the frequencies",
        ),
    ],
)
def test_what_cannot_be_is_refused(tables: str, text: str) -> None:
    with pytest.raises(InputError) as error:
        build(Scenario.from_toml(HEAD + tables + FLEET))
    assert text in str(error.value)


def test_aircraft_of_a_rule_have_network_ids_of_their_own() -> None:
    fleet = (
        FLEET + '[[operators.vehicles]]\nid = "b2"\nstart = [5, 0]\nplan = { square = { side_m = 20, alt_m = 12 } }\n'
    )
    text = HEAD + "[radio]\n" + fleet
    scenario = Scenario.from_toml(text).model_copy(update={"links": (Link(match="gcs:*", channel="sik"),)})
    channels = {spec.name: spec.channel for spec in build(scenario).wiring.links}
    links = [channels["gcs:blue/b1"], channels["gcs:blue/b2"]]
    assert [link.netid for link in links if isinstance(link, SikLink)] == [25, 26]
    rules = tuple(
        Link(match=f"gcs:blue/{name}", channel="sik", sik=SikParams(netid=7, power_dbm=power))
        for name, power in (("b1", 20), ("b2", 10))
    )
    with pytest.raises(InputError, match=r"gcs:blue/b2.netid: 7, as gcs:blue/b1"):
        build(scenario.model_copy(update={"links": rules}))
