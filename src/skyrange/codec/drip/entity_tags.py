"""DRIP Entity Tags (DET): identifiers of 128 bits that name a registry and commit to a public key (RFC 9374).

Layout (section 3, figure 1), from the most significant bit: 28 bits of prefix 2001:30::/28, 14 bits RAA, 14 bits HDA,
8 bits suite, 64 bits hash.

Hashes are cSHAKE128 (NIST SP 800-185), here in the two uses of DRIP: the hash in a tag, and the hashes in a Manifest.
"""

from __future__ import annotations

from collections.abc import Iterable
from ipaddress import IPv6Address
from typing import Final, NamedTuple

from Crypto.Hash import cSHAKE128

from skyrange.core.errors import DecodeError

HASH_BYTES: Final = 8
ORCHID_CONTEXT: Final = bytes.fromhex("00b5a69c795df5d5f0087f56843f2c40")
"""The Context ID of HHITs (RFC 9374, section 3)."""
MANIFEST_CONTEXT: Final = b"Remote ID Auth Hash"
"""RFC 9575, section 4.4.3."""


def orchid_hash(header: bytes, key: bytes) -> bytes:
    """The last 8 bytes of an entity tag whose first 8 bytes are `header` (RFC 9374, section 3.5.2).

    HOST_ID is the public key alone, without the curve field of HIP: the example of RFC 9575 (appendix B.2.1) and the
    certificates of RFC 9886 (appendix A) have it so.
    """
    return cSHAKE128.new(data=header + key, custom=ORCHID_CONTEXT).read(HASH_BYTES)


def message_hash(body: bytes) -> bytes:
    """The 8 bytes that stand for a message of 25 bytes, or for a whole pack, in a Manifest.

    The message counter is not part of `body` (RFC 9575, sections 4.4.3.1 and 4.4.3.2).
    """
    return cSHAKE128.new(data=body, custom=MANIFEST_CONTEXT).read(HASH_BYTES)


def pages_hash(bodies: Iterable[bytes]) -> bytes:
    """The hash of an Authentication message: its pages, of 25 bytes each, in the order of their numbers."""
    return message_hash(b"".join(bodies))


PREFIX: Final = 0x2001003
"""The 28 bits of 2001:30::/28 (RFC 9374, section 3.1)."""
EDDSA_CSHAKE128: Final = 5
"""HHIT suite: EdDSA25519 keys, hashed with cSHAKE128 (RFC 9374, section 3.2)."""
TAG_BYTES: Final = 16
KEY_BYTES: Final = 32
"""An Ed25519 public key (RFC 8032, section 5.1.5), called Host Identity by RFC 9374."""
MAX_AUTHORITY: Final = 2**14 - 1
"""The largest RAA and HDA."""
APEX_HID: Final = (0, 0)
"""RAA and HDA of the owner of the prefix."""
RESERVED_HDA_STEP: Final = 4096
"""HDA 0, 4096, 8192 and 12288 are the RAA itself (RFC 9886, section 6.2.1.3)."""
SESSION_KIND_DRIP: Final = 1
"""First byte of a specific session id that is a DRIP entity tag (RFC 9374, section 4)."""
_HEADER_BYTES: Final = TAG_BYTES - HASH_BYTES


class EntityTag(NamedTuple):
    """An entity tag in parts; `bytes_` joins them."""

    raa: int
    """Registered Assigning Authority, 0…16383."""
    hda: int
    """HHIT Domain Authority, 0…16383."""
    suite: int
    hash_: bytes
    """8 bytes."""

    @classmethod
    def of_key(cls, raa: int, hda: int, key: bytes) -> EntityTag:
        """The tag of a public key in a registry; raises `ValueError` for numbers or a key of another size."""
        if not (0 <= raa <= MAX_AUTHORITY and 0 <= hda <= MAX_AUTHORITY):
            raise ValueError(f"RAA {raa}, HDA {hda}: both must be in 0…{MAX_AUTHORITY}")
        if len(key) != KEY_BYTES:
            raise ValueError(f"a public key of {len(key)} bytes, expected {KEY_BYTES}")
        header = _header(raa, hda, EDDSA_CSHAKE128)
        return cls(raa, hda, EDDSA_CSHAKE128, orchid_hash(header, key))

    @classmethod
    def parse(cls, tag: bytes) -> EntityTag:
        """The parts of 16 bytes; raises `DecodeError` if they are no entity tag."""
        if len(tag) != TAG_BYTES:
            raise DecodeError(f"{len(tag)} bytes, an entity tag has {TAG_BYTES}")
        header = int.from_bytes(tag[:_HEADER_BYTES], "big")
        if header >> 36 != PREFIX:
            raise DecodeError(f"{IPv6Address(tag)} is not in 2001:30::/28")
        return cls(header >> 22 & MAX_AUTHORITY, header >> 8 & MAX_AUTHORITY, header & 0xFF, tag[_HEADER_BYTES:])

    @property
    def bytes_(self) -> bytes:
        """The 16 bytes."""
        return _header(self.raa, self.hda, self.suite) + self.hash_

    @property
    def address(self) -> str:
        """The tag as an IPv6 address in print."""
        return str(IPv6Address(self.bytes_))

    @property
    def is_authority(self) -> bool:
        """Whether the HDA number is one of the four that stand for the RAA itself."""
        return self.hda % RESERVED_HDA_STEP == 0

    def commits_to(self, key: bytes) -> bool:
        """Whether the tag is that of `key`: the check that a tag proves itself (RFC 9374, section 4.4)."""
        if self.suite != EDDSA_CSHAKE128 or len(key) != KEY_BYTES:
            return False
        return self.hash_ == orchid_hash(_header(self.raa, self.hda, self.suite), key)


def session_id(tag: bytes) -> str:
    """The 20-byte UAS ID of a tag for a Basic ID of type specific session, as `BasicId.uas_id` has it: latin-1, without
    trailing zeros.
    """
    return (bytes([SESSION_KIND_DRIP]) + tag).rstrip(b"\0").decode("latin-1")


def parse_session_id(uas_id: str) -> bytes | None:
    """The tag in the UAS ID of a specific session; `None` if it holds no DRIP entity tag."""
    raw = uas_id.encode("latin-1", "replace").ljust(20, b"\0")
    if len(raw) != 20 or raw[0] != SESSION_KIND_DRIP or any(raw[1 + TAG_BYTES :]):
        return None
    tag = raw[1 : 1 + TAG_BYTES]
    return tag if int.from_bytes(tag[:4], "big") >> 4 == PREFIX else None


def _header(raa: int, hda: int, suite: int) -> bytes:
    return (PREFIX << 36 | raa << 22 | hda << 8 | suite).to_bytes(_HEADER_BYTES, "big")
