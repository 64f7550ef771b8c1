"""Sender side of DRIP: one aircraft's authentication messages, signed when they are asked for."""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil
from typing import Final

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
from skyrange.core.time import NS_PER_S, Time
from skyrange.remoteid.drip.keys import range_secret, sign
from skyrange.remoteid.drip.registry import Registration
from skyrange.remoteid.drip.schedule import REQUIRED, Kind, Rates, Schedule

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
