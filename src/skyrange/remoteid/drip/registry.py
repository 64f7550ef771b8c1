"""Registry of the range: the authorities that vouch for keys of aircraft, their keys and their endorsements.

The hierarchy is that of RFC 9374, section 3.3: the owner of the prefix (apex) endorses a Registered Assigning
Authority (RAA), this an HHIT Domain Authority (HDA), and this the aircraft. The numbers are of the range for private
use (RFC 9886, section 6.2.1). Everything follows from the seed.

Keys are those of Ed25519 (RFC 8032), as byte strings, so that what holds them can be copied and compared; they are a
model and protect nothing real.
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
from hashlib import sha256
from typing import Final, NamedTuple

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from skyrange.codec.drip import APEX_HID, EntityTag, Link

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


RANGE_RAA: Final = 15_360
"""The first RAA for private use."""
RANGE_HDA: Final = 1


class Level(IntEnum):
    """Place of a key in the hierarchy."""

    APEX = 0
    RAA = 1
    HDA = 2
    AIRCRAFT = 3


class Anchor(NamedTuple):
    """A key that a receiver trusts before it hears anything."""

    tag: bytes
    key: bytes
    level: Level


class Registration(NamedTuple):
    """What an aircraft holds after registering."""

    identity: Identity
    hda_ua: Link
    """The HDA's endorsement of the aircraft."""
    raa_hda: Link
    apex_raa: Link


def child_level(level: Level, parent: EntityTag, child: EntityTag) -> Level | None:
    """The level of a key that a key of `level` endorses; `None` if it may not.

    RFC 9575 (note in section 1.1) demands the immediate parent in the hierarchy, and a Link does not say what the
    child is. So the place in the chain decides: an aircraft, whose tag has the numbers of its HDA, endorses nobody.
    """
    if level == Level.APEX:
        return Level.RAA if child.is_authority and (child.raa, child.hda) != APEX_HID else None
    if child.raa != parent.raa:
        return None
    if level == Level.RAA:
        return None if child.is_authority else Level.HDA
    if level == Level.HDA:
        return Level.AIRCRAFT if child.hda == parent.hda else None
    return None


class Registry(NamedTuple):
    """The authorities of a range, with the times within which their endorsements hold."""

    seed: int
    apex: Identity
    raa: Identity
    hda: Identity
    vnb_s: int
    """Seconds since 2019-01-01T00:00:00Z, as all times here."""
    vna_s: int

    @classmethod
    def of_seed(
        cls, seed: int, vnb_s: int, vna_s: int, *, raa: int = RANGE_RAA, hda: int = RANGE_HDA, name: str = "registry"
    ) -> Registry:
        """The registry of a scenario; another `name` gives another registry, whose keys nobody trusts."""
        apex, assigning, domain = (
            Identity.of_secret(range_secret(seed, f"{name}/{party}"), *numbers)
            for party, numbers in (("apex", APEX_HID), ("raa", (raa, 0)), ("hda", (raa, hda)))
        )
        return cls(seed, apex, assigning, domain, vnb_s, vna_s)

    @property
    def anchors(self) -> tuple[Anchor, ...]:
        """What receivers are configured with: the apex alone. A receiver may hold more of `known`."""
        return self.known[:1]

    @property
    def known(self) -> tuple[Anchor, ...]:
        """All authorities, as a receiver has them that looked them up before the flight."""
        return (
            Anchor(self.apex.tag, self.apex.key, Level.APEX),
            Anchor(self.raa.tag, self.raa.key, Level.RAA),
            Anchor(self.hda.tag, self.hda.key, Level.HDA),
        )

    def register(self, name: str) -> Registration:
        """The key, tag and endorsements of an aircraft; the same for the same name."""
        tag = EntityTag.parse(self.hda.tag)
        identity = Identity.of_secret(range_secret(self.seed, f"aircraft/{name}"), tag.raa, tag.hda)
        return Registration(
            identity,
            endorse(self.hda, identity, self.vnb_s, self.vna_s),
            endorse(self.raa, self.hda, self.vnb_s, self.vna_s),
            endorse(self.apex, self.raa, self.vnb_s, self.vna_s),
        )


def endorse(parent: Identity, child: Identity, vnb_s: int, vna_s: int) -> Link:
    """The Link in which `parent` vouches for `child`. Whether it may is for receivers to decide."""
    draft = Link(vnb_s, vna_s, child.tag, child.key, parent.tag)
    return draft._replace(signature=sign(parent.secret, draft.signed))
