"""How often each Remote ID message is on the air, for every profile, transport and rate of authentication.

The tables are those of the standards: 14 CFR 89.310(h)(3), every element each second; F3411-22a, dynamic messages each
second and static ones every three; RFC 9575, section 6.3, the longest times between authentication messages, and
section 6.4 with appendix B.2, the recommended ones over Bluetooth 4.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise, product
from typing import NamedTuple

import pytest

from skyrange.codec.drip import Evidence, Link, decode_manifest, decode_sam, session_id
from skyrange.codec.drip.messages import join_with_parity
from skyrange.codec.f3411 import (
    EPOCH_2019_S,
    Authentication,
    BasicId,
    IdType,
    Location,
    MessagePack,
    OperatorId,
    SelfId,
    System,
    decode,
)
from skyrange.codec.remote_id.link_payload import RidFrame, unpack
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.remoteid.broadcast_profiles import TRANSPORTS, US_PERIOD_NS, Broadcast, broadcast_cycle
from skyrange.remoteid.drip.registry import Registry
from skyrange.remoteid.drip.sender import PAGE_NS, RECOMMENDED, REQUIRED, Credentials, Rates
from tests.unit.test_remoteid_broadcaster import UTC_US, Aircraft, beat, position

pytestmark = pytest.mark.rotating

FLOWN_S = 66
"""Longer than any period of the tables but the five minutes of section 6.3."""
CARRIED = ("bt4",), ("bluetooth",), ("wifi_beacon",), ("wifi_beacon", "wifi_nan", "bluetooth")
MANIFEST, OWN_LINK, HDA_LINK, RAA_LINK = "manifest", "link: HDA on UA", "link: RAA on HDA", "link: apex on RAA"
SIGNED_S: dict[Rates, dict[str, int]] = {
    REQUIRED: {MANIFEST: 5, OWN_LINK: 60, HDA_LINK: 300, RAA_LINK: 300},  # RFC 9575, section 6.3, 4 to 1
    RECOMMENDED: {MANIFEST: 1, OWN_LINK: 16, HDA_LINK: 32, RAA_LINK: 64},  # section 6.4; order of Links in appendix B.2
}
FULL = 10
"""Hashes that a Manifest should have at most (RFC 9575, section 4.4). A Manifest with as many may come early."""
ORDINARY_S: dict[str, dict[type, int]] = {
    "us": {Location: 1, BasicId: 1, System: 1, OperatorId: 1, SelfId: 1},
    "astm": {Location: 1, BasicId: 3, System: 3, OperatorId: 3, SelfId: 3},
}
LONGEST_PAGES = 11
"""Of a Manifest over Bluetooth 4, with parity."""
POLL_NS = 10 * NS_PER_MS
"""How late a companion may ask what is due."""
START_S = UTC_US // 1_000_000 - EPOCH_2019_S
REGISTRY = Registry.of_seed(3, START_S - 10, START_S + 3600)


class Signed(NamedTuple):
    """An authentication message on the air."""

    kind: str
    at_ns: Time
    """Of its first frame."""
    hashes: int
    """Of messages, in a Manifest."""


def fleet() -> list[Broadcast]:
    """One aircraft for each profile, set of transports and rates; every other one sends the messages that may be left
    out.
    """
    found = []
    for place, (profile, transports, rates) in enumerate(product(ORDINARY_S, CARRIED, SIGNED_S)):
        long = (place + place // len(SIGNED_S) + place // 8) % 2 == 0
        registration = REGISTRY.register(f"blue/b{place}")
        found.append(
            Broadcast(
                f"blue/b{place}",
                session_id(registration.identity.tag),
                IdType.SPECIFIC_SESSION,
                profile=profile,
                transports=transports,
                operator_id="OP" if long else "",
                text="survey" if long else "",
                credentials=Credentials(registration, rates),
            )
        )
    return found


def test_every_message_is_as_frequent_as_its_standard_says() -> None:
    broadcasts = fleet()
    aircraft, heard = Aircraft(*broadcasts), [list[RidFrame]() for _ in broadcasts]
    for now in range(0, FLOWN_S * NS_PER_S, POLL_NS):
        if now % NS_PER_S == 0:
            tell(aircraft, now)
        due = aircraft.broadcaster.next_due()
        out = aircraft.broadcaster.send(now, aircraft.beliefs) if due is not None and due <= now else None
        if out is not None:
            for place, payload in zip(out[0].tolist(), out[1], strict=True):
                heard[place].append(unpack(payload))
    for broadcast, frames in zip(broadcasts, heard, strict=True):
        check_ordinary(broadcast, frames)
        check_signed(broadcast, frames)


def tell(aircraft: Aircraft, now: Time) -> None:
    """What the autopilots report in a second."""
    for place in range(len(aircraft.packers)):
        if now == 0:
            aircraft.all_is_well(now, place)
        else:
            aircraft.tell(now, beat(), position(now, lat=407_780_000 + now // NS_PER_S), place=place)


def check_ordinary(broadcast: Broadcast, frames: list[RidFrame]) -> None:
    times: dict[tuple[int, type], list[Time]] = defaultdict(list)
    for frame in frames:
        for part in parts(frame):
            if not isinstance(part, Authentication):
                times[frame.header.transport, type(part)].append(frame.header.time_ns)
    kinds = [BasicId, Location, System, *([OperatorId, SelfId] if broadcast.text else [])]
    assert set(times) == set(product(carriers(broadcast), kinds))
    for (_, kind), sent in times.items():
        longest = ORDINARY_S[broadcast.profile][kind] * NS_PER_S
        least = US_PERIOD_NS if broadcast.profile == "us" else longest
        for earlier, later in pairwise(sent):
            assert least <= later - earlier <= longest, (broadcast, kind)


def check_signed(broadcast: Broadcast, frames: list[RidFrame]) -> None:
    """A message is sent in its longest time, and earlier only where it could not be sent later in time, or is full."""
    assert broadcast.credentials is not None
    by_transport = signed_messages(broadcast, frames)
    assert set(by_transport) == set(carriers(broadcast))
    offsets = [slot.offset_ns for slot in broadcast_cycle(broadcast).slots]
    offsets.append(offsets[0] + broadcast_cycle(broadcast).period_ns)
    gap = max(later - earlier for earlier, later in pairwise(offsets))
    for (transport, sent), (kind, longest_s) in product(
        by_transport.items(), SIGNED_S[broadcast.credentials.rates].items()
    ):
        case = broadcast.profile, broadcast.transports, transport, kind
        found = [one for one in sent if one.kind == kind]
        # a Manifest waits for its frames on the transports before, a Link for all messages of the start
        ahead = 1 if len(by_transport) == 1 else LONGEST_PAGES + len(by_transport)
        wait = PAGE_NS * ahead if kind == MANIFEST else 4 * NS_PER_S
        for earlier, later in pairwise(found):
            apart = later.at_ns - earlier.at_ns
            assert apart <= longest_s * NS_PER_S + wait, (*case, apart)
            assert later.hashes == FULL or apart >= longest_s * NS_PER_S - gap - wait, (*case, apart)
        in_time = sum(one.hashes < FULL for one in found)
        assert in_time <= FLOWN_S / longest_s * 1.03 + 1, case  # 0.98 s is the period of the profile us
        assert len(found) >= FLOWN_S // longest_s, case


def signed_messages(broadcast: Broadcast, frames: list[RidFrame]) -> dict[int, list[Signed]]:
    """The authentication messages that were sent on each transport."""
    assert broadcast.credentials is not None
    chain = broadcast.credentials.registration
    links = {chain.hda_ua.child: OWN_LINK, chain.raa_hda.child: HDA_LINK, chain.apex_raa.child: RAA_LINK}
    held: dict[tuple[int, int], dict[int, tuple[Time, Authentication]]] = defaultdict(dict)
    found: dict[int, list[Signed]] = defaultdict(list)
    for frame in frames:
        pages = [part for part in parts(frame) if isinstance(part, Authentication)]
        key = frame.header.transport, frame.header.counter
        held[key] |= {page.page: (frame.header.time_ns, page) for page in pages}
        if not pages or len(held[key]) <= (held[key][0][1].last_page or 0):
            continue
        whole = held.pop(key)
        message = decode_sam(join_with_parity({number: page for number, (_, page) in whole.items()})[0])
        if isinstance(message, Link):
            one = Signed(links[message.child], whole[0][0], 0)
        else:
            assert isinstance(message, Evidence)
            one = Signed(MANIFEST, whole[0][0], len(decode_manifest(message.evidence).messages))
        found[frame.header.transport].append(one)
    return found


def parts(frame: RidFrame) -> tuple[object, ...]:
    message = decode(frame.body)
    return message.messages if isinstance(message, MessagePack) else (message,)


def carriers(broadcast: Broadcast) -> list[int]:
    return [int(kind) for name in broadcast.transports for kind in TRANSPORTS[name]]
