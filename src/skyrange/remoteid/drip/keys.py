"""Ed25519 keys (RFC 8032) as byte strings, so that what holds them can be copied and compared.

Keys follow from the seed of a scenario: they are a model and protect nothing real.
"""

from __future__ import annotations

from functools import lru_cache
from hashlib import sha256
from typing import Final, NamedTuple

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from skyrange.codec.drip import EntityTag

CACHED_KEYS: Final = 4096
"""Key objects kept ready, by their bytes. The cache changes no result."""


class Identity(NamedTuple):
    """A key pair and its entity tag."""

    secret: bytes
    """32 bytes."""
    key: bytes
    """32 bytes, public."""
    tag: bytes
    """16 bytes."""

    @classmethod
    def of_secret(cls, secret: bytes, raa: int, hda: int) -> Identity:
        """The identity of a private key in a registry; raises `ValueError` for bad sizes or numbers."""
        key = public_key(secret)
        return cls(secret, key, EntityTag.of_key(raa, hda, key).bytes_)


def range_secret(seed: int, name: str) -> bytes:
    """The private key of a party of the range."""
    return sha256(f"skyrange/drip/{seed}/{name}".encode()).digest()


def public_key(secret: bytes) -> bytes:
    """The public key of a private one."""
    return _private(secret).public_key().public_bytes_raw()


def sign(secret: bytes, message: bytes) -> bytes:
    """The signature, 64 bytes; the same for the same input (RFC 8032, section 5.1.6)."""
    return _private(secret).sign(message)


def verify(key: bytes, signature: bytes, message: bytes) -> bool:
    """Whether `signature` is that of `message` by the owner of `key`; any bytes may be given."""
    try:
        _public(key).verify(signature, message)
    except (InvalidSignature, ValueError):
        return False
    return True


@lru_cache(CACHED_KEYS)
def _private(secret: bytes) -> Ed25519PrivateKey:
    return Ed25519PrivateKey.from_private_bytes(secret)


@lru_cache(CACHED_KEYS)
def _public(key: bytes) -> Ed25519PublicKey:
    return Ed25519PublicKey.from_public_bytes(key)
