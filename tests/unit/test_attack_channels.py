"""What do flood and sweeping jammer put on the air?"""

from __future__ import annotations

from itertools import pairwise

import pytest

from skyrange.attack.bases.transmission import SILENT_CDBM
from skyrange.attack.contract import AttackPlugin
from skyrange.codec.f3411 import BasicId, Location, MessagePack, SelfId, Status, decode, is_serial_number
from skyrange.codec.remote_id import link_payload, noise_request
from skyrange.codec.remote_id.link_payload import Transport
from tests.unit.test_attack_remote_id import MS, S, context, made, place, sent

SWEEP_JAM = AttackPlugin.find("remote_id.sweep_jam")
FLOOD = AttackPlugin.find("remote_id.flood")


def test_a_flood_sends_harmless_beacons_at_its_rate_on_its_channel() -> None:
    frames = sent(made(FLOOD, context(), transmitter_m=[30, 40, 5], stations=1, rate_hz=400, channel=11), 3 * S - 1)
    assert len(frames) == 400
    assert frames[0][0] == 2 * S
    header, body = link_payload.unpack(frames[7][1])
    assert (header.transport, header.channel, len(body)) == (Transport.WIFI_BEACON, 11, 3 + 9 * 25)
    pack = decode(body)
    assert isinstance(pack, MessagePack)
    location, basic, *rest = pack.messages
    assert isinstance(location, Location)
    assert isinstance(basic, BasicId)
    assert location.status == Status.GROUND
    assert place(location) == pytest.approx((30, 40, 5), abs=0.26)
    assert is_serial_number(basic.uas_id)
    assert all(isinstance(one, SelfId) for one in rest)


def test_its_sham_is_the_flood_itself() -> None:
    live, sham = (
        sent(made(FLOOD, context(sham=sham), transmitter_m=[30, 40, 5], stations=1, rate_hz=50), 4 * S)
        for sham in (False, True)
    )
    assert live == sham


def test_a_sweep_visits_its_channels_in_turn() -> None:
    jam = made(SWEEP_JAM, context(), transmitter_m=[0, 0, 5], centres_mhz=[2402, 2437, 2480], dwell_ms=20)
    bursts = [(now, noise_request.unpack(payload)) for now, payload in sent(jam, 10 * S)]
    assert len(bursts) == 4 * 50
    assert [now for now, _ in bursts[:3]] == [2 * S, 2 * S + 20 * MS, 2 * S + 40 * MS]
    centres = [burst.centre_khz for _, burst in bursts]
    assert {centres.count(centre) // 10 for centre in (2_402_000, 2_437_000, 2_480_000)} == {6}
    assert all(first != then for first, then in pairwise(centres))
    assert {burst.duration_us for _, burst in bursts} == {20_000}


def test_its_last_burst_ends_with_it_and_its_sham_is_silent() -> None:
    context_ = context(stop=2 * S + 30 * MS)
    last = noise_request.unpack(sent(made(SWEEP_JAM, context_, transmitter_m=[0, 0, 5], dwell_ms=20), 3 * S)[-1][1])
    assert last.duration_us == 10_000
    sham = sent(made(SWEEP_JAM, context(sham=True), transmitter_m=[0, 0, 5]), 3 * S)
    assert {noise_request.unpack(payload).power_cdbm for _, payload in sham} == {SILENT_CDBM}
