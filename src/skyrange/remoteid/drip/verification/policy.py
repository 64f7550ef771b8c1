"""Policy towards Remote ID senders: which states of authentication a receiver believes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Final, NamedTuple

from skyrange.remoteid.drip.registry import Anchor
from skyrange.remoteid.drip.verification.verdicts import Policy, Trust


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
        """That of a receiver with these settings (`verification.settings`); `policy` is an `Acceptance`."""
        limit = math.inf if verifications_per_s is None else verifications_per_s
        return cls(tuple(anchors), Acceptance(policy), Policy(verifications_per_s=limit), clock_error_s)
