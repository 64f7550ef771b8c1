"""DRIP: what is written is read again; an observer survives any bytes and trusts none of them."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.drip import (
    MAX_AUTH_DATA,
    EntityTag,
    Evidence,
    Link,
    decode_sam,
    encode_sam,
    join_with_parity,
    page_count,
    split_with_parity,
)
from skyrange.codec.f3411 import Authentication, decode, encode
from skyrange.core.errors import DecodeError
from skyrange.remoteid.drip.registry import Registry
from skyrange.remoteid.drip.sender import Kind, Sender
from skyrange.remoteid.drip.verification.observed_sender import MAX_HEARD
from skyrange.remoteid.drip.verification.observer import MAX_TRACKS, Observer
from skyrange.remoteid.drip.verification.verdicts import Judged, Policy, Trust
from tests.tiers import examples

T0 = 220_000_000
REGISTRY = Registry.of_seed(1, T0 - 10, T0 + 1000)
HONEST = [
    encode(page)
    for kind in (Kind.HDA_UA, Kind.RAA_HDA, Kind.APEX_RAA)
    for page in Sender(REGISTRY.register("alpha"), legacy=True).make(kind, T0)
]
TIMES = st.integers(0, 2**32 - 1)


@given(st.binary(min_size=1, max_size=MAX_AUTH_DATA), TIMES, st.booleans(), st.data())
def test_pages_return_their_data(data: bytes, timestamp_s: int, parity: bool, draw: st.DataObject) -> None:
    pages = split_with_parity(data, timestamp_s, parity=parity)
    assert len(pages) == page_count(len(data), parity=parity) <= 11
    held = {page.page: page for message in pages if isinstance(page := decode(encode(message)), Authentication)}
    assert join_with_parity(held) == (data, None)
    if parity:
        lost = draw.draw(st.sampled_from(sorted(held)))
        del held[lost]
        assert join_with_parity(held)[0] == data


@given(
    TIMES, TIMES, st.binary(min_size=16, max_size=16), st.binary(min_size=32, max_size=32),
    st.binary(min_size=64, max_size=64), st.binary(min_size=1, max_size=112),
)  # fmt: skip
def test_messages_return(vnb_s: int, vna_s: int, tag: bytes, key: bytes, signature: bytes, frame: bytes) -> None:
    for message in (Link(vnb_s, vna_s, tag, key, tag, signature), Evidence(4, vnb_s, vna_s, frame, tag, signature)):
        assert decode_sam(encode_sam(message)) == message


@given(st.binary(max_size=255))
def test_any_authentication_data(data: bytes) -> None:
    try:
        message = decode_sam(data)
    except DecodeError:
        return
    assert encode_sam(message) == data


@given(st.integers(0, 16383), st.integers(0, 16383), st.binary(min_size=32, max_size=32))
def test_tags_return(raa: int, hda: int, key: bytes) -> None:
    tag = EntityTag.of_key(raa, hda, key)
    assert EntityTag.parse(tag.bytes_) == tag
    assert tag.commits_to(key)
    assert not tag._replace(hda=hda ^ 1).commits_to(key)


@st.composite
def hostile(draw: st.DrawFn) -> bytes:
    """Noise, messages of 25 bytes, packs, pages of noise, and honest pages with bits changed."""
    shape = draw(st.integers(0, 4))
    if shape == 0:
        return draw(st.binary(max_size=230))
    if shape == 1:
        return draw(st.binary(min_size=25, max_size=25))
    if shape == 2:
        count = draw(st.integers(0, 9))
        return bytes([0xF2, 25, count]) + b"".join(draw(st.binary(min_size=25, max_size=25)) for _ in range(count))
    if shape == 3:
        body = bytearray(draw(st.binary(min_size=25, max_size=25)))
        body[0], body[1] = 0x22, 0x50 | draw(st.integers(0, 15))
        return bytes(body)
    body = bytearray(draw(st.sampled_from(HONEST)))
    body[draw(st.integers(0, 24))] ^= draw(st.integers(0, 255))
    return bytes(body)


@settings(max_examples=examples(150), deadline=None)
@given(st.lists(st.tuples(st.integers(0, 200), st.integers(0, 3), hostile(), st.integers(0, 40)), max_size=120))
def test_an_observer_survives_anything(heard: list[tuple[int, int, bytes, int]]) -> None:
    observer = Observer(REGISTRY.anchors, Policy(verifications_per_s=5.0))
    now_s = float(T0)
    for address, counter, body, later in heard:
        now_s += later / 10
        assert observer.receive(address, counter, body, now_s) == Judged()
    tracks = observer.tracks(now_s)
    assert len(tracks) <= MAX_TRACKS
    assert all(track.state not in (Trust.VERIFIED, Trust.STALE, Trust.CONTRADICTED) for track in tracks)
    assert all(len(held.heard) <= MAX_HEARD for held in observer._tracks.values())


@settings(max_examples=examples(60), deadline=None)
@given(st.permutations([(row // 8, body) for row, body in enumerate(HONEST)]), st.sets(st.integers(0, 7), max_size=1))
def test_order_of_pages_does_not_matter(frames: list[tuple[int, bytes]], lost: set[int]) -> None:
    """The counter tells the three messages apart, whatever order their pages arrive in."""
    observer = Observer(REGISTRY.anchors)
    for counter, body in frames:
        if body[1] & 15 not in lost:
            observer.receive(1, counter, body, T0)
    assert observer.trusts(REGISTRY.register("alpha").identity.tag, T0)
    assert not observer.counts
