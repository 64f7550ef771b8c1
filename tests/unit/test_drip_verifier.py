"""Receivers that verify: clocks, verdicts that change, and the policy towards senders."""

from __future__ import annotations

import copy
from itertools import pairwise

import numpy as np
import pytest

from skyrange.codec.drip import Link, decode_sam, session_id
from skyrange.codec.f3411 import EPOCH_2019_S, Authentication, BasicId, IdType, Location, MessagePack, decode, encode
from skyrange.codec.f3411.authentication import join_pages
from skyrange.core.time import NS_PER_S
from skyrange.remoteid.broadcast_profiles import Broadcast
from skyrange.remoteid.drip.broadcasts import AuthenticationPages
from skyrange.remoteid.drip.registry import Registry
from skyrange.remoteid.drip.sender import PAGE_NS, Credentials
from skyrange.remoteid.drip.verification.verdicts import Acceptance, Trust, Verification, accepts
from skyrange.remoteid.drip.verification.verifier import MAX_TOLD, Verifier

START_S = 220_000_000
REGISTRY = Registry.of_seed(3, START_S - 10, START_S + 3600)
UTC_US = (EPOCH_2019_S + START_S) * 1_000_000
OWN, GHOST = bytes(5) + b"\x01", bytes(5) + b"\x02"


def location(step: int) -> bytes:
    return encode(MessagePack((Location(2, 47.0 + step * 1e-5, 8.0, 100.0, speed_mps=5.0, timestamp_s=step),)))


def aircraft() -> AuthenticationPages:
    registration = REGISTRY.register("a")
    who = session_id(registration.identity.tag)
    one = Broadcast("a", who, IdType.SPECIFIC_SESSION, credentials=Credentials(registration))
    return AuthenticationPages([one])


def fly(verifier: Verifier, seconds: int, *, row: int = 0, clock_from_s: int = 0) -> None:
    """An honest aircraft that signs, and a ghost that does not."""
    sender = aircraft()
    for step in range(seconds):
        now = step * NS_PER_S
        if step >= clock_from_s:
            verifier.set_clock(row, now, UTC_US + now // 1000)
        body = location(step)
        verifier.receive(row, now, OWN, 0, body)
        verifier.receive(row, now, GHOST, 0, location(step + 500))
        sender.sent(0, now, body)
        sender.sign(now, np.array([UTC_US + now // 1000]), np.array([now + NS_PER_S]))
        for page in sender.take(now, now + NS_PER_S):
            verifier.receive(row, page.at_ns, OWN, page.counter, page.body)


def test_policies_believe_less_and_less() -> None:
    believed = [{trust for trust in Trust if accepts(policy, trust)} for policy in Acceptance]
    assert believed[0] == set(Trust)
    assert believed[0] > believed[1] > believed[2] > believed[3] == {Trust.VERIFIED}
    assert Trust.TRUSTED_KEY not in believed[2]  # anybody can claim a tag and repeat its Links


@pytest.mark.parametrize(("acceptance", "believes_ghost"), [("accept", True), ("ignore-unsigned", False)])
def test_a_ghost_without_a_key(acceptance: str, believes_ghost: bool) -> None:
    verifier = Verifier([Verification(REGISTRY.anchors, Acceptance(acceptance)), None])
    fly(verifier, 12)
    assert verifier.trust(0, 1, 12 * NS_PER_S) is Trust.VERIFIED
    assert verifier.believes(0, 1, 12 * NS_PER_S)
    assert verifier.trust(0, 2, 12 * NS_PER_S) is Trust.NONE
    assert verifier.believes(0, 2, 12 * NS_PER_S) is believes_ghost
    assert verifier.believes(1, 2, 0)  # does not verify
    states = [change.state for change in verifier.changes() if change.address == 1]
    assert states[0] is Trust.NONE
    assert states[-1] is Trust.VERIFIED
    assert verifier.changes() == []
    verifier.review(60 * NS_PER_S)
    assert [change.state for change in verifier.changes()] == [Trust.STALE]


def _link_of(body: bytes) -> tuple[Authentication, ...]:
    """The pages of the Link in a pack; none if it has none."""
    pages = tuple(one for one in decode(body).messages if isinstance(one, Authentication))  # type: ignore[union-attr]
    return pages if pages and isinstance(decode_sam(join_pages(pages)), Link) else ()


@pytest.mark.parametrize("forged", [True, False])
def test_a_forged_location_in_a_pack_with_a_genuine_link(forged: bool) -> None:
    """A Link signs nothing that is sent beside it: such a Location is judged by the Manifests, as any other."""
    verifier, sender = Verifier([Verification(REGISTRY.anchors)]), aircraft()
    link: tuple[Authentication, ...] = ()
    for step in range(40):
        now = step * NS_PER_S
        verifier.set_clock(0, now, UTC_US + now // 1000)
        verifier.receive(0, now, OWN, 0, location(step))
        if forged and step >= 12:
            false = Location(2, 47.5, 8.5, 100.0, speed_mps=5.0, timestamp_s=step)
            verifier.receive(0, now, OWN, 0, encode(MessagePack((false, *link))))
        sender.sent(0, now, location(step))
        sender.sign(now, np.array([UTC_US + now // 1000]), np.array([now + NS_PER_S]))
        for page in sender.take(now, now + NS_PER_S):
            link = link or _link_of(page.body)
            verifier.receive(0, page.at_ns, OWN, page.counter, page.body)
    assert link
    states = [change.state for change in verifier.changes()]
    assert Trust.VERIFIED in states
    assert (Trust.CONTRADICTED in states) is forged


def test_what_came_before_the_clock_is_judged_later() -> None:
    verifier = Verifier([Verification(REGISTRY.anchors)])
    fly(verifier, 8, clock_from_s=7)
    assert verifier.trust(0, 1, 8 * NS_PER_S) is Trust.VERIFIED
    assert verifier.changes()[0].first_ns == 0


def test_a_clock_that_is_wrong() -> None:
    verifier = Verifier([Verification(REGISTRY.anchors, clock_error_s=500.0)])
    fly(verifier, 12)
    assert verifier.trust(0, 1, 12 * NS_PER_S) is Trust.REPLAYED


def test_a_flood_of_senders_is_not_told_one_by_one() -> None:
    verifier = Verifier([Verification(REGISTRY.anchors)])
    verifier.set_clock(0, 0, UTC_US)
    for number in range(1000):
        verifier.receive(0, number, number.to_bytes(6, "big"), 0, location(number))
    assert len(verifier.changes()) == MAX_TOLD + 1


def test_copies_go_on_alike() -> None:
    first = Verifier([Verification(REGISTRY.anchors)])
    fly(first, 3)
    second = copy.deepcopy(first)
    fly(first, 9)
    fly(second, 9)
    assert first.changes() == second.changes()


def test_pages_of_an_aircraft_without_a_clock() -> None:
    sender = aircraft()
    sender.sent(0, 0, encode(BasicId(IdType.SERIAL_NUMBER, 2, "A")))
    sender.sign(0, np.array([-1]), np.array([NS_PER_S]))
    assert sender.take(0, 10 * NS_PER_S) == []
    sender.sent(0, 0, location(0))
    sender.sign(0, np.array([UTC_US]), np.array([NS_PER_S]))
    found = sender.take(0, 10 * NS_PER_S)
    assert [page.at_ns for page in found] == [PAGE_NS * (place + 1) for place in range(4)]
    assert isinstance(_first(found[0].body), Authentication)


def _first(body: bytes) -> object:
    message = decode(body)
    assert isinstance(message, MessagePack)
    return message.messages[0]


@pytest.mark.parametrize(("acceptance", "filters"), [("accept", False), ("ignore-forged", True)])
def test_of_an_address_that_several_use_what_is_verified_is_acted_on(acceptance: str, filters: bool) -> None:
    """Locations wait there for their Manifest, with the time of their reception; forged ones are never acted on."""
    verifier, sender = Verifier([Verification(REGISTRY.known, Acceptance(acceptance))]), aircraft()
    acted: dict[int, bool] = {}
    released: list[tuple[bytes, int]] = []
    forged = []
    for step in range(40):
        now = step * NS_PER_S
        verifier.set_clock(0, now, UTC_US + now // 1000)
        judged = verifier.receive(0, now, OWN, 0, location(step))
        acted[step] = verifier.acts_on(0, 1, now, judged)
        if step >= 12:
            judged = verifier.receive(0, now, OWN, 0, location(step + 500))
            forged.append(verifier.acts_on(0, 1, now, judged))
        sender.sent(0, now, location(step))
        sender.sign(now, np.array([UTC_US + now // 1000]), np.array([now + NS_PER_S]))
        for page in sender.take(now, now + NS_PER_S):
            judged = verifier.receive(0, page.at_ns, OWN, page.counter, page.body)
            released += [(one.body, at_ns) for one, at_ns in verifier.release(0, page.at_ns, judged)]
    assert verifier.trust(0, 1, 40 * NS_PER_S) is Trust.CONTRADICTED
    assert all(acted[step] for step in range(20))
    assert acted[39] is not filters
    assert forged[-1] is not filters
    steps = [at_ns // NS_PER_S for _, at_ns in released]
    assert bool(steps) is filters
    assert all(later - earlier <= 5 for earlier, later in pairwise([*steps, 40] if steps else []))
    for body, at_ns in released:
        assert at_ns % NS_PER_S == 0
        assert body == location(at_ns // NS_PER_S)
    assert verifier.disbelieves(0, 40 * NS_PER_S, 1) is False


def test_an_old_location_is_not_acted_on_and_its_sender_is() -> None:
    verifier, sender = Verifier([Verification(REGISTRY.known, Acceptance.IGNORE_FORGED)]), aircraft()
    for step in range(40):
        now = step * NS_PER_S
        verifier.set_clock(0, now, UTC_US + now // 1000)
        if step >= 20:
            old = verifier.receive(0, now, OWN, 0, location(step - 20))
            assert not verifier.acts_on(0, 1, now, old)
        assert verifier.acts_on(0, 1, now, verifier.receive(0, now, OWN, 0, location(step)))
        sender.sent(0, now, location(step))
        sender.sign(now, np.array([UTC_US + now // 1000]), np.array([now + NS_PER_S]))
        for page in sender.take(now, now + NS_PER_S):
            verifier.receive(0, page.at_ns, OWN, page.counter, page.body)
