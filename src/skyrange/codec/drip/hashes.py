"""cSHAKE128 (NIST SP 800-185) in the two uses of DRIP: the hash in an entity tag, and the hashes in a Manifest."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from Crypto.Hash import cSHAKE128

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
