"""Sender side of DRIP: one aircraft's credentials, its schedule, and its messages, signed when they are asked for."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from math import ceil, inf
from typing import Final, NamedTuple

from skyrange.codec.drip import (
    HASH_BYTES,
    RECOMMENDED_HASHES,
    Evidence,
    Link,
    SamMessage,
    SamType,
    encode_manifest,
    encode_sam,
    encode_wrapped,
    link_hash,
    message_hash,
    split_with_parity,
)
from skyrange.codec.drip.messages import manifest_evidence
from skyrange.codec.f3411 import Authentication, MessageType
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.remoteid.drip.registry import Registration, range_secret, sign

PAGE_NS: Final[Time] = 35 * NS_PER_MS
"""Time between two frames with authentication pages of one aircraft: three times the longest message, eleven pages,
takes 1.2 s."""


class Kind(StrEnum):
    """An authentication message by its content."""

    HDA_UA = "link: HDA on UA"
    MANIFEST = "manifest"
    WRAPPER = "wrapper"
    RAA_HDA = "link: RAA on HDA"
    APEX_RAA = "link: apex on RAA"


class Rates(NamedTuple):
    """Longest times between two messages of a kind, s; `inf` leaves a kind out."""

    hda_ua_s: float = 60.0
    evidence_s: float = 5.0
    """Of messages with something that was signed now: Manifests here."""
    raa_hda_s: float = 300.0
    apex_raa_s: float = 300.0


REQUIRED: Final = Rates()
"""The longest times that RFC 9575, section 6.3, allows."""
RECOMMENDED: Final = Rates(hda_ua_s=16.0, evidence_s=1.0, raa_hda_s=32.0, apex_raa_s=64.0)
"""About as often as in appendix B.2, without its order: a Manifest every second, a Link every 8 s."""


class Schedule:
    """What is due. It sends and signs nothing: `done` says that a message went out."""

    __slots__ = ("_due_ns", "_period_ns")

    def __init__(self, rates: Rates = REQUIRED, start_ns: Time = 0) -> None:
        periods_s = {
            Kind.HDA_UA: rates.hda_ua_s,
            Kind.MANIFEST: rates.evidence_s,
            Kind.RAA_HDA: rates.raa_hda_s,
            Kind.APEX_RAA: rates.apex_raa_s,
        }
        self._period_ns = {kind: round(period_s * NS_PER_S) for kind, period_s in periods_s.items() if period_s != inf}
        self._due_ns = dict.fromkeys(self._period_ns, start_ns)

    def due(self, next_ns: Time, pending: int) -> tuple[Kind, ...]:
        """Kinds whose longest time ends before `next_ns`, the next time at which they could be sent; the longest
        overdue first.

        A Manifest is due with any of the `pending` messages that none has covered yet, and early where these fill it.
        """
        ready = [
            (due_ns, order, kind)
            for order, (kind, due_ns) in enumerate(self._due_ns.items())
            if (due_ns < next_ns and (kind != Kind.MANIFEST or pending > 0))
            or (kind == Kind.MANIFEST and pending >= RECOMMENDED_HASHES)
        ]
        return tuple(kind for _, _, kind in sorted(ready))

    def done(self, kind: Kind, at_ns: Time) -> None:
        """A message of `kind` was sent."""
        if kind in self._due_ns:
            self._due_ns[kind] = at_ns + self._period_ns[kind]


class Credentials(NamedTuple):
    """What an aircraft signs with, and how often."""

    registration: Registration
    rates: Rates = REQUIRED
    seed: int = 0
    """Of the number in its first Manifest."""
    repeats: int = 1
    """How often a message is sent over Bluetooth 4, all of its pages in a row, under one counter."""


VALIDITY_S: Final = 120
"""From signing to "valid not after" (RFC 9575, section 3.2.4.3: 2 minutes is reasonable)."""
MAX_PENDING: Final = 64
"""Messages that wait for a Manifest; the oldest are given up."""

Pages = tuple[Authentication, ...]


class Sender:
    """What an aircraft needs to authenticate its broadcasts. Tell it with `sent` what was broadcast."""

    __slots__ = ("_link", "_pending", "_previous", "legacy", "registration", "schedule", "validity_s")

    def __init__(
        self, registration: Registration, *, legacy: bool, rates: Rates = REQUIRED, start_ns: Time = 0,
        validity_s: int = VALIDITY_S, seed: int = 0,
    ) -> None:  # fmt: skip
        """`legacy`: Bluetooth 4, whose messages have a parity page. `seed`: of the number in the first Manifest."""
        self.registration = registration
        self.legacy = legacy
        self.validity_s = validity_s
        self.schedule = Schedule(rates, start_ns)
        self._link = link_hash(registration.hda_ua)
        self._previous = range_secret(seed, f"nonce/{registration.identity.tag.hex()}")[:HASH_BYTES]
        self._pending: dict[bytes, None] = {}

    @property
    def pending(self) -> int:
        """Different messages that were sent and are in no Manifest yet."""
        return len(self._pending)

    def sent(self, body: bytes) -> None:
        """A message of 25 bytes or a pack was broadcast. Authentication pages carry signatures and are not covered."""
        if body[0] >> 4 != MessageType.AUTHENTICATION:
            self._pending[message_hash(body)] = None
            while len(self._pending) > MAX_PENDING:
                del self._pending[next(iter(self._pending))]

    def due(self, next_ns: Time) -> tuple[Kind, ...]:
        """What has to be sent now, where the next time to send is `next_ns` (`Schedule.due`)."""
        return self.schedule.due(next_ns, self.pending)

    def make(self, kind: Kind, now_s: float) -> Pages:
        """The pages of a Link or of the next Manifest, and the note that they are sent (`message`)."""
        return self._pages(self.message(kind, round(now_s * NS_PER_S), now_s), now_s)

    def message(self, kind: Kind, at_ns: Time, clock_s: float) -> SamMessage:
        """A Link or the next Manifest, and the note that it is sent.

        `at_ns` is the time of the schedule, `clock_s` the UTC that is signed, in seconds since 2019: a clock that jumps
        does not stop the schedule. A Manifest takes the ten oldest messages that none has covered. For Wrappers
        there is `wrapper`.
        """
        if kind == Kind.WRAPPER:
            raise ValueError("a Wrapper needs the messages that it wraps: call `wrapper`")
        message: SamMessage = self._manifest(clock_s) if kind == Kind.MANIFEST else self._endorsement(kind)
        self.schedule.done(kind, at_ns)
        return message

    def wrapper(self, bodies: Iterable[bytes], now_s: float) -> Pages:
        """A Wrapper of up to four messages. They have to be sent in the clear as well (RFC 9575, section 6.4.1)."""
        return self._pages(self._signed(SamType.WRAPPER, encode_wrapped(list(bodies)), now_s), now_s)

    def pack_wrapper(self, bodies: Iterable[bytes], now_s: float) -> Pages:
        """The Wrapper that signs the other messages of its pack, in the order of types, without repeating them."""
        signed = self._signed(SamType.WRAPPER, encode_wrapped(list(bodies)), now_s)
        return self._pages(signed._replace(evidence=b""), now_s, parity=False)

    def _endorsement(self, kind: Kind) -> Link:
        links = {Kind.HDA_UA: self.registration.hda_ua, Kind.RAA_HDA: self.registration.raa_hda}
        return links.get(kind, self.registration.apex_raa)

    def _manifest(self, now_s: float) -> Evidence:
        covered = list(self._pending)[:RECOMMENDED_HASHES]
        manifest = encode_manifest(self._previous, self._link, covered)
        self._previous = manifest.current
        for hash_ in covered:
            del self._pending[hash_]
        return self._signed(SamType.MANIFEST, manifest_evidence(manifest), now_s)

    def _signed(self, sam_type: SamType, evidence: bytes, now_s: float) -> Evidence:
        who, vnb_s = self.registration.identity, ceil(now_s)  # never before the signature is made (section 3.2.4.3)
        draft = Evidence(sam_type, vnb_s, vnb_s + self.validity_s, evidence, who.tag)
        return draft._replace(signature=sign(who.secret, draft.signed()))

    def _pages(self, message: SamMessage, now_s: float, *, parity: bool | None = None) -> Pages:
        return split_with_parity(encode_sam(message), int(now_s), parity=self.legacy if parity is None else parity)
