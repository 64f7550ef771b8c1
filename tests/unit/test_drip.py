"""DRIP in a range: what an observer makes of honest, lossy, forged and replayed broadcasts."""

from __future__ import annotations

import copy
import math

import pytest

from skyrange.codec.drip import EntityTag, Evidence, SamType, decode_sam, encode_sam, session_id, split_with_parity
from skyrange.codec.drip.messages import encode_manifest, manifest_evidence
from skyrange.codec.f3411 import BasicId, Location, MessagePack, encode
from skyrange.codec.f3411.authentication import join_pages
from skyrange.core.time import NS_PER_S
from skyrange.remoteid.drip.registry import (
    Identity,
    Level,
    Registration,
    Registry,
    child_level,
    endorse,
    range_secret,
    sign,
)
from skyrange.remoteid.drip.sender import (
    REQUIRED,
    Kind,
    Schedule,
    Sender,
)
from skyrange.remoteid.drip.verification.observer import Observer
from skyrange.remoteid.drip.verification.verdicts import Policy, Refusal, Trust
from tests.unit.drip_air import OTHER, OWN, REGISTRY, T0, Air, location


def test_an_honest_aircraft_is_verified() -> None:
    air = Air()
    air.second(0)
    assert air.observer.trusts(air.tag, T0 + 1)
    for step in range(1, 31):
        air.second(step)
        assert air.state(step + 0.9) == Trust.VERIFIED
    track = air.observer.track(OWN, T0 + 31)
    assert track is not None
    assert track.tag == air.tag
    assert track.time_to_trust_s == pytest.approx(0.6)
    assert track.counts == {}
    assert track.verified_messages >= 31
    assert air.state(31 + 15) == Trust.STALE
    assert air.observer.addresses_of(air.tag) == (OWN,)


def test_waits_for_the_root_link() -> None:
    """What was signed before the chain was complete is verified when it is."""
    air = Air(rates=REQUIRED._replace(apex_raa_s=math.inf))
    for step in range(20):
        air.second(step)
        assert air.state(step + 0.9) == Trust.UNVERIFIED
    root = split_with_parity(encode_sam(air.registration.apex_raa), int(T0), parity=True)
    for page in root:
        air.frame(encode(page), T0 + 20, counter=200)
    assert air.state(20) == Trust.VERIFIED
    track = air.observer.track(OWN, T0 + 20)
    assert track is not None
    assert track.time_to_trust_s == 20.0
    assert not track.counts


def test_endorsed_key_without_evidence() -> None:
    air = Air(rates=REQUIRED._replace(evidence_s=math.inf))
    air.second(0)
    assert air.state(1) == Trust.TRUSTED_KEY


def test_ignored_pages_and_other_methods() -> None:
    observer = Observer(REGISTRY.anchors)
    pages = split_with_parity(encode_sam(REGISTRY.register("a").hda_ua), 0, parity=True)
    observer.receive(OWN, 1, encode(pages[0]), T0)
    track = observer.track(OWN, T0)
    assert track is not None
    assert track.state == Trust.PARTIAL
    observer.receive(OTHER, 1, encode(pages[0]._replace(auth_type=1)), T0)
    track = observer.track(OTHER, T0)
    assert track is not None
    assert track.state == Trust.UNSUPPORTED
    assert observer.track(3, T0) is None
    assert len(observer.tracks(T0)) == 2


def test_lost_manifests_are_no_contradiction() -> None:
    air = Air(rates=REQUIRED._replace(evidence_s=1.0))
    for step in range(40):
        lost = {Kind.MANIFEST} if step % 5 == 3 else set()
        air.second(step, lose=frozenset(lost))
    assert air.state(40) == Trust.VERIFIED
    assert not air.observer.counts


def test_forged_location_under_the_same_address() -> None:
    air = Air()
    for step in range(22):
        air.second(step)
        if step == 8:
            air.frame(location(8, east=0.01), T0 + 8.2)
    assert air.state(22) == Trust.CONTRADICTED
    assert air.observer.counts == {Refusal.UNSIGNED: 1}
    for step in range(22, 100):
        air.second(step)
    assert air.state(100) == Trust.VERIFIED


def test_relayed_signatures_do_not_verify_forged_locations() -> None:
    """Another sender repeats an aircraft's signed pages beside locations of its own."""
    air = Air()
    for step in range(30):
        before = len(air.sent)
        air.second(step)
        for now_s, counter, body in air.sent[before:]:
            if body[0] >> 4 != 1:
                air.observer.receive(OTHER, counter, body, now_s + 0.1)
        air.observer.receive(OTHER, 0, location(step, east=0.02), T0 + step)
    assert air.state(30) == Trust.VERIFIED
    assert air.state(30, OTHER) == Trust.CONTRADICTED
    track = air.observer.track(OTHER, T0 + 30)
    assert track is not None
    assert track.verified_at_s is None


def test_replay_is_told_from_the_original() -> None:
    air = Air()
    for step in range(60):
        air.second(step)
        for now_s, counter, body in air.sent:
            if now_s + 20.0 > T0 + step >= now_s + 19.0:
                air.observer.receive(OTHER, counter, body, T0 + step + 0.9)
    assert air.state(60) == Trust.VERIFIED
    assert air.state(60, OTHER) == Trust.REPLAYED
    assert set(air.observer.counts) == {Refusal.REPLAYED}


def test_replay_after_the_validity() -> None:
    air, later = Air(), 121.0 + 60.0
    for step in range(60):
        air.second(step)
    for now_s, counter, body in air.sent:
        air.observer.receive(OTHER, counter, body, now_s + later)
    assert air.state(60 + later, OTHER) == Trust.REPLAYED
    assert set(air.observer.counts) == {Refusal.OUT_OF_TIME, Refusal.REPLAYED}


def test_replay_within_the_validity_of_an_aircraft_that_left() -> None:
    """A known limit: nothing newer was heard, and the validity has not ended. A shorter age ends it."""
    for policy, expected in ((Policy(), Trust.VERIFIED), (Policy(max_age_s=10.0), Trust.REPLAYED)):
        air, other = Air(), Observer(REGISTRY.anchors, policy)
        for step in range(10):
            air.second(step)
        for now_s, counter, body in air.sent:
            other.receive(OTHER, counter, body, now_s + 60)
        track = other.track(OTHER, T0 + 70)
        assert track is not None
        assert track.state == expected


def test_keys_of_another_registry_are_not_trusted() -> None:
    strange = Registry.of_seed(7, int(T0), int(T0) + 1000, name="forged")
    air = Air(strange.register("ghost"))
    for step in range(10):
        air.second(step)
    assert air.state(10) == Trust.UNVERIFIED
    assert air.observer.work == 0


def test_forged_endorsement() -> None:
    """A Link that names the true HDA and is signed by another key."""
    true = REGISTRY.register("alpha")
    tag = EntityTag.parse(REGISTRY.hda.tag)
    ghost = Identity.of_secret(range_secret(7, "ghost"), tag.raa, tag.hda)
    false_hda = REGISTRY.hda._replace(secret=ghost.secret)
    air = Air(Registration(ghost, endorse(false_hda, ghost, int(T0), int(T0) + 500), true.raa_hda, true.apex_raa))
    for step in range(10):
        air.second(step)
    assert air.state(10) == Trust.REFUSED
    assert air.observer.counts[Refusal.WRONG_SIGNATURE] == 1


def test_an_aircraft_endorses_nobody() -> None:
    """An insider's key has the numbers of its HDA, but not its place in the chain."""
    insider = REGISTRY.register("insider")
    tag = EntityTag.parse(insider.identity.tag)
    ghost = Identity.of_secret(range_secret(7, "ghost"), tag.raa, tag.hda)
    air = Air(insider)
    air.second(0)
    forged = endorse(insider.identity, ghost, int(T0), int(T0) + 500)
    for page in split_with_parity(encode_sam(forged), int(T0), parity=True):
        air.frame(encode(page), T0 + 1, OTHER, 9)
    assert not air.observer.trusts(ghost.tag, T0 + 2)
    assert air.observer.counts == {Refusal.NO_AUTHORITY: 1}


def test_levels() -> None:
    apex, raa, hda, ua = (EntityTag(r, h, 5, bytes(8)) for r, h in ((0, 0), (15360, 0), (15360, 1), (15360, 1)))
    assert child_level(Level.APEX, apex, raa) == Level.RAA
    assert child_level(Level.APEX, apex, hda) is None
    assert child_level(Level.APEX, apex, apex) is None
    assert child_level(Level.RAA, raa, hda) == Level.HDA
    assert child_level(Level.RAA, raa, raa) is None
    assert child_level(Level.RAA, raa, EntityTag(15361, 1, 5, bytes(8))) is None
    assert child_level(Level.HDA, hda, ua) == Level.AIRCRAFT
    assert child_level(Level.HDA, hda, EntityTag(15360, 2, 5, bytes(8))) is None
    assert child_level(Level.AIRCRAFT, ua, ua) is None


def test_own_key_under_the_claim_of_another() -> None:
    """An insider signs with its own key and claims the tag of somebody else."""
    air = Air(REGISTRY.register("insider"))
    air.tag = REGISTRY.register("victim").identity.tag
    for step in range(10):
        air.second(step)
    assert air.state(10) == Trust.REFUSED
    assert air.observer.counts[Refusal.WRONG_TAG] >= 1


def test_altered_manifest_and_long_validity() -> None:
    registration = REGISTRY.register("alpha")
    who, now = registration.identity, int(T0) + 1
    honest = encode_manifest(bytes(8), bytes(8), [bytes(8)])
    for manifest, validity_s, why in (
        (honest._replace(current=bytes(8)), 120, Refusal.WRONG_HASH),
        (honest, 100_000, Refusal.TOO_LONG),
        (honest, 120, Refusal.OTHER_LINK),
    ):
        air = Air(registration)
        air.second(0)
        draft = Evidence(SamType.MANIFEST, now, now + validity_s, manifest_evidence(manifest), who.tag)
        signed = draft._replace(signature=sign(who.secret, draft.signed()))
        for page in split_with_parity(encode_sam(signed), now, parity=True):
            air.frame(encode(page), T0 + 1.2, counter=77)
        assert air.observer.counts == {why: 1}


def test_every_single_page_may_be_lost() -> None:
    pages = Sender(REGISTRY.register("alpha"), legacy=True).make(Kind.HDA_UA, T0)
    for lost in range(len(pages)):
        observer = Observer(REGISTRY.known)
        for page in pages:
            if page.page != lost:
                observer.receive(OWN, 5, encode(page), T0)
        assert observer.trusts(REGISTRY.register("alpha").identity.tag, T0)
        assert observer.work == 1


def test_wrapper_and_pack() -> None:
    registration = REGISTRY.register("alpha")
    sender = Sender(registration, legacy=False)
    observer = Observer(REGISTRY.known)
    link = sender.make(Kind.HDA_UA, T0)
    observer.receive(OWN, 1, encode(MessagePack(link)), T0)
    said = (BasicId(4, 2, session_id(registration.identity.tag)), Location(2, 47.0, 8.0, 90.0))
    pages = sender.pack_wrapper([encode(part) for part in said], T0)
    assert len(pages) == 5
    (basic_id, place), wrapper = said, pages
    found = observer.receive(OWN, 2, encode(MessagePack((basic_id, place, *wrapper))), T0 + 0.1).verified
    assert {item.body for item in found} == {encode(part) for part in said}
    forged = Location(2, 47.1, 8.0, 90.0)
    observer.receive(OTHER, 3, encode(MessagePack((basic_id, forged, *wrapper))), T0 + 0.2)
    assert observer.counts == {Refusal.WRONG_SIGNATURE: 1}
    legacy = Sender(registration, legacy=True).wrapper([encode(place)], T0)
    for page in legacy:
        found = observer.receive(OWN, 4, encode(page), T0 + 0.3).verified
    assert [item.body for item in found] == [] or found[0].body == encode(place)
    track = observer.track(OWN, T0 + 1)
    assert track is not None
    assert track.state == Trust.VERIFIED


def test_budget() -> None:
    air = Air(policy=Policy(verifications_per_s=0.001, verification_burst=2))
    for step in range(10):
        air.second(step)
    assert air.observer.work == 2
    assert air.observer.counts[Refusal.OVER_BUDGET] > 0


def test_nothing_is_verified_twice() -> None:
    air = Air()
    for step in range(5):
        air.second(step)
    work = air.observer.work
    for now_s, counter, body in list(air.sent):
        air.observer.receive(OWN, counter + 50, body, now_s + 5)
    assert air.observer.work == work


def test_copies_go_on_alike() -> None:
    air = Air()
    for step in range(7):
        air.second(step)
    twin = copy.deepcopy(air)
    for step in range(7, 20):
        air.second(step)
        twin.second(step)
    assert air.sent == twin.sent
    assert air.observer.tracks(T0 + 20) == twin.observer.tracks(T0 + 20)


def test_required_rates() -> None:
    """RFC 9575, section 6.3."""
    schedule, sent = Schedule(REQUIRED), dict.fromkeys(Kind, 0)
    for now in range(600):
        for kind in schedule.due((now + 1) * NS_PER_S, 1):
            sent[kind] += 1
            schedule.done(kind, now * NS_PER_S)
    assert sent == {Kind.HDA_UA: 10, Kind.MANIFEST: 120, Kind.RAA_HDA: 2, Kind.APEX_RAA: 2, Kind.WRAPPER: 0}
    assert [bool(schedule.due(now * NS_PER_S, 1)) for now in (600, 601)] == [False, True]
    assert Kind.MANIFEST not in schedule.due(1000 * NS_PER_S, 0)
    schedule.done(Kind.MANIFEST, 1000 * NS_PER_S)
    assert Kind.MANIFEST not in schedule.due(1001 * NS_PER_S, 9)
    assert Kind.MANIFEST in schedule.due(1001 * NS_PER_S, 10)
    with pytest.raises(ValueError, match="wrapper"):
        Sender(REGISTRY.register("a"), legacy=True).make(Kind.WRAPPER, 0)


def test_messages_with_parity_have_eight_pages() -> None:
    """RFC 9575, appendix B.2."""
    sender = Sender(REGISTRY.register("alpha"), legacy=True)
    wrapper = sender.wrapper([location(0), location(1)], T0)
    assert len(sender.make(Kind.RAA_HDA, T0)) == len(wrapper) == 8
    data = join_pages(wrapper)
    assert decode_sam(data).vnb_s == int(T0)
