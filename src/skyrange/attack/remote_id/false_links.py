"""DRIP Links that a registry never signed: well-formed, and refused only once their signature has been verified."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha512
from typing import Final

from skyrange.codec.f3411 import EPOCH_2019_S, MessagePack, encode
from skyrange.core.time import NS_PER_S, Epoch, Time

VALIDITY_S: Final = 3600
"""From a Link's "valid not before", as long before now, to its "valid not after", as long after."""


@dataclass(frozen=True, slots=True)
class FalseLinks:
    """Links in which the root of a registry seems to endorse authorities, each with a key of its own."""

    name: str
    """Others have other keys."""
    root_tag: bytes
    epoch: Epoch

    def encode(self, number: int, start: Time, now: Time, *, same: bool) -> bytes:
        """A pack with a Link, dated `now`: the one of a number, or the `same` each time, valid around the start."""
        from skyrange.codec.drip import EntityTag, Link, encode_sam, split_with_parity  # slow, and few runs need it
        from skyrange.remoteid.drip.registry import RANGE_RAA

        noise = sha512(f"{self.name}/{0 if same else number}".encode()).digest()
        key, now_s = noise[:32], (self.epoch.unix_ns + now) // NS_PER_S - EPOCH_2019_S
        since_s = start // NS_PER_S + self.epoch.unix_ns // NS_PER_S - EPOCH_2019_S
        link = Link(
            max(0, since_s - VALIDITY_S),
            (since_s if same else now_s) + VALIDITY_S,
            EntityTag.of_key(RANGE_RAA, 0, key).bytes_,
            key,
            self.root_tag,
            false_signature(noise),
        )
        return encode(MessagePack(tuple(split_with_parity(encode_sam(link), now_s, parity=False))))


def false_signature(noise: bytes) -> bytes:
    """A wrong Ed25519 signature that a verifier cannot reject early, from 64 bytes of noise.

    The second half is a number below the order of the group, which is more than 2²⁵²; a greater one is refused before
    any work is done (RFC 8032, section 5.1.7, step 1).
    """
    return noise[:63] + bytes([noise[63] & 0x0F])
