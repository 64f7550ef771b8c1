"""Verdicts of a DRIP receiver: its settings, its rules, states of senders, refusals, and whom it believes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Final, Literal, NamedTuple

from pydantic import Field

from skyrange.contracts.params import Number

if TYPE_CHECKING:  # keys are slow to import, and scenarios need the settings alone
    from skyrange.remoteid.drip.registry import Anchor

Authorities = Annotated[
    Literal["apex", "all"],
    Field(
        description="Keys that the receiver holds before the flight. apex: the root alone, so that it has to receive "
        "the Links of all authorities; all: those of all authorities of the range."
    ),
]
ClockError = Annotated[
    Number,
    Field(
        ge=-2,
        le=120,
        description="Error of the receiver's clock in seconds, positive when it is ahead. Outside these limits, every "
        "signature would be out of its time: it holds for 120 s, and clocks may differ by 2 s.",
    ),
]
VerificationRate = Annotated[
    Annotated[Number, Field(ge=1, le=100_000)] | None,
    Field(
        description="Signatures that the receiver can verify per second; what exceeds that is dropped. Default: no "
        "limit."
    ),
]


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
    """Right and wrong ones, or a message that the key's owner demonstrably did not sign (Questionable).
    Several use this address. What is verified of it is the key owner's all the same."""


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
    SHARED_ADDRESS = "another key signs under the same address"
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


class Judged(NamedTuple):
    """What a receiver makes of something received."""

    verified: tuple[Verified, ...] = ()
    """What is verified by it: itself, or what was received before it."""
    is_replayed: bool = False
    """Whether it is a Location that a trusted key signed longer ago, so that it is no longer true."""


class Acceptance(StrEnum):
    """What is believed; each member believes less than the one before it."""

    ACCEPT = "accept"
    """Everything; verdicts are recorded only."""
    IGNORE_FORGED = "ignore-forged"
    """Not what was refused, replayed or contradicted."""
    IGNORE_UNSIGNED = "ignore-unsigned"
    """Nor senders without a signature of their own. One that cannot be verified yet is believed."""
    IGNORE_UNVERIFIED = "ignore-unverified"
    """Only senders of a recent verified Location or System message."""


_FORGED: Final = frozenset((Trust.REFUSED, Trust.REPLAYED, Trust.CONTRADICTED))
# Anybody can claim a tag and repeat the Links of its owner, so a trusted key alone counts as unsigned.
_UNSIGNED: Final = frozenset((Trust.NONE, Trust.PARTIAL, Trust.UNSUPPORTED, Trust.TRUSTED_KEY))


def accepts(acceptance: Acceptance, trust: Trust) -> bool:
    """Whether a sender in a state of trust is believed."""
    if acceptance is Acceptance.ACCEPT:
        return True
    if acceptance is Acceptance.IGNORE_UNVERIFIED:
        return trust is Trust.VERIFIED
    return trust not in _FORGED and (acceptance is Acceptance.IGNORE_FORGED or trust not in _UNSIGNED)


class Verification(NamedTuple):
    """How one receiver verifies, and whom it believes."""

    anchors: tuple[Anchor, ...]
    acceptance: Acceptance = Acceptance.ACCEPT
    judges: Policy = Policy()
    clock_error_s: float = 0.0
    """Of the receiver's clock, positive when it is ahead."""

    @classmethod
    def of(
        cls, anchors: Sequence[Anchor], policy: str, clock_error_s: float, verifications_per_s: float | None
    ) -> Verification:
        """That of a receiver with these settings; `policy` is an `Acceptance`."""
        limit = math.inf if verifications_per_s is None else verifications_per_s
        return cls(tuple(anchors), Acceptance(policy), Policy(verifications_per_s=limit), clock_error_s)
