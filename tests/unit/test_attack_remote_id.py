"""What do the Remote ID attacks send? Their frames, decoded, against what was asked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from skyrange.attack.bases.transmission import SILENT_CDBM
from skyrange.attack.contract import Aircraft, Attack, AttackContext, AttackPlugin
from skyrange.codec.f3411 import BasicId, Location, MessagePack, Status, decode, deviations, is_serial_number
from skyrange.codec.remote_id import link_payload, noise_request
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.links import Schedule
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.contracts.verdicts import Inject
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time

JAM = AttackPlugin.find("remote_id.jam")
SPOOF = AttackPlugin.find("remote_id.spoof")
REPLAY = AttackPlugin.find("remote_id.replay")

S, MS = NS_PER_S, NS_PER_MS
ORIGIN = Origin(40.778, -73.955, 25.0, -32.0)
RED = "1581F5FKD229400000RR"


def context(start: Time = 2 * S, stop: Time = 6 * S, sham: bool = False) -> AttackContext:
    vehicles = {"red/r1": Aircraft((0.0, 0.0, 0.0), RED)}
    epoch = Epoch(1_767_268_800 * S)  # 2026-01-01T12:00:00Z, a full hour
    links = ["rid_up:red/r1", "gcs:red/r1"]
    return AttackContext("x", vehicles, links, ORIGIN, epoch, Chance(3), 10 * S, Schedule(start, stop), sham)


def made(kind: AttackPlugin, where: AttackContext, **params: Any) -> Attack:
    return kind(kind.params.model_validate(params), where)


def sent(attack: Attack, until: Time, mail: tuple[Arrival, ...] = ()) -> list[tuple[Time, bytes]]:
    """What the only agent sends, stepped when it asks and when there is mail."""
    (agent,) = attack.agents
    out: list[tuple[Time, bytes]] = []
    now, waiting = -1, list(mail)
    while True:
        wishes = [wish for wish in (agent.next_wakeup(), waiting[0].at if waiting else None) if wish is not None]
        if not wishes or min(wishes) > until:
            return out
        now = max(min(wishes), now + 1)
        box = [waiting.pop(0) for _ in range(sum(arrival.at <= now for arrival in waiting))]
        out += [(now, departure.payload) for departure in agent.step(now, Inbox(box)).departures]


def opened(payload: bytes) -> tuple[RidHeader, BasicId, Location]:
    header, body = link_payload.unpack(payload)
    pack = decode(body)
    assert isinstance(pack, MessagePack)
    assert not deviations(pack), "well-formed, as an honest transmitter's"
    basic, location = pack.messages[:2]
    assert isinstance(basic, BasicId)
    assert isinstance(location, Location)
    return header, basic, location


def place(location: Location) -> tuple[float, float, float]:
    assert location.lat_deg is not None
    assert location.lon_deg is not None
    assert location.alt_geo_m is not None
    east_m, north_m = ORIGIN.enu_of(location.lat_deg, location.lon_deg)
    return east_m, north_m, location.alt_geo_m - (25.0 - 32.0)


def test_a_ghost_says_what_was_asked_once_a_second_while_it_acts() -> None:
    frames = sent(made(SPOOF, context(), at=[100, -50, 40]), 10 * S)
    assert [now for now, _ in frames] == [k * S for k in range(2, 11)]  # the kernel discards what is after the stop
    for now, payload in frames:
        header, basic, location = opened(payload)
        assert header.transport == Transport.WIFI_BEACON
        assert header.time_ns == now
        assert is_serial_number(basic.uas_id)
        # 1e-7° are 1.1 cm; altitudes come in steps of 0.5 m (F3411-22a, Location/Vector)
        assert place(location) == pytest.approx((100, -50, 40), abs=0.26)
        assert (location.status, location.speed_mps) == (Status.AIRBORNE, 0.0)
        assert location.timestamp_s == pytest.approx(now / S, abs=0.05)
    assert [link_payload.unpack(payload).header.counter for _, payload in frames] == list(range(9))


def test_it_moves_from_its_start_on() -> None:
    frames = sent(made(SPOOF, context(), at=[0, 0, 30], velocity_mps=[3, 4, -1]), 5 * S)
    _, _, location = opened(frames[-1][1])
    assert place(location) == pytest.approx((9, 12, 27), abs=0.26)
    # speed in steps of 0.25 m/s, vertical of 0.5 m/s, whole degrees
    assert (location.speed_mps, location.vertical_mps, location.track_deg) == (5.0, -1.0, 37)


def test_a_trigger_that_never_fired_leaves_it_silent() -> None:
    assert sent(made(SPOOF, replace(context(), schedule=Schedule()), at=[0, 0, 30]), 5 * S) == []


def test_a_false_position_has_the_victims_identity_and_a_sham_has_not() -> None:
    params = {"form": "position", "vehicle": "red/r1", "at": [5, 5, 30], "transmitter_m": [70, 0, 3]}
    live, sham = (sent(made(SPOOF, context(sham=sham), **params), 5 * S) for sham in (False, True))
    assert opened(live[0][1])[1].uas_id == RED
    _, basic, location = opened(sham[0][1])
    assert basic.uas_id != RED
    assert place(location) == pytest.approx((70, 0, 0), abs=0.26)
    assert location.status == Status.GROUND
    assert [(now, len(payload)) for now, payload in live] == [(now, len(payload)) for now, payload in sham]


def test_a_swarm_is_many_within_its_radius_spread_over_the_second() -> None:
    attack = made(SPOOF, context(), form="swarm", count=40, radius_m=80, at=[10, 20, 50])
    first = [(now, opened(payload)) for now, payload in sent(attack, 3 * S) if now < 3 * S]
    assert len(first) == 40
    assert len({basic.uas_id for _, (_, basic, _) in first}) == len({h.address for _, (h, _, _) in first}) == 40
    assert all(h.address[0] & 0xC3 == 0xC2 for _, (h, _, _) in first), "locally administered, unicast; random static"
    places = np.array([place(location) for _, (_, _, location) in first])
    away = np.hypot(places[:, 0] - 10, places[:, 1] - 20)
    assert away.max() <= 80.5
    # uniform over the disk: mean distance 2/3 of the radius, standard error of 40 samples 3 m, three of those
    assert away.mean() == pytest.approx(80 * 2 / 3, abs=9)
    assert np.diff([now for now, _ in first]).max() <= S // 40 + 1


def test_bluetooth_4_carries_one_message_an_advertisement() -> None:
    frames = sent(made(SPOOF, context(), at=[0, 0, 30], transports=["bt4", "bt5"]), 2 * S)
    bodies = [
        (link_payload.unpack(payload).header.transport, link_payload.unpack(payload).body) for _, payload in frames
    ]
    assert [(transport, len(body)) for transport, body in bodies] == [(1, 25), (1, 25), (2, 78)]
    assert isinstance(decode(bodies[0][1]), BasicId)
    assert isinstance(decode(bodies[1][1]), Location)


def test_by_link_it_is_injected_as_the_companions_own() -> None:
    attack = made(SPOOF, context(), at=[1, 2, 30], via="link", on="red/r1")
    assert (attack.agents, attack.radios, attack.links) == ((), (), ())
    (placement,) = attack.taps
    tap = placement.make(placement.match)
    assert (placement.match, placement.side) == ("rid_up:red/r1", "companion")
    assert tap.on_wakeup(2 * S)
    (verdict,) = tap.on_wakeup(3 * S)
    assert isinstance(verdict, Inject)
    assert (verdict.direction, verdict.src, verdict.dst) == ("fwd", "red/r1.companion", "oracle")
    assert place(opened(verdict.payload)[2]) == pytest.approx((1, 2, 30), abs=0.26)
    with pytest.raises(InputError, match="rid_up:red/r1"):
        made(SPOOF, replace(context(), links=["gcs:red/r1"]), at=[1, 2, 30], via="link", on="red/r1")


def heard(*payloads: bytes) -> tuple[Arrival, ...]:
    port = Port("x.radio", "rid_down:x")
    return tuple(
        Arrival(port, (k + 1) * S, payload, "oracle", FrameId("rid_down:x", "fwd", "oracle", k))
        for k, payload in enumerate(payloads)
    )


def test_replay_sends_what_it_heard_later_and_says_why() -> None:
    frames = [payload for _, payload in sent(made(SPOOF, context(), at=[0, 0, 30], transports=["bt4", "bt5"]), 2 * S)]
    strong = [
        link_payload.pack(RidHeader(t.header.transport, 6, 9, b"abcdef", -7000, 5), t.body)
        for t in map(link_payload.unpack, frames)
    ]
    attack = made(REPLAY, context(), transmitter_m=[0, 0, 2], delay_s=1.5)
    again = sent(attack, 9 * S, heard(b"", strong[0], b"\x1d" * 40, *strong[1:]))
    assert [now for now, _ in again] == [3_500_000_000, 5_500_000_000, 6_500_000_000]
    for (now, payload), before in zip(again, strong, strict=True):
        header, body = link_payload.unpack(payload)
        assert body == link_payload.unpack(before).body
        assert (header.address, header.counter, header.time_ns) == (b"abcdef", 9, now)
        assert (header.channel, header.rssi_cdbm) == (link_payload.ANY_CHANNEL, link_payload.NO_RSSI)
    sham = sent(made(REPLAY, context(sham=True), transmitter_m=[7, 0, 2], delay_s=1.5), 9 * S, heard(*strong))
    assert [len(payload) for _, payload in sham] == [len(payload) for payload in strong]
    for _, payload in sham:
        header, body = link_payload.unpack(payload)
        message = decode(body)
        location = message.messages[0] if isinstance(message, MessagePack) else message
        assert isinstance(location, Location)
        assert place(location) == pytest.approx((7, 0, 2), abs=0.26)
        assert header.address != b"abcdef"


def test_replay_names_what_it_repeats_as_cause() -> None:
    payload = link_payload.pack(RidHeader(2), b"\x00" * 25)
    (agent,) = made(REPLAY, context(), transmitter_m=[0, 0, 2], delay_s=1).agents
    (mail,) = heard(payload)
    agent.step(S, Inbox([mail]))
    (departure,) = agent.step(2 * S, Inbox()).departures
    assert departure.causes == (mail.ref,)


def test_a_jammer_orders_bursts_that_end_with_it() -> None:
    where = context(start=1 * S, stop=1_250 * MS)
    attack = made(JAM, where, transmitter_m=[0, 0, 2], power_dbm=33, centre_mhz=2402, bandwidth_mhz=2, duty=0.6)
    bursts = [(now, noise_request.unpack(payload)) for now, payload in sent(attack, 3 * S)]
    assert [(now, burst.duration_us) for now, burst in bursts] == [
        (1_000 * MS, 60_000), (1_100 * MS, 60_000), (1_200 * MS, 50_000),
    ]  # fmt: skip
    assert {burst[:3] for _, burst in bursts} == {(3300, 2_402_000, 2_000)}
    sham = sent(made(JAM, context(start=1 * S, stop=1_250 * MS, sham=True), transmitter_m=[0, 0, 2]), 3 * S)
    assert {noise_request.unpack(payload).power_cdbm for _, payload in sham} == {SILENT_CDBM}


def test_bursts_survive_any_bytes() -> None:
    whole = noise_request.pack(noise_request.NoiseRequest(-100, 2_437_000, 20_000, 100_000, -5))
    assert noise_request.unpack(whole) == (-100, 2_437_000, 20_000, 100_000, -5, 0, b"", 0)
    reactive = noise_request.NoiseRequest(-100, 2_437_000, 20_000, 100_000, -5, 15)
    following = reactive._replace(bssid=b"\x02access"[:6], follow_ms=1300)
    for each in (reactive, following):
        assert noise_request.unpack(noise_request.pack(each)) == each
    for size in range(len(whole)):
        with pytest.raises(DecodeError):
            noise_request.unpack(whole[:size])
    for wrong in (whole + b"\0", b"\x1d" + whole[1:], whole[:8] + bytes(4) + whole[12:]):
        with pytest.raises(DecodeError):
            noise_request.unpack(wrong)
    for burst in (
        noise_request.NoiseRequest(40_000, 1, 1, 1),
        noise_request.NoiseRequest(0, 1, 0, 1),
        noise_request.NoiseRequest(0, -1, 1, 1),
    ):
        with pytest.raises(ValueError, match=r"expected|NoiseRequest"):
            noise_request.pack(burst)
