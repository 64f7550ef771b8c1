"""DRIP verdicts on messages and their signers, where several send under one address."""

from __future__ import annotations

import math

from skyrange.codec.drip import Evidence, SamType, encode_sam, split_with_parity
from skyrange.codec.drip.messages import encode_manifest, manifest_evidence
from skyrange.codec.f3411 import MessageType, encode
from skyrange.remoteid.drip.registry import Identity, sign
from skyrange.remoteid.drip.sender import (
    REQUIRED,
    Kind,
)
from skyrange.remoteid.drip.verification.observer import Observer
from skyrange.remoteid.drip.verification.verdicts import Refusal, Trust
from tests.unit.drip_air import OTHER, OWN, REGISTRY, T0, Air, identity, location


def _is_located(body: bytes) -> bool:
    return body[0] >> 4 == MessageType.LOCATION


def test_old_messages_under_the_same_address_leave_the_aircraft_verified() -> None:
    """Each copy of a Location is told from the new ones when it arrives (RFC 9575, 9.1: content that is nonce-like)."""
    air = Air()
    for step in range(90):
        old = [entry for entry in air.sent if T0 + step - 20.0 <= entry[0] < T0 + step - 19.0]
        for _, counter, body in old:
            assert air.frame(body, T0 + step, counter=counter).is_replayed is _is_located(body)
            air.sent.pop()
        air.second(step)
        if step > 1:
            assert air.state(step + 0.9) == Trust.VERIFIED
    assert set(air.observer.counts) == {Refusal.REPLAYED}
    track = air.observer.track(OWN, T0 + 90)
    assert track is not None
    assert track.verified_messages >= 2 * 85


def test_old_messages_whose_originals_were_not_heard() -> None:
    """Nothing tells them from forged ones. Several use the address then; what its owner signs is verified as before."""
    air, own = Air(), set()
    for step in range(75):
        if step == 40:
            air.observer = Observer(REGISTRY.known)
            for page in split_with_parity(encode_sam(air.registration.hda_ua), int(T0), parity=True):
                air.observer.receive(OWN, 7, encode(page), T0 + step)
        old = [entry for entry in air.sent if T0 + step - 30.0 <= entry[0] < T0 + step - 29.0]
        for _, counter, body in old:
            air.frame(body, T0 + step, counter=counter)
            air.sent.pop()
        air.second(step)
        own.add(location(step))
    assert air.state(75) == Trust.CONTRADICTED
    said = {one.body for one in air.verified if _is_located(one.body) and one.heard_s >= T0 + 41}
    assert said >= {location(step) for step in range(41, 70)}
    assert said <= own


def test_the_last_manifest_of_an_aircraft_sent_again_by_another() -> None:
    air = Air()
    for step in range(31):
        air.second(step)
    for now_s, counter, body in list(air.sent):
        air.frame(body, now_s + 40.0, OTHER, counter)
    assert air.state(71, OTHER) == Trust.REPLAYED
    assert not [one for one in air.verified if one.address == OTHER and _is_located(one.body)]


def _manifest(identity: Identity, now: int, *, key: bytes) -> list[bytes]:
    """The pages of a Manifest of an unknown message in the name of an identity, signed with some key."""
    evidence = manifest_evidence(encode_manifest(bytes(8), bytes(8), [bytes(8)]))
    draft = Evidence(SamType.MANIFEST, now, now + 120, evidence, identity.tag)
    signed = draft._replace(signature=sign(key, draft.signed()))
    return [encode(page) for page in split_with_parity(encode_sam(signed), now, parity=True)]


def test_forged_messages_take_no_verified_message_away() -> None:
    """Forged pages, Locations and Basic IDs under an aircraft's address do not deny it to a receiver."""
    air, other = Air(), REGISTRY.register("somebody").identity.tag
    for step in range(60):
        air.second(step)
        if step % 3 == 2:
            forged = _manifest(air.registration.identity, int(T0) + step, key=bytes(32))
            for body in (*forged, location(step, east=0.01), identity(other)):
                air.frame(body, T0 + step + 0.8, counter=99 + step)
    assert air.state(60) == Trust.CONTRADICTED
    assert air.observer.counts[Refusal.WRONG_SIGNATURE] == 20
    assert air.observer.counts[Refusal.WRONG_TAG] == 0
    said = {one.body for one in air.verified if _is_located(one.body)}
    assert said >= {location(step) for step in range(55)}
    assert all(one.tag == air.tag for one in air.verified)
    assert said <= {location(step) for step in range(60)}


def test_an_aircraft_whose_manifests_are_lost_while_others_repeat_its_old_ones() -> None:
    """It is stale, not replayed: who disbelieves what is forged still hears its new messages."""
    air, states = Air(), []
    for step in range(100):
        old = [entry for entry in air.sent if T0 + step - 20.0 <= entry[0] < T0 + step - 19.0]
        for _, counter, body in old:
            air.frame(body, T0 + step, counter=counter)
            air.sent.pop()
        air.second(step, lose=frozenset({Kind.MANIFEST}) if step >= 25 else frozenset())
        states.append(air.state(step + 0.9))
    assert states[2:30] == [Trust.VERIFIED] * 28  # and 15 s from the last Manifest on
    assert states[40:] == [Trust.STALE] * 60


def test_old_messages_of_an_aircraft_that_cannot_be_verified_yet() -> None:
    air = Air(rates=REQUIRED._replace(apex_raa_s=math.inf))
    for step in range(40):
        old = [entry for entry in air.sent if T0 + step - 20.0 <= entry[0] < T0 + step - 19.0]
        for _, counter, body in old:
            assert air.frame(body, T0 + step, counter=counter).is_replayed is _is_located(body)
            air.sent.pop()
        assert not air.frame(location(step), T0 + step).is_replayed
        air.second(step)
        assert air.state(step + 0.9) == Trust.UNVERIFIED


def test_a_basic_id_of_another_under_the_address_refuses_no_manifest() -> None:
    air = Air()
    for step in range(7):
        air.second(step)
    air.frame(identity(REGISTRY.register("somebody").identity.tag), T0 + 7)
    for page in air.sender.make(Kind.MANIFEST, T0 + 7):
        air.frame(encode(page), T0 + 7.1, counter=200)
    assert air.state(7.2) == Trust.VERIFIED
    assert not air.observer.counts


def test_a_registered_aircraft_that_signs_under_the_address_of_another() -> None:
    """Its Manifests do not hide that Locations are forged: an address with two signers is contradicted."""
    air, insider = Air(), REGISTRY.register("insider")
    link = split_with_parity(encode_sam(insider.hda_ua), int(T0), parity=True)
    for step in range(40):
        air.second(step)
        if step == 5:
            for page in link:
                air.frame(encode(page), T0 + step, OTHER, counter=7)
        if step > 5:
            pages = _manifest(insider.identity, int(T0) + step, key=insider.identity.secret)
            for body in (identity(insider.identity.tag), *pages):
                air.frame(body, T0 + step + 0.8, counter=50 + step)
        if step == 5:
            assert air.state(step + 0.9) == Trust.VERIFIED
    assert air.state(40) == Trust.CONTRADICTED
    assert air.observer.counts[Refusal.SHARED_ADDRESS] > 0
    assert {one.body for one in air.verified if one.tag == air.tag} >= {location(step) for step in range(35)}
