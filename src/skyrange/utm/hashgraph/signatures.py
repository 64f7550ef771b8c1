"""Signatures of hashgraph events: Ed25519 keys of the range's own, which follow from its seed and protect nothing
real.
"""

from __future__ import annotations

from functools import lru_cache
from hashlib import blake2b

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from skyrange.utm.hashgraph.events import Event


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
