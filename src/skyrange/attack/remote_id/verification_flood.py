"""Flood of signatures: well-formed DRIP Links with wrong signatures, each of which costs a receiver a verification."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha512
from typing import Annotated, Final

from pydantic import Field

import skyrange.plugin as sky
from skyrange.attack.bases.transmission import WIFI_CHANNEL, WifiBeacons, WifiChannel
from skyrange.attack.remote_id.drip_keys import find_root
from skyrange.codec.f3411 import EPOCH_2019_S

VALIDITY_S: Final = 3600
"""From a Link's "valid not before", as long before now, to its "valid not after", as long after."""


@sky.attack(
    "remote_id.verification_flood",
    technique="T0814",
    counterfactual="mute",
    effect="receivers that verify a limited number of signatures per second verify genuine aircraft late or never",
    knowledge="the formats of RFC 9575, and the tag of the root of the registry, which is public",
    position="within radio range of the receivers",
    equipment="a Wi-Fi transmitter that sends frames of its own; no key, and a hash for each Link",
    budget="a beacon of 0.43 ms for each Link, within the rules of channel access",
    load="the sham: frames of the same length and rate with one and the same Link, which costs one verification",
    content="none, because a right signature would need the key of the root",
    placement="the same flood on another channel or at another place",
    realism={
        "verifications": "simulated: each receiver verifies Ed25519 signatures up to its verifications_per_s",
        "time of a verification": "assumed: none in simulated time; the budget stands for the processor",
        "deferral, collisions and losses": "simulated: carrier sense, back-off and signal against interference",
    },
)
class VerificationFlood(WifiBeacons):
    """Sends well-formed DRIP Links with wrong signatures, on which receivers spend their budget of verifications.

    In each Link the root of the registry seems to endorse a new authority, which has a key of its own. The sham sends
    the same Link each time, which costs a receiver one verification in all.
    """

    rate_hz: sky.Number = sky.param(
        "Links per second, each in a Wi-Fi beacon of its own; 200 take 9 % of the airtime.",
        default=200.0, ge=1, le=1_000,
    )  # fmt: skip
    senders: Annotated[sky.Whole, Field(ge=1, le=1_000)] = sky.param(
        "Sender addresses, used in turn. A receiver follows 64 senders: with more, it forgets what it knew of the "
        "others too.",
        default=10,
    )
    channel: WifiChannel = WIFI_CHANNEL

    apex_tag: bytes
    addresses: Sequence[bytes]
    epoch: sky.Epoch

    def prepare(self, context: sky.AttackContext) -> None:
        """Find the root. Raises `InputError` without a registry."""
        self.apex_tag, self.epoch = find_root(context), context.epoch
        self.addresses = [sky.claim_identity(f"{self.id}.{number}").address for number in range(1, self.senders + 1)]

    def beacon(self, now: sky.Time) -> tuple[bytes, bytes]:
        """A Link with another key each time."""
        from skyrange.codec.drip import EntityTag, Link, encode_sam, split_with_parity
        from skyrange.remoteid.drip.registry import RANGE_RAA

        noise = sha512(f"{self.id}/{0 if self.sham else self.turn}".encode()).digest()
        key, now_s = noise[:32], (self.epoch.unix_ns + now) // sky.NS_PER_S - EPOCH_2019_S
        since_s = self.schedule.start_ns // sky.NS_PER_S + self.epoch.unix_ns // sky.NS_PER_S - EPOCH_2019_S
        link = Link(
            max(0, since_s - VALIDITY_S),
            (since_s if self.sham else now_s) + VALIDITY_S,
            EntityTag.of_key(RANGE_RAA, 0, key).bytes_,
            key,
            self.apex_tag,
            false_signature(noise),
        )
        body = sky.encode_remote_id(sky.MessagePack(tuple(split_with_parity(encode_sam(link), now_s, parity=False))))
        return self.addresses[self.turn % len(self.addresses)], body


def false_signature(noise: bytes) -> bytes:
    """A wrong Ed25519 signature that a verifier cannot reject early, from 64 bytes of noise.

    The second half is a number below the order of the group, which is more than 2²⁵²; a greater one is refused before
    any work is done (RFC 8032, section 5.1.7, step 1).
    """
    return noise[:63] + bytes([noise[63] & 0x0F])
