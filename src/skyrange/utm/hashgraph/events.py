"""Events of a hashgraph: what a member signs, its bytes, its hash, and its signature.

An event names its creator, the creator's event before it (self-parent), the newest event of the member that it has just
heard from (other-parent), the creator's time, and transactions, which are bytes to the consensus (Baird, The Swirlds
Hashgraph Consensus Algorithm, 2016, ch. 4).

The keys (Ed25519) are the range's own: they follow from its seed and protect nothing real.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b
from typing import Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

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


def secret_of(seed: int, member: str) -> bytes:
    """The private key of a member, 32 bytes."""
    return blake2b(f"hashgraph {member}".encode(), key=seed.to_bytes(16, "big", signed=True), digest_size=32).digest()


@lru_cache(maxsize=1_024)
def _private(secret: bytes) -> Ed25519PrivateKey:
    return Ed25519PrivateKey.from_private_bytes(secret)


@lru_cache(maxsize=1_024)
def public_of(secret: bytes) -> bytes:
    """The public key of a private one, 32 bytes."""
    return _private(secret).public_key().public_bytes_raw()


def sign(event: Event, secret: bytes) -> Event:
    """The event with its signature."""
    signature = _private(secret).sign(event.signed_bytes)
    return Event(event.creator, event.self_parent, event.other_parent, event.time, event.transactions, signature)


@lru_cache(maxsize=16_384)
def _verify(public: bytes, signature: bytes, content: bytes) -> bool:
    try:
        Ed25519PublicKey.from_public_bytes(public).verify(signature, content)
    except InvalidSignature:
        return False
    return True


def is_signed(event: Event, public: bytes) -> bool:
    """Whether the event was signed with the private key of `public`. Members that share a process verify it once."""
    return _verify(public, event.signature, event.signed_bytes)
