"""Flood of signatures: well-formed DRIP Links with wrong signatures, each of which costs a receiver a verification."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.transmission import WifiBeacons
from skyrange.attack.remote_id.drip_keys import find_root
from skyrange.attack.remote_id.false_links import FalseLinks


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
