"""Events of a hashgraph: what a member signs, its bytes, and its hash.

An event names its creator, the creator's event before it (self-parent), the newest event of the member that it has just
heard from (other-parent), the creator's time, and transactions, which are bytes to the consensus (Baird, The Swirlds
Hashgraph Consensus Algorithm, 2016, ch. 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Final

from skyrange.core.time import Time

HASH_BYTES: Final = 32
NO_PARENT: Final = b""
_DOMAIN: Final = b"skyrange.hashgraph.event/1"


@dataclass(frozen=True, slots=True)
class Event:
    """One event. The first event of a member has no parents; every other has both."""

    creator: str
    self_parent: bytes
    other_parent: bytes
    time: Time
    transactions: tuple[bytes, ...] = ()
    signature: bytes = b""
    """Of `signed_bytes`, Ed25519."""
    hash: bytes = field(init=False, repr=False, compare=False)
    """BLAKE2b of all of it, 32 bytes."""

    def __post_init__(self) -> None:
        content = self.signed_bytes + _sized(self.signature)
        object.__setattr__(self, "hash", blake2b(content, digest_size=HASH_BYTES).digest())

    @property
    def signed_bytes(self) -> bytes:
        """What the creator signs: every field but the signature, each with its length."""
        parts: Sequence[bytes] = (
            self.creator.encode(),
            self.self_parent,
            self.other_parent,
            self.time.to_bytes(8, "big", signed=True),
            *self.transactions,
        )
        return _DOMAIN + b"".join(map(_sized, parts))


def _sized(part: bytes) -> bytes:
    return len(part).to_bytes(4, "big") + part
