"""Attacks against DRIP: what receivers that verify make of their frames, byte by byte and without a radio between."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pytest

from skyrange.attack.contract import Aircraft, AttackContext, AttackPlugin
from skyrange.attack.remote_id.suppress_pages import MAX_SENDERS, SuppressPages, carries_manifest, find_period
from skyrange.attack.remote_id.verification_flood import false_signature
from skyrange.codec.drip import encode_sam, session_id, split_with_parity
from skyrange.codec.f3411 import EPOCH_2019_S, BasicId, Location, MessagePack, decode, deviations, encode
from skyrange.codec.remote_id import link_payload, noise_request
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.links import Schedule
from skyrange.contracts.mailboxes import Arrival
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, NS_PER_US, Epoch, Time
from skyrange.radio.phy import OFDM, OVERHEAD_BYTES, airtime_ns
from skyrange.remoteid.broadcast_profiles import sender_address
from skyrange.remoteid.drip.registry import Anchor, Registration, Registry
from skyrange.remoteid.drip.sender import Sender
from skyrange.remoteid.drip.verification.observer import Observer
from skyrange.remoteid.drip.verification.verdicts import Acceptance, Policy, Refusal, Trust, accepts
from tests.unit.test_attack_remote_id import ORIGIN, made, place, sent

pytestmark = pytest.mark.rotating

SUPPRESS_PAGES = AttackPlugin.find("remote_id.suppress_pages")
SIGNED_GHOST = AttackPlugin.find("remote_id.signed_ghost")
VERIFICATION_FLOOD = AttackPlugin.find("remote_id.verification_flood")

S, MS, US = NS_PER_S, NS_PER_MS, NS_PER_US
START_S = 220_000_000
EPOCH = Epoch((EPOCH_2019_S + START_S) * S)
RANGE = Registry.of_seed(3, START_S - 10, START_S + 3600)
UNKNOWN = Registry.of_seed(3, START_S - 10, START_S + 3600, name="unknown registry")
VICTIM = "red/r1"


@dataclass(frozen=True)
class Keys:
    """Keys of one range, of which `VICTIM` signs and nobody else."""

    def registered(self, name: str) -> Registration:
        return RANGE.register(name)

    def unregistered(self, name: str) -> Registration:
        return UNKNOWN.register(name)

    def stolen(self, vehicle: str) -> Registration | None:
        return RANGE.register(vehicle) if vehicle == VICTIM else None


def known_keys(authorities: str) -> Sequence[Anchor]:
    return RANGE.anchors if authorities == "apex" else RANGE.known


def context(sham: bool = False, stop: Time = NEVER) -> AttackContext:
    tag = RANGE.register(VICTIM).identity.tag
    vehicles = {VICTIM: Aircraft((0.0, 0.0, 0.0), session_id(tag)), "blue/b1": Aircraft((9.0, 0.0, 0.0), "BLUE")}
    schedule = Schedule(2 * S, stop)
    return AttackContext(
        "x", vehicles, [], ORIGIN, EPOCH, Chance(3), 60 * S, schedule, sham, keys=Keys(), anchors=known_keys
    )


def bodies(payloads: list[tuple[Time, bytes]]) -> Iterator[tuple[float, RidHeader, bytes]]:
    """Time in seconds since 2019, header and body of each frame; our codec finds nothing wrong with any."""
    for now, payload in payloads:
        header, body = link_payload.unpack(payload)
        message = decode(body)
        assert not isinstance(message, MessagePack) or not deviations(message)
        yield START_S + now / S, header, body


def heard_by(observer: Observer, payloads: list[tuple[Time, bytes]]) -> dict[int, Trust]:
    """The verdicts on each sender after all of these frames."""
    last_s, senders = 0.0, {}
    for now_s, header, body in bodies(payloads):
        address = int.from_bytes(header.address, "big")
        observer.receive(address, header.counter, body, now_s)
        last_s = now_s
        senders[address] = True
    found = {address: observer.track(address, last_s) for address in senders}
    return {address: track.state for address, track in found.items() if track is not None}


@pytest.mark.parametrize("transport", ["wifi_beacon", "bt4", "bt5"])
@pytest.mark.parametrize(
    ("params", "trust"),
    [
        ({"key": "registered"}, Trust.VERIFIED),
        ({"key": "stolen", "vehicle": VICTIM}, Trust.VERIFIED),
        ({"key": "stolen", "vehicle": VICTIM, "address": "vehicle"}, Trust.VERIFIED),
        ({"key": "unregistered"}, Trust.UNVERIFIED),
    ],
    ids=["registered", "stolen", "stolen-address", "unregistered"],
)
def test_a_signed_ghost_is_as_good_as_its_key(params: dict[str, Any], trust: Trust, transport: str) -> None:
    frames = sent(made(SIGNED_GHOST, context(), at=[100, -50, 40], transports=[transport], **params), 16 * S)
    observer = Observer(RANGE.anchors)
    ((address, verdict),) = heard_by(observer, frames).items()
    assert verdict is trust
    assert not observer.counts, "nothing of it is refused"
    assert accepts(Acceptance.IGNORE_UNSIGNED, verdict), "nobody can tell a made-up registry from one out of reach"
    assert accepts(Acceptance.IGNORE_UNVERIFIED, verdict) is (trust is Trust.VERIFIED)
    named = params.get("address") == "vehicle"
    assert address == int.from_bytes(sender_address(VICTIM if named else "x"), "big")
    if params["key"] == "stolen":
        assert observer.addresses_of(RANGE.register(VICTIM).identity.tag) == (address,)
    locations = [part for _, _, body in bodies(frames) for part in parts(body) if isinstance(part, Location)]
    # 1e-7° are 1.1 cm; altitudes come in steps of 0.5 m (F3411-22a, Location/Vector)
    assert place(locations[0]) == pytest.approx((100, -50, 40), abs=0.26)


def parts(body: bytes) -> tuple[object, ...]:
    message = decode(body)
    return message.messages if isinstance(message, MessagePack) else (message,)


def test_the_aircraft_itself_stays_verified_beside_a_ghost_with_its_key() -> None:
    """Both sign now, so neither is a replay of the other; a receiver may notice that one tag has two addresses."""
    frames = sent(made(SIGNED_GHOST, context(), key="stolen", vehicle=VICTIM, at=[9, 9, 30]), 30 * S)
    observer = Observer(RANGE.anchors)
    states = heard_by(observer, sorted([*frames, *genuine(30)]))
    assert list(states.values()) == [Trust.VERIFIED] * 2
    assert len(observer.addresses_of(RANGE.register(VICTIM).identity.tag)) == 2


def genuine(seconds: int, offset: Time = 300 * MS) -> list[tuple[Time, bytes]]:
    """An honest aircraft over Wi-Fi, heard each second, with its signatures 35 ms later."""
    sender, address, found = Sender(RANGE.register(VICTIM), legacy=False), sender_address(VICTIM), []
    for step in range(seconds):
        now = step * S + offset
        body = encode(MessagePack((Location(2, 47.0 + step * 1e-5, 8.0, 100.0, timestamp_s=step),)))
        sender.sent(body)
        found.append((now, link_payload.pack(RidHeader(Transport.WIFI_BEACON, address=address, time_ns=now), body)))
        for turn, kind in enumerate(sender.due((step + 1) * S)):
            at = now + 35 * MS * (turn + 1)
            message = encode_sam(sender.message(kind, step * S, START_S + at / S))
            pages = encode(MessagePack(tuple(split_with_parity(message, START_S + step, parity=False))))
            found.append((at, link_payload.pack(RidHeader(Transport.WIFI_BEACON, address=address, time_ns=at), pages)))
    return found


@pytest.mark.parametrize(
    "params", [{"key": "stolen", "vehicle": VICTIM, "address": "vehicle"}, {"key": "unregistered"}]
)
def test_the_sham_is_an_honest_aircraft_at_the_transmitter(params: dict[str, Any]) -> None:
    params |= {"at": [100, -50, 40], "transmitter_m": [7, 8, 2], "transports": ["wifi_beacon", "bt4"]}
    live, sham = (sent(made(SIGNED_GHOST, context(sham), **params), 20 * S) for sham in (False, True))
    assert [(now, len(payload)) for now, payload in live] == [(now, len(payload)) for now, payload in sham]
    observer = Observer(RANGE.anchors)
    assert heard_by(observer, sham) == {int.from_bytes(sender_address("x"), "big"): Trust.VERIFIED}
    locations = [part for _, _, body in bodies(sham) for part in parts(body) if isinstance(part, Location)]
    assert place(locations[0]) == pytest.approx((7, 8, 0), abs=0.26)


def test_it_claims_a_track_for_the_honest_arm_and_says_what_it_needs() -> None:
    attack = made(SIGNED_GHOST, context(), at=[1, 2, 30], velocity_mps=[1, 0, 0], key="stolen", vehicle=VICTIM)
    (claim,) = attack.claims
    assert (claim.start_enu_m, claim.velocity_mps) == ((1, 2, 30), (1, 0, 0))
    assert claim.uas_id == context().vehicles[VICTIM].uas_id
    assert attack.threat is not None
    assert "private key" in attack.threat.knowledge


@pytest.mark.parametrize(
    ("params", "match"),
    [
        ({"key": "stolen"}, "vehicle"),
        ({"key": "registered", "vehicle": VICTIM}, "vehicle"),
        ({"key": "unregistered", "address": "vehicle"}, "address"),
    ],
)
def test_a_key_and_its_vehicle_go_together(params: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        SIGNED_GHOST.params.model_validate({"at": [0, 0, 30], **params})


def test_a_key_that_nobody_has_cannot_be_stolen() -> None:
    with pytest.raises(InputError, match="auth = "):
        made(SIGNED_GHOST, context(), at=[0, 0, 30], key="stolen", vehicle="blue/b1")
    with pytest.raises(InputError, match="red/r1"):
        made(SIGNED_GHOST, context(), at=[0, 0, 30], key="stolen", vehicle="red/r2")
    with pytest.raises(InputError, match="registry"):
        made(SIGNED_GHOST, replace(context(), keys=None), at=[0, 0, 30])


def flood(seconds: int, sham: bool = False, **params: Any) -> list[tuple[Time, bytes]]:
    return sent(made(VERIFICATION_FLOOD, context(sham), transmitter_m=[0, 0, 2], **params), seconds * S)


@pytest.mark.parametrize("anchors", [RANGE.anchors, RANGE.known], ids=["apex", "all"])
def test_each_link_of_a_flood_costs_a_verification(anchors: Any) -> None:
    frames = flood(4, rate_hz=50)
    observer = Observer(anchors)
    states = heard_by(observer, frames)
    assert observer.work == len(frames) > 50
    assert dict(observer.counts) == {Refusal.WRONG_SIGNATURE: len(frames)}
    assert len(states) == 10
    assert set(states.values()) == {Trust.REFUSED}


def test_the_sham_of_a_flood_costs_one() -> None:
    live, sham = flood(4, rate_hz=50), flood(4, sham=True, rate_hz=50)
    assert [(now, len(payload)) for now, payload in live] == [(now, len(payload)) for now, payload in sham]
    observer = Observer(RANGE.anchors)
    heard_by(observer, sham)
    assert observer.work == 1


@pytest.mark.parametrize(
    ("budget", "flooded", "trust"),
    [(float("inf"), True, Trust.VERIFIED), (10.0, False, Trust.VERIFIED), (10.0, True, Trust.UNVERIFIED)],
)
def test_a_flood_exhausts_the_budget(budget: float, flooded: bool, trust: Trust) -> None:
    frames = [(now + 4 * S, payload) for now, payload in genuine(20)]
    frames = sorted([*frames, *(flood(24, rate_hz=200) if flooded else ())])
    observer = Observer(RANGE.anchors, Policy(verifications_per_s=budget))
    assert heard_by(observer, frames)[int.from_bytes(sender_address(VICTIM), "big")] is trust


def test_many_senders_displace_what_a_receiver_knows_of_others() -> None:
    """64 senders are followed at once: a Location is forgotten before the Manifest that covers it comes."""
    frames = sorted([*genuine(20), *flood(20, rate_hz=200, senders=1000)])
    observer = Observer(RANGE.anchors)
    heard_by(observer, frames)
    assert observer.counts[Refusal.NO_ROOM] > 1000


def test_a_false_signature_is_not_refused_before_the_work() -> None:
    """RFC 8032, section 5.1.7: S has to be below the order of the group."""
    order = 2**252 + 27742317777372353535851937790883648493
    assert int.from_bytes(false_signature(b"\xff" * 64)[32:], "little") < order


def jammer(stop: Time = NEVER, sham: bool = False) -> SuppressPages:
    (agent,) = made(SUPPRESS_PAGES, context(sham, stop), transmitter_m=[0, 0, 2]).agents
    assert isinstance(agent, SuppressPages)
    return agent


def heard(number: int, at: Time, payload: bytes) -> Arrival:
    return Arrival(Port("x.radio", "rid_down:x"), at, payload, "oracle", FrameId("rid_down:x", "rev", "oracle", number))


def hear(payloads: list[tuple[Time, bytes]], delay: Time = 5 * MS) -> tuple[Arrival, ...]:
    """Receptions: a frame that begins at a time is received at its end, and told some ms later."""
    found = []
    for number, (at, payload) in enumerate(payloads):
        header, body = link_payload.unpack(payload)
        length = airtime_ns(OFDM, len(body) + int(OVERHEAD_BYTES[Transport.WIFI_BEACON]))
        ended = at + (length if header.transport == Transport.WIFI_BEACON else 376 * US)
        told = link_payload.pack(header._replace(time_ns=ended, rssi_cdbm=-6000, channel=6), body)
        found.append(heard(number, ended + delay, told))
    return tuple(found)


@dataclass
class OneAgent:
    agents: tuple[SuppressPages, ...]


def bursts(
    agent: SuppressPages, until: Time, mail: tuple[Arrival, ...]
) -> list[tuple[Time, noise_request.NoiseRequest]]:
    found = sent(OneAgent((agent,)), until, mail)  # type: ignore[arg-type]
    return [(now, noise_request.unpack(payload)) for now, payload in found]


def test_manifests_over_wifi_are_covered_and_nothing_else() -> None:
    frames = genuine(60)
    orders = bursts(jammer(), 60 * S, hear(frames[: len([one for one in frames if one[0] < 16 * S])]))
    at = [now for now, _ in orders]
    assert at[0] > 16 * S, "from the fourth Manifest on it knows the period"
    expected = [now for now, payload in frames if now > 16 * S and carries_manifest(link_payload.unpack(payload).body)]
    assert len(expected) == 8
    assert [pytest.approx(now, abs=100 * US) for now in expected] == at
    assert {(one.centre_khz, one.bandwidth_khz, one.duration_us) for _, one in orders} == {(2_437_000, 20_000, 500)}


def test_a_period_is_that_of_all_gaps_together() -> None:
    assert find_period([0, 5 * S, 10 * S]) == 5 * S
    assert find_period([0, 5 * S]) is None
    starts, now = [], 0
    for turn in range(14):
        starts.append(now)
        now += (1000, 950, 1000, 1000, 950)[turn % 5] * MS
    assert find_period(starts) == 4900 * MS
    assert find_period(starts[:4]) is None
    assert find_period([3 * S] * 9) is None, "a period of 0 would never end"
    assert find_period([round(at * S) for at in (0.0, 1.0, 2.3, 4.9, 5.6, 8.1)]) is None


def test_pages_over_bluetooth_are_covered_after_the_first() -> None:
    sender, address = Sender(RANGE.register(VICTIM), legacy=True), sender_address(VICTIM)
    sender.sent(encode(BasicId(1, 2, "A")))
    (pages, *_) = (sender.make(kind, START_S + 3.0) for kind in sender.due(S))
    frames = [
        (3 * S + 35 * MS * turn, link_payload.pack(RidHeader(Transport.BT4, address=address), encode(page)))
        for turn, page in enumerate(pages)
    ]
    location = link_payload.pack(RidHeader(Transport.BT4, address=address), encode(Location(2, 47.0, 8.0, 100.0)))
    assert bursts(jammer(), 5 * S, hear([(2 * S + 500 * MS, location)])) == []
    orders = bursts(jammer(), 5 * S, hear(frames))
    assert sorted(one.centre_khz for _, one in orders) == [2_402_000, 2_426_000, 2_480_000], "one message, one burst"
    (begin, order) = orders[0]
    assert begin < frames[1][0]
    assert begin + order.duration_us * US > frames[-1][0] + 10 * MS


def test_a_jammer_stops_in_time_and_its_sham_is_silent() -> None:
    frames = genuine(16)
    assert bursts(jammer(stop=15 * S), 60 * S, hear(frames)) == []
    shams = bursts(jammer(sham=True), 40 * S, hear(frames))
    assert shams
    assert {one.power_cdbm for _, one in shams} == {-20_000}


def test_a_crowd_of_senders_is_bounded() -> None:
    agent = jammer()
    header, body = next(
        one for _, payload in genuine(1) if carries_manifest((one := link_payload.unpack(payload)).body)
    )
    frames = [
        (number * MS, link_payload.pack(header._replace(address=number.to_bytes(6, "big")), body))
        for number in range(400)
    ]
    bursts(agent, 2 * S, (*hear(frames), heard(0, 2 * S, b"\xff\x00")))
    assert len(agent.manifests.rhythms) == MAX_SENDERS
