"""Flood of signatures: well-formed DRIP Links with wrong signatures, each of which costs a receiver a verification."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha512
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.remote_id import find_root
from skyrange.attack.bases.transmission import WifiBeacons
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


@sky.attack(
    "remote_id.verification_flood",
    effect="receivers that verify a limited number of signatures per second verify genuine aircraft late or never",
    knowledge="the formats of RFC 9575, and the tag of the root of the registry, which is public",
    position="within radio range of the receivers",
    equipment="a Wi-Fi transmitter that sends frames of its own; no key, and a hash for each Link",
    budget="a beacon of 0.43 ms for each Link, within the rules of channel access",
    load="the sham: frames of the same length and rate with one and the same Link, which costs one verification",
    content="none, because a right signature would need the key of the root",
    realism={
        "verifications": "simulated: each receiver verifies Ed25519 signatures up to its verifications_per_s",
        "time of a verification": "assumed: none in simulated time; the budget stands for the processor",
        "deferral, collisions and losses": "simulated: carrier sense, back-off and signal against interference",
    },
)
class VerificationFlood(WifiBeacons):
    """Sends well-formed DRIP Links with wrong signatures, on which receivers spend their budget of verifications.

    In each Link the root of the registry seems to endorse a new authority, which has a key of its own.
    """

    rate_hz: sky.Number = sky.param(
        "Links per second, each in a beacon of its own; 200 take 9 % of the airtime.", default=200.0, ge=1, le=1_000
    )
    senders: sky.Whole = sky.param(
        "Sender addresses, in turn. A receiver follows 64: with more it forgets others too.", default=10, ge=1, le=1_000
    )

    false: FalseLinks
    addresses: list[bytes]

    def prepare(self, context: sky.AttackContext) -> None:
        self.false = FalseLinks(self.id, find_root(context), context.epoch)
        self.addresses = [sky.claim_identity(f"{self.id}.{number}").address for number in range(1, self.senders + 1)]

    def beacon(self, now: sky.Time) -> tuple[bytes, bytes]:
        body = self.false.encode(self.turn, self.schedule.start_ns, now, same=self.sham)
        return self.addresses[self.turn % len(self.addresses)], body
