"""Receiver side of DRIP: whose key is trusted, which messages that key signed, and what contradicts them.

One `Observer` follows every sender it hears, without a network: it starts from the keys it was configured with and
learns others from Links. It is meant for hostile air. Whatever is received, it raises nothing, counts what it refuses,
holds a bounded amount, and verifies no signature twice. That a message is verified says who signed it, and never that
it is true (RFC 9575, section 3.1.2.2).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from enum import StrEnum
from hashlib import sha256
from typing import Any, Final, NamedTuple

from skyrange.codec.drip import (
    EntityTag,
    Evidence,
    Link,
    SamType,
    UnsupportedMethodError,
    decode_manifest,
    decode_sam,
    decode_wrapped,
    link_hash,
    message_hash,
    parse_session_id,
)
from skyrange.codec.f3411 import (
    SIZE,
    Authentication,
    AuthType,
    BasicId,
    IdType,
    MessagePack,
    MessageType,
    decode,
)
from skyrange.codec.f3411.authentication import join_pages
from skyrange.codec.f3411.encode import PACK_HEADER
from skyrange.core.errors import DecodeError
from skyrange.remoteid.drip.keys import verify
from skyrange.remoteid.drip.reassembly import Reassembly
from skyrange.remoteid.drip.registry import Anchor, Level, child_level

MAX_TRACKS: Final = 64
"""Senders followed at once, as in track tables; the one heard longest ago makes room."""
MAX_KEYS: Final = 4096
"""Keys held. Only registered parties fill this."""
MAX_ORPHANS: Final = 64
"""Links held whose parent is not known yet; the oldest makes room."""
MAX_WAITING: Final = 8
"""Signed messages that a track holds until their key is known; the oldest makes room."""
MAX_HEARD: Final = 128
"""Messages of a track that wait for a Manifest, and hashes held that wait for their message."""
MAX_SEEN: Final = 1024
"""Digests of messages already judged."""
DYNAMIC: Final = frozenset((MessageType.LOCATION, MessageType.SYSTEM))
"""Types whose content nobody knows long before, so that a signature proves possession of the key now (section 9.1)."""


class Trust(StrEnum):
    """State of a track. In brackets the state of RFC 9575, appendix A, that it refines."""

    NONE = "none"
    """No authentication was received (None)."""
    PARTIAL = "partial"
    """Pages, but no whole message (Partial)."""
    UNSUPPORTED = "unsupported"
    """Only methods other than DRIP's (Unsupported)."""
    UNVERIFIED = "unverified"
    """Signed, by a key that no trusted authority has endorsed yet (Unverifiable)."""
    TRUSTED_KEY = "trusted key"
    """The key of the claimed tag is endorsed. Nothing proves that this sender holds it."""
    VERIFIED = "message verified"
    """A trusted key signed a recent Location or System message received here (Verified)."""
    STALE = "stale"
    """That was so, and no further message was verified for too long."""
    REPLAYED = "replayed"
    """What was signed is out of its time, or older than what the same key signed meanwhile."""
    REFUSED = "refused"
    """Signatures or contents were wrong, and none was right (Unverified)."""
    CONTRADICTED = "contradicted"
    """Right and wrong ones, or a message that the key's owner demonstrably did not sign (Questionable)."""


class Refusal(StrEnum):
    """Why something received was not accepted; the keys of `Observer.counts`."""

    MALFORMED = "malformed"
    UNSUPPORTED = "method not supported"
    OVER_BUDGET = "over the budget of verifications"
    WRONG_SIGNATURE = "wrong signature"
    WRONG_HASH = "Manifest with a wrong hash of its own"
    WRONG_TAG = "signed by another tag than the claimed one"
    UNBOUND_KEY = "key that its tag does not commit to"
    NO_AUTHORITY = "endorsed by a key that has no authority to"
    LINK_OUT_OF_TIME = "Link out of its time"
    OUT_OF_TIME = "signed message out of its time"
    TOO_LONG = "validity too long"
    REPLAYED = "older than what the same key signed meanwhile"
    UNSIGNED = "message in none of the Manifests around it"
    OTHER_LINK = "Manifest of another Link"
    """Counted only: an aircraft may have registered again."""
    NO_ROOM = "displaced"


class Policy(NamedTuple):
    """How a receiver judges. Times in seconds."""

    clock_skew_s: float = 2.0
    """How far clocks may differ. At least 1: times are whole seconds, rounded up."""
    max_validity_s: float = 600.0
    """Longest validity of signed evidence (RFC 9575, section 9.3, recommends 3 to 5 minutes)."""
    max_age_s: float = float("inf")
    """From signing to reception, where shorter than the validity that the sender chose."""
    overlap_s: float = 3.0
    """How much older than the newest of the same key a signed message may be: several transports carry copies, and a
    Link or Wrapper overtaken by a Manifest is no replay.
    """
    fresh_s: float = 15.0
    """Verified lasts this long: three times the longest time between two signed messages."""
    memory_s: float = 60.0
    """A contradiction or refusal lasts this long, so that one forged page does not discredit an aircraft forever."""
    full_coverage: bool = True
    """Whether senders put every message in a Manifest. Then a Location in none of two Manifests that follow each other
    is forged; otherwise it is merely unsigned.
    """
    verifications_per_s: float = float("inf")
    """Budget against floods of signatures; what exceeds it is dropped and counted."""
    verification_burst: float = 20.0


class Track(NamedTuple):
    """What an observer holds of one sender address."""

    address: int
    state: Trust
    tag: bytes | None
    """The tag that signed; before that, the one that its Basic ID claims."""
    first_heard_s: float
    verified_at_s: float | None
    """When its first Location or System message was verified."""
    verified_messages: int
    counts: dict[Refusal, int]

    @property
    def time_to_trust_s(self) -> float | None:
        """From the first broadcast to the first verified one."""
        return None if self.verified_at_s is None else self.verified_at_s - self.first_heard_s


class Verified(NamedTuple):
    """A message whose signer is known now."""

    address: int
    tag: bytes
    body: bytes
    """25 bytes, or a pack."""
    heard_s: float
    """When it was received; its verification may come later."""


class _Known(NamedTuple):
    key: bytes
    level: Level
    vnb_s: float
    vna_s: float
    link: bytes
    """Hash of the Link that endorsed it; b"" of an anchor."""


class _TrackState:
    """Mutable part of a track."""

    __slots__ = (
        "bad_s",
        "claimed",
        "confirmed_s",
        "counts",
        "covered",
        "first_s",
        "good_s",
        "heard",
        "last_s",
        "manifest",
        "manifest_s",
        "older_s",
        "pages",
        "replayed_s",
        "signed_off",
        "tag",
        "unsupported",
        "verified",
        "verified_at_s",
        "waiting",
    )  # fmt: skip

    def __init__(self, now_s: float) -> None:
        self.first_s = self.last_s = now_s
        self.pages = Reassembly()
        self.claimed: bytes | None = None
        self.tag: bytes | None = None
        self.heard: dict[bytes, tuple[float, bytes]] = {}  # in no Manifest yet, by hash
        self.covered: dict[bytes, float] = {}  # hashes in good Manifests, by their time
        self.waiting: list[tuple[Evidence, bytes, float]] = []  # with what is beside it, and when it was received
        self.manifest: bytes | None = None  # hash of the newest good Manifest
        self.manifest_s = 0.0  # when that was received
        self.older_s = 0.0  # when the one before that was
        self.signed_off = 0.0  # of what was heard since then, no Manifest was lost
        self.good_s: float | None = None
        self.bad_s: float | None = None
        self.replayed_s: float | None = None
        self.confirmed_s: float | None = None
        self.verified_at_s: float | None = None
        self.verified = 0
        self.unsupported = False
        self.counts: Counter[Refusal] = Counter()


class Observer:
    """A receiver that verifies. Times are seconds since 2019-01-01T00:00:00Z by its own clock, and never decrease."""

    __slots__ = (
        "_keys",
        "_newest",
        "_orphans",
        "_policy",
        "_seen",
        "_tokens",
        "_tokens_s",
        "_tracks",
        "counts",
        "work",
    )

    def __init__(self, anchors: Iterable[Anchor], policy: Policy = Policy()) -> None:  # noqa: B008 (immutable)
        self._policy = policy
        endless = float("inf")
        self._keys = {anchor.tag: _Known(anchor.key, anchor.level, 0.0, endless, b"") for anchor in anchors}
        self._newest: dict[bytes, int] = {}
        self._orphans: dict[bytes, tuple[Link, int]] = {}  # with the sender's address
        self._seen: dict[bytes, None] = {}
        self._tokens = policy.verification_burst
        self._tokens_s = 0.0
        self._tracks: dict[int, _TrackState] = {}
        self.counts: Counter[Refusal] = Counter()
        self.work = 0
        """Signatures verified."""

    def receive(self, address: int, counter: int, body: bytes, now_s: float) -> tuple[Verified, ...]:
        """Take a received message or pack, with its sender address and counter; returns what is verified by it."""
        track = self._track(address, now_s)
        found: list[Verified] = []
        try:
            message = decode(body)
        except DecodeError:
            self._count(track, Refusal.MALFORMED)
            return ()
        if isinstance(message, MessagePack):
            self._pack(address, track, message, body, now_s, found)
        elif isinstance(message, Authentication):
            if message.auth_type != AuthType.SPECIFIC_METHOD:
                track.unsupported = True
                self._count(track, Refusal.UNSUPPORTED)
            elif (data := track.pages.add(counter, message, now_s)) is not None:
                self._sam(address, track, data, b"", now_s, found)
        else:
            if isinstance(message, BasicId):
                self._claim(track, message)
            self._remember(address, track, body, now_s, found)
        return tuple(found)

    def track(self, address: int, now_s: float) -> Track | None:
        """The track of a sender; `None` if it is not followed."""
        held = self._tracks.get(address)
        if held is None:
            return None
        return Track(
            address, self._state(held, now_s), held.tag or held.claimed, held.first_s, held.verified_at_s,
            held.verified, dict(held.counts),
        )  # fmt: skip

    def tracks(self, now_s: float) -> tuple[Track, ...]:
        """All tracks, in the order of their first broadcasts."""
        return tuple(track for address in self._tracks if (track := self.track(address, now_s)) is not None)

    def addresses_of(self, tag: bytes) -> tuple[int, ...]:
        """The senders whose newest accepted evidence `tag` signed: several transports of one aircraft, or a relay."""
        return tuple(address for address, track in self._tracks.items() if track.tag == tag)

    def trusts(self, tag: bytes, now_s: float) -> bool:
        """Whether a chain of endorsements leads to the key of `tag`."""
        return self._valid_key(tag, now_s) is not None

    def _track(self, address: int, now_s: float) -> _TrackState:
        track = self._tracks.get(address)
        if track is None:
            if len(self._tracks) >= MAX_TRACKS:
                del self._tracks[min(self._tracks, key=lambda key: self._tracks[key].last_s)]
                self.counts[Refusal.NO_ROOM] += 1
            track = self._tracks[address] = _TrackState(now_s)
        track.last_s = now_s
        return track

    def _state(self, track: _TrackState, now_s: float) -> Trust:
        policy = self._policy
        good = track.good_s is not None
        if track.bad_s is not None and now_s - track.bad_s <= policy.memory_s:
            return Trust.CONTRADICTED if good else Trust.REFUSED
        replayed = track.replayed_s
        if replayed is not None and now_s - replayed <= policy.memory_s and (track.good_s or 0.0) <= replayed:
            return Trust.REPLAYED
        if track.confirmed_s is not None:
            return Trust.VERIFIED if now_s - track.confirmed_s <= policy.fresh_s else Trust.STALE
        tag = track.tag or track.claimed
        if tag is not None and self._valid_key(tag, now_s) is not None:
            return Trust.TRUSTED_KEY
        if track.waiting:
            return Trust.UNVERIFIED
        if track.unsupported:
            return Trust.UNSUPPORTED
        return Trust.PARTIAL if track.pages.is_waiting else Trust.NONE

    def _count(self, track: _TrackState, why: Refusal) -> None:
        track.counts[why] += 1
        self.counts[why] += 1

    def _bad(self, track: _TrackState, why: Refusal, now_s: float) -> None:
        self._count(track, why)
        track.bad_s = now_s

    def _claim(self, track: _TrackState, who: BasicId) -> None:
        if who.id_type == IdType.SPECIFIC_SESSION and (tag := parse_session_id(who.uas_id)) is not None:
            track.claimed = tag

    def _remember(
        self, address: int, track: _TrackState, body: bytes, now_s: float, found: list[Verified]
    ) -> None:  # fmt: skip
        hash_ = message_hash(body)
        covered_s = track.covered.get(hash_)
        if covered_s is not None and now_s - covered_s <= self._policy.overlap_s and track.tag is not None:
            self._confirm(address, track, track.tag, body, now_s, now_s, found)  # repeated after its Manifest
            return
        track.heard.setdefault(hash_, (now_s, body))
        _bound(track.heard, MAX_HEARD)

    def _confirm(
        self, address: int, track: _TrackState, tag: bytes, body: bytes, heard_s: float, now_s: float,
        found: list[Verified],
    ) -> None:  # fmt: skip
        track.verified += 1
        found.append(Verified(address, tag, body, heard_s))
        bodies = _bodies(body)
        if any(part[0] >> 4 in DYNAMIC for part in bodies):
            track.confirmed_s = now_s
            if track.verified_at_s is None:
                track.verified_at_s = now_s

    def _pack(
        self, address: int, track: _TrackState, pack: MessagePack, body: bytes, now_s: float, found: list[Verified]
    ) -> None:  # fmt: skip
        pages = [part for part in pack.messages if isinstance(part, Authentication)]
        for part in pack.messages:
            if isinstance(part, BasicId):
                self._claim(track, part)
        if not pages:
            self._remember(address, track, body, now_s, found)
            return
        if any(page.auth_type != AuthType.SPECIFIC_METHOD for page in pages):
            track.unsupported = True
            self._count(track, Refusal.UNSUPPORTED)
            return
        beside = [part for part in _bodies(body) if part[0] >> 4 != MessageType.AUTHENTICATION]
        try:
            data = join_pages(pages)
        except DecodeError:
            self._count(track, Refusal.MALFORMED)
            return
        beside.sort(key=_type_of)
        self._sam(address, track, data, b"".join(beside), now_s, found)

    def _sam(
        self, address: int, track: _TrackState, data: bytes, beside: bytes, now_s: float, found: list[Verified]
    ) -> None:  # fmt: skip
        try:
            message = decode_sam(data)
        except UnsupportedMethodError:
            track.unsupported = True
            self._count(track, Refusal.UNSUPPORTED)
        except DecodeError:
            self._count(track, Refusal.MALFORMED)
        else:
            if isinstance(message, Link):
                self._link(address, track, message, now_s, found)
            else:
                self._evidence(address, track, message, beside, now_s, now_s, found)

    def _affords(self, now_s: float) -> bool:
        """Take one verification from the budget."""
        policy = self._policy
        if policy.verifications_per_s != float("inf"):
            gained = max(0.0, now_s - self._tokens_s) * policy.verifications_per_s
            self._tokens, self._tokens_s = min(policy.verification_burst, self._tokens + gained), now_s
            if self._tokens < 1.0:
                return False
            self._tokens -= 1.0
        self.work += 1
        return True

    def _is_new(self, digest: bytes) -> bool:
        if digest in self._seen:
            return False
        self._seen[digest] = None
        _bound(self._seen, MAX_SEEN)
        return True

    def _valid_key(self, tag: bytes, now_s: float) -> _Known | None:
        known, skew_s = self._keys.get(tag), self._policy.clock_skew_s
        return known if known is not None and known.vnb_s - skew_s <= now_s <= known.vna_s + skew_s else None

    def _link(self, address: int, track: _TrackState, link: Link, now_s: float, found: list[Verified]) -> None:
        own = link_hash(link)
        held = self._keys.get(link.child)
        if held is not None and held.link in (own, b""):
            return  # known already, or an anchor
        digest = b"link" + own
        if digest in self._seen:
            return
        try:
            child, parent = EntityTag.parse(link.child), EntityTag.parse(link.parent)
        except DecodeError:
            self._bad(track, Refusal.MALFORMED, now_s)
            return
        if not child.commits_to(link.child_key):
            self._bad(track, Refusal.UNBOUND_KEY, now_s)
            return
        skew_s = self._policy.clock_skew_s
        if not link.vnb_s - skew_s <= now_s <= link.vna_s + skew_s:
            self._count(track, Refusal.LINK_OUT_OF_TIME)
            return
        authority = self._valid_key(link.parent, now_s)
        if authority is None:
            self._orphans[own] = (link, address)
            _bound(self._orphans, MAX_ORPHANS)
            return
        level = child_level(authority.level, parent, child)
        if level is None:
            self._bad(track, Refusal.NO_AUTHORITY, now_s)
            return
        if not self._affords(now_s):
            self._count(track, Refusal.OVER_BUDGET)
            return
        if not verify(authority.key, link.signature, link.signed):
            self._is_new(digest)
            self._bad(track, Refusal.WRONG_SIGNATURE, now_s)
            return
        if link.child not in self._keys and len(self._keys) >= MAX_KEYS:
            self._count(track, Refusal.NO_ROOM)
            return
        until_s = min(float(link.vna_s), authority.vna_s)
        if held is None or until_s > held.vna_s:
            self._keys[link.child] = _Known(link.child_key, level, float(link.vnb_s), until_s, own)
        self._adopt(link.child, now_s, found)

    def _adopt(self, tag: bytes, now_s: float, found: list[Verified]) -> None:
        """Judge what waited for the key of `tag`, each on the account of its own sender."""
        for own in [own for own, (link, _) in self._orphans.items() if link.parent == tag]:
            link, address = self._orphans.pop(own)
            self._link(address, self._tracks.get(address) or _TrackState(now_s), link, now_s, found)
        for address, track in list(self._tracks.items()):
            ready = [entry for entry in track.waiting if entry[0].tag == tag]
            if ready:
                track.waiting = [entry for entry in track.waiting if entry[0].tag != tag]
                for evidence, beside, heard_s in ready:
                    self._evidence(address, track, evidence, beside, heard_s, now_s, found)

    def _evidence(
        self, address: int, track: _TrackState, evidence: Evidence, beside: bytes, heard_s: float, now_s: float,
        found: list[Verified],
    ) -> None:  # fmt: skip
        """Judge evidence received at `heard_s`, perhaps later than that."""
        policy, vnb_s, vna_s = self._policy, evidence.vnb_s, evidence.vna_s
        signed = evidence.signed(beside)
        digest = sha256(b"%d/" % address + signed + evidence.signature).digest()
        if digest in self._seen:
            return
        known = self._valid_key(evidence.tag, now_s)
        if known is None:
            track.waiting.append((evidence, beside, heard_s))
            del track.waiting[:-MAX_WAITING]
            return
        if not self._affords(now_s):
            self._count(track, Refusal.OVER_BUDGET)
            return
        self._is_new(digest)
        if not verify(known.key, evidence.signature, signed):
            self._bad(track, Refusal.WRONG_SIGNATURE, now_s)
            return
        if vna_s - vnb_s > policy.max_validity_s:
            self._bad(track, Refusal.TOO_LONG, now_s)
            return
        skew_s = policy.clock_skew_s
        if not vnb_s - skew_s <= heard_s <= min(float(vna_s), vnb_s + policy.max_age_s) + skew_s:
            self._count(track, Refusal.OUT_OF_TIME)
            track.replayed_s = now_s
            return
        newest = self._newest.get(evidence.tag, vnb_s)
        if vnb_s + policy.overlap_s < newest:
            self._count(track, Refusal.REPLAYED)
            track.replayed_s = now_s
            return
        self._newest[evidence.tag] = max(newest, vnb_s)
        if track.claimed is not None and track.claimed != evidence.tag:
            self._bad(track, Refusal.WRONG_TAG, now_s)
            return
        self._accept(address, track, evidence, known, beside, heard_s, now_s, found)

    def _accept(
        self, address: int, track: _TrackState, evidence: Evidence, known: _Known, beside: bytes, heard_s: float,
        now_s: float, found: list[Verified],
    ) -> None:  # fmt: skip
        """Credit a track with evidence whose signature and times are right."""
        if evidence.sam_type == SamType.MANIFEST:
            manifest = decode_manifest(evidence.evidence)
            if manifest.current != manifest.own_hash:
                self._bad(track, Refusal.WRONG_HASH, now_s)
                return
            if known.link and manifest.link != known.link:
                self._count(track, Refusal.OTHER_LINK)
            track.tag, track.good_s = evidence.tag, now_s
            for hash_ in manifest.messages:
                track.covered[hash_] = now_s
                if (heard := track.heard.pop(hash_, None)) is not None:
                    self._confirm(address, track, evidence.tag, heard[1], heard[0], now_s, found)
            _bound(track.covered, MAX_HEARD)
            self._find_unsigned(track, manifest.previous, heard_s, now_s)
            track.manifest = manifest.current
            track.older_s, track.manifest_s = track.manifest_s, heard_s
            return
        track.tag, track.good_s = evidence.tag, now_s
        if evidence.sam_type == SamType.WRAPPER:
            bodies = decode_wrapped(evidence.evidence) if evidence.evidence else _split(beside)
            for body in bodies:
                # not taken from `heard`: the Manifests that follow cover it too
                self._confirm(address, track, evidence.tag, body, now_s, now_s, found)

    def _find_unsigned(self, track: _TrackState, previous: bytes, heard_s: float, now_s: float) -> None:
        """Messages that were heard between Manifests without a gap, and that none of these holds.

        A Manifest holds what was sent before it, and may be under way while more is sent. So what was heard before the
        last but one is in one of these three, or the owner of the key did not send it. The chain of hashes tells
        whether a Manifest was lost.
        """
        if track.manifest is None or previous != track.manifest:
            track.signed_off = heard_s
        for hash_ in [hash_ for hash_, (at_s, _) in track.heard.items() if at_s < track.older_s]:
            at_s, body = track.heard.pop(hash_)
            if at_s < track.signed_off:
                continue
            if self._policy.full_coverage and any(part[0] >> 4 in DYNAMIC for part in _bodies(body)):
                self._bad(track, Refusal.UNSIGNED, now_s)
            else:
                self._count(track, Refusal.UNSIGNED)


def _type_of(body: bytes) -> int:
    return body[0] >> 4


def _bound(held: dict[bytes, Any], limit: int) -> None:
    """Drop the oldest entries."""
    while len(held) > limit:
        del held[next(iter(held))]


def _split(bodies: bytes) -> tuple[bytes, ...]:
    return tuple(bodies[at : at + SIZE] for at in range(0, len(bodies), SIZE))


def _bodies(body: bytes) -> tuple[bytes, ...]:
    """The single messages of a message or pack."""
    return _split(body[PACK_HEADER:]) if body[0] >> 4 == MessageType.MESSAGE_PACK else (body,)
