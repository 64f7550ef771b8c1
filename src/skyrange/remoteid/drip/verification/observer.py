"""Receiver side of DRIP: whose key is trusted, which messages that key signed, and what contradicts them.

One `Observer` follows every sender it hears, without a network: it starts from the keys it was configured with and
learns others from Links. It is meant for hostile air. Whatever is received, it raises nothing, counts what it refuses,
holds a bounded amount, and verifies no signature twice. That a message is verified says who signed it, and never that
it is true (RFC 9575, section 3.1.2.2).

Addresses can be forged, so a signature belongs to its tag and a verdict on an address discredits no message that is
verified: states "can apply to either a single authentication message, a DET (…), and/or a sender" (appendix A).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from hashlib import sha256
from typing import Final, NamedTuple

from skyrange.codec.drip import (
    Evidence,
    Link,
    SamType,
    UnsupportedMethodError,
    decode_manifest,
    decode_sam,
    decode_wrapped,
    message_hash,
    parse_session_id,
)
from skyrange.codec.f3411 import (
    Authentication,
    AuthType,
    BasicId,
    IdType,
    Location,
    MessagePack,
    MessageType,
    Status,
    decode,
)
from skyrange.codec.f3411.authentication import join_pages
from skyrange.core.errors import DecodeError
from skyrange.remoteid.drip.registry import Anchor, verify
from skyrange.remoteid.drip.verification.endorsed_keys import EndorsedKey, EndorsedKeys, Signed, SignedMessages
from skyrange.remoteid.drip.verification.observed_sender import (
    MAX_HEARD,
    MAX_WAITING,
    ObservedSender,
    bodies_of,
    bound,
    is_dynamic,
    split_bodies,
)
from skyrange.remoteid.drip.verification.verdicts import Judged, Policy, Refusal, Track, Trust, Verified

MAX_TRACKS: Final = 64
"""Senders followed at once, as in track tables; the one heard longest ago makes room."""
MAX_SEEN: Final = 1024
"""Digests of messages already judged."""
MAX_FIRST: Final = 4096
"""Locations whose first reception is remembered, as many as hashes in `signed_messages`."""
_HALF_HOUR_S: Final = 1800.0
"""Times of Locations count from the full hour, so the bytes of a parked aircraft may return after one."""
_FAILURE: Final = int(Status.REMOTE_ID_SYSTEM_FAILURE)


class _Case(NamedTuple):
    """A broadcast that is judged: its sender, when it was received, and the messages verified by it so far."""

    address: int
    track: ObservedSender
    now_s: float
    verified: list[Verified]


class Observer:
    """A receiver that verifies. Times are seconds since 2019-01-01T00:00:00Z by its own clock, and never decrease."""

    __slots__ = (
        "_first",
        "_keys",
        "_newest",
        "_policy",
        "_seen",
        "_signed",
        "_tokens",
        "_tokens_s",
        "_tracks",
        "counts",
        "work",
    )

    def __init__(self, anchors: Iterable[Anchor], policy: Policy = Policy()) -> None:  # noqa: B008 (immutable)
        self._policy = policy
        self._keys = EndorsedKeys(anchors, policy)
        self._newest: dict[bytes, tuple[int, float]] = {}  # by tag: when it signed last, and when that was received
        self._seen: dict[bytes, None] = {}
        self._signed = SignedMessages()
        self._first: dict[bytes, float] = {}  # when Locations were first received, by hash
        self._tokens = policy.verification_burst
        self._tokens_s = 0.0
        self._tracks: dict[int, ObservedSender] = {}
        self.counts: Counter[Refusal] = Counter()
        self.work = 0
        """Signatures verified."""

    def receive(self, address: int, counter: int, body: bytes, now_s: float) -> Judged:
        """Take a received message or pack, with its sender address and counter."""
        track = self._track(address, now_s)
        case = _Case(address, track, now_s, [])
        is_replayed = False
        try:
            message = decode(body)
        except DecodeError:
            self._count(track, Refusal.MALFORMED)
            return Judged()
        if isinstance(message, MessagePack):
            is_replayed = self._pack(case, message, body)
        elif isinstance(message, Authentication):
            if message.auth_type != AuthType.SPECIFIC_METHOD:
                track.unsupported = True
                self._count(track, Refusal.UNSUPPORTED)
            elif (data := track.pages.add(counter, message, now_s)) is not None:
                self._sam(case, data, b"")
        else:
            if isinstance(message, BasicId) and (tag := _claimed(message)) is not None:
                track.claim(tag)
            is_replayed = self._remember(case, body, is_timed=_is_timed(message))
        return Judged(tuple(case.verified), is_replayed)

    def track(self, address: int, now_s: float) -> Track | None:
        """The track of a sender; `None` if it is not followed."""
        sender = self._tracks.get(address)
        if sender is None:
            return None
        return Track(
            address, self._state(sender, now_s), sender.tag or sender.claimed, sender.first_s, sender.verified_at_s,
            sender.verified, dict(sender.counts),
        )  # fmt: skip

    def tracks(self, now_s: float) -> tuple[Track, ...]:
        """All tracks, in the order of their first broadcasts."""
        return tuple(track for address in self._tracks if (track := self.track(address, now_s)) is not None)

    def addresses_of(self, tag: bytes) -> tuple[int, ...]:
        """The senders whose newest accepted evidence `tag` signed: several transports of one aircraft, or a relay."""
        return tuple(address for address, track in self._tracks.items() if track.tag == tag)

    def trusts(self, tag: bytes, now_s: float) -> bool:
        """Whether a chain of endorsements leads to the key of `tag`."""
        return self._keys.valid(tag, now_s) is not None

    def _track(self, address: int, now_s: float) -> ObservedSender:
        track = self._tracks.get(address)
        if track is None:
            if len(self._tracks) >= MAX_TRACKS:
                del self._tracks[min(self._tracks, key=lambda key: self._tracks[key].last_s)]
                self.counts[Refusal.NO_ROOM] += 1
            track = self._tracks[address] = ObservedSender(now_s)
        track.last_s = now_s
        return track

    def _state(self, track: ObservedSender, now_s: float) -> Trust:
        policy = self._policy
        was_verified = track.good_s is not None
        if track.bad_s is not None and now_s - track.bad_s <= policy.memory_s:
            return Trust.CONTRADICTED if was_verified else Trust.REFUSED
        # whoever repeats old messages under an address, what was lately verified there is still the owner's
        since_s = float("inf") if track.confirmed_s is None else now_s - track.confirmed_s
        if since_s <= policy.fresh_s:
            return Trust.VERIFIED
        replayed_s = track.replayed_s
        is_replayed = replayed_s is not None and (track.good_s or 0.0) <= replayed_s >= now_s - policy.memory_s
        if is_replayed and since_s > policy.memory_s:
            return Trust.REPLAYED
        if track.confirmed_s is not None:
            return Trust.STALE
        tag = track.tag or track.claimed
        if tag is not None and self._keys.valid(tag, now_s) is not None:
            return Trust.TRUSTED_KEY
        if track.waiting:
            return Trust.UNVERIFIED
        if track.unsupported:
            return Trust.UNSUPPORTED
        return Trust.PARTIAL if track.pages.is_waiting else Trust.NONE

    def _count(self, track: ObservedSender, refusal: Refusal, times: int = 1) -> None:
        track.counts[refusal] += times
        self.counts[refusal] += times

    def _bad(self, track: ObservedSender, refusal: Refusal, now_s: float) -> None:
        self._count(track, refusal)
        track.bad_s = now_s

    def _remember(self, case: _Case, body: bytes, *, is_timed: bool) -> bool:
        """Hold a message for a Manifest; returns whether it is replayed.

        `is_timed` says whether it has a Location with a time: its sender does not repeat it (RFC 9575, 9.1: it is
        "nonce-like").
        """
        track, now_s = case.track, case.now_s
        hash_ = message_hash(body)
        first_s = now_s
        if is_timed:
            first_s = self._first.setdefault(hash_, now_s)
            bound(self._first, MAX_FIRST)
        signed = self._signed.find(hash_)
        if signed is not None and now_s - signed.heard_s <= self._policy.overlap_s:
            self._confirm(case, signed.tag, body, now_s)  # repeated after its Manifest
            return False
        track.heard.setdefault(hash_, (now_s, body))
        bound(track.heard, MAX_HEARD)
        signs = track.tag is not None or bool(track.waiting)
        is_copy = signs and self._policy.overlap_s < now_s - first_s < _HALF_HOUR_S
        if not is_timed or (signed is None and not is_copy):
            return False
        self._count(track, Refusal.REPLAYED)
        return True

    def _confirm(self, case: _Case, tag: bytes, body: bytes, heard_s: float) -> None:
        track = case.track
        track.verified += 1
        case.verified.append(Verified(case.address, tag, body, heard_s))
        if is_dynamic(body):
            track.confirmed_s = case.now_s
            if track.verified_at_s is None:
                track.verified_at_s = case.now_s

    def _pack(self, case: _Case, pack: MessagePack, body: bytes) -> bool:
        """Judge a pack; returns whether it is replayed."""
        track = case.track
        pages = [part for part in pack.messages if isinstance(part, Authentication)]
        is_timed = any(_is_timed(part) for part in pack.messages)
        for part in pack.messages:
            if isinstance(part, BasicId) and (tag := _claimed(part)) is not None:
                track.claim(tag)
        if not pages:
            return self._remember(case, body, is_timed=is_timed)
        if any(page.auth_type != AuthType.SPECIFIC_METHOD for page in pages):
            track.unsupported = True
            self._count(track, Refusal.UNSUPPORTED)
            return False
        other_messages = [part for part in bodies_of(body) if part[0] >> 4 != MessageType.AUTHENTICATION]
        try:
            data = join_pages(pages)
        except DecodeError:
            self._count(track, Refusal.MALFORMED)
            return False
        other_messages.sort(key=_type_of)
        signs_pack = self._sam(case, data, b"".join(other_messages))
        if other_messages and not signs_pack:
            return self._remember(case, body, is_timed=is_timed)
        return False

    def _sam(self, case: _Case, data: bytes, other_messages: bytes) -> bool:
        """Judge authentication data; returns whether they sign what is beside them in a pack."""
        try:
            message = decode_sam(data)
        except UnsupportedMethodError:
            case.track.unsupported = True
            self._count(case.track, Refusal.UNSUPPORTED)
        except DecodeError:
            self._count(case.track, Refusal.MALFORMED)
        else:
            if isinstance(message, Link):
                self._link(case, message)
            else:
                self._evidence(case, message, other_messages, case.now_s)
                return message.signs_pack
        return False

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
        bound(self._seen, MAX_SEEN)
        return True

    def _link(self, case: _Case, link: Link) -> None:
        now_s = case.now_s
        verdict = self._keys.take(link, case.address, now_s, lambda: self._affords(now_s))
        if verdict.refusal is not None:
            self._count(case.track, verdict.refusal)
        if verdict.is_false:
            case.track.bad_s = now_s
        if verdict.endorsed is not None:
            self._adopt(verdict.endorsed, now_s, case.verified)

    def _adopt(self, tag: bytes, now_s: float, verified: list[Verified]) -> None:
        """Judge what waited for the key of `tag`, each on the account of its own sender."""
        for link, address in self._keys.orphans_of(tag):
            self._link(_Case(address, self._tracks.get(address) or ObservedSender(now_s), now_s, verified), link)
        for address, track in list(self._tracks.items()):
            ready = [entry for entry in track.waiting if entry[0].tag == tag]
            if ready:
                track.waiting = [entry for entry in track.waiting if entry[0].tag != tag]
                case = _Case(address, track, now_s, verified)
                for evidence, other_messages, heard_s in ready:
                    self._evidence(case, evidence, other_messages, heard_s)

    def _evidence(self, case: _Case, evidence: Evidence, other_messages: bytes, heard_s: float) -> None:
        """Judge evidence received at `heard_s`, perhaps later than that."""
        address, track, now_s, _ = case
        policy, vnb_s, vna_s = self._policy, evidence.vnb_s, evidence.vna_s
        signed = evidence.signed(other_messages)
        digest = sha256(b"%d/" % address + signed + evidence.signature).digest()
        if digest in self._seen:
            return
        endorsed_key = self._keys.valid(evidence.tag, now_s)
        if endorsed_key is None:
            track.waiting.append((evidence, other_messages, heard_s))
            del track.waiting[:-MAX_WAITING]
            return
        if not self._affords(now_s):
            self._count(track, Refusal.OVER_BUDGET)
            return
        self._is_new(digest)
        if not verify(endorsed_key.key, evidence.signature, signed):
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
        newest_s, since_s = self._newest.get(evidence.tag, (vnb_s, heard_s))
        if vnb_s + policy.overlap_s < newest_s or (vnb_s <= newest_s and heard_s > since_s + policy.overlap_s):
            self._count(track, Refusal.REPLAYED)
            track.replayed_s = now_s
            return
        if vnb_s > newest_s or evidence.tag not in self._newest:
            self._newest[evidence.tag] = (vnb_s, heard_s)
        # others may claim other tags under this address; its own tag is claimed, or has signed here before
        if track.claims and evidence.tag not in track.claims and evidence.tag != track.tag:
            self._bad(track, Refusal.WRONG_TAG, now_s)
            return
        self._accept(case, evidence, endorsed_key, other_messages, heard_s)

    def _accept(
        self, case: _Case, evidence: Evidence, endorsed_key: EndorsedKey, other_messages: bytes, heard_s: float
    ) -> None:
        """Credit a track with evidence whose signature and times are right."""
        track, now_s = case.track, case.now_s
        tag = evidence.tag
        statement = Signed(tag, evidence.vnb_s, heard_s)
        if evidence.sam_type == SamType.MANIFEST:
            manifest = decode_manifest(evidence.evidence)
            if manifest.current != manifest.own_hash:
                self._bad(track, Refusal.WRONG_HASH, now_s)
                return
            signed = [track.heard[hash_][1] for hash_ in manifest.messages if hash_ in track.heard]
            if any(_claims_other(body, tag) for body in signed):
                self._bad(track, Refusal.WRONG_TAG, now_s)
                return
            if endorsed_key.link and manifest.link != endorsed_key.link:
                self._count(track, Refusal.OTHER_LINK)
            track.tag, track.good_s = tag, now_s
            for hash_ in manifest.messages:
                first_s = self._signed.take(hash_, statement).heard_s
                if heard_s - first_s <= self._policy.overlap_s and (heard := track.heard.pop(hash_, None)) is not None:
                    self._confirm(case, tag, heard[1], heard[0])
            if track.is_shared(tag, heard_s, self._policy):
                self._bad(track, Refusal.SHARED_ADDRESS, now_s)
            chain = track.chain(tag)
            unsigned, is_forged = track.find_unsigned(chain, manifest.previous, heard_s, self._policy, self._signed)
            if unsigned:
                self._count(track, Refusal.UNSIGNED, unsigned)
            if is_forged:
                track.bad_s = now_s
            chain.add(manifest.current, heard_s)
            return
        track.tag, track.good_s = tag, now_s
        if evidence.sam_type == SamType.WRAPPER:
            bodies = decode_wrapped(evidence.evidence) if evidence.evidence else split_bodies(other_messages)
            for body in bodies:
                first_s = self._signed.take(message_hash(body), statement).heard_s
                if heard_s - first_s <= self._policy.overlap_s:
                    # not taken from `heard`: the Manifests that follow cover it too
                    self._confirm(case, tag, body, heard_s)


def _claimed(basic_id: BasicId) -> bytes | None:
    """The tag that a Basic ID claims; `None` if it claims none."""
    return parse_session_id(basic_id.uas_id) if basic_id.id_type == IdType.SPECIFIC_SESSION else None


def _claims_other(body: bytes, tag: bytes) -> bool:
    """Whether a message or pack claims another tag than this one, and not this one too."""
    basic_ids = [decode(part) for part in bodies_of(body) if part[0] >> 4 == MessageType.BASIC_ID]
    claimed = {_claimed(basic_id) for basic_id in basic_ids if isinstance(basic_id, BasicId)} - {None}
    return bool(claimed) and tag not in claimed


def _is_timed(part: object) -> bool:
    """Whether a message is a Location that says when it was measured.

    One whose Remote ID fails repeats its last position (F3411-22a, status 4).
    """
    return isinstance(part, Location) and part.timestamp_s is not None and part.status != _FAILURE


def _type_of(body: bytes) -> int:
    return body[0] >> 4
