"""Flood of signatures: well-formed DRIP Links with wrong signatures, each of which costs a receiver a verification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha512
from typing import Annotated

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.radio import SERVICE_NS, make_sender
from skyrange.attack.remote_id.drip_keys import find_root
from skyrange.attack.remote_id.forgery import claim_identity
from skyrange.codec.f3411 import EPOCH_2019_S, MessagePack, encode
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, Params, Whole
from skyrange.core.time import NS_PER_S, Epoch, Time

VALIDITY_S = 3600
"""From a Link's "valid not before", as long before now, to its "valid not after", as long after."""


class VerificationFlood(Params):
    """Links in which the root of the registry seems to endorse a new authority, each with a key of its own."""

    transmitter_m: Enu = Field(
        description="Position of the transmitter, [east_m, north_m, up_m] in metres from the origin or the attack's "
        "anchor."
    )
    power_dbm: Number = Field(default=20.0, ge=-30, le=50, description="Radiated power (EIRP) in dBm.")
    rate_hz: Number = Field(
        default=200.0,
        ge=1,
        le=1_000,
        description="Links per second, each in a Wi-Fi beacon of its own; 200 take 9 % of the airtime.",
    )
    senders: Annotated[Whole, Field(ge=1, le=1_000)] = Field(
        default=10,
        description="Sender addresses, used in turn. A receiver follows 64 senders: with more, it forgets what it knew "
        "of the others too.",
    )
    channel: Annotated[Whole, Field(ge=1, le=13)] = Field(default=6, description="Wi-Fi channel.")


@dataclass(slots=True)
class FalseLinks:
    """A Link with another key each time, at a constant rate; none before the attack starts.

    With `is_sham` it is the same Link each time, which costs a receiver one verification in all.
    """

    name: str
    apex_tag: bytes
    addresses: Sequence[bytes]
    channel: int
    rate_hz: float
    epoch: Epoch
    schedule: Schedule
    is_sham: bool = False
    turn: int = 0

    @property
    def due(self) -> Time:
        """When the next Link is due."""
        return round(self.turn * NS_PER_S / self.rate_hz)

    def make(self, now: Time) -> list[bytes]:
        """The Links that are due."""
        payloads = []
        while self.due <= now:
            if self.schedule.start_ns <= now < self.schedule.stop_ns:
                header = RidHeader(
                    Transport.WIFI_BEACON,
                    channel=self.channel,
                    counter=self.turn & 0xFF,
                    address=self.addresses[self.turn % len(self.addresses)],
                    time_ns=self.due + SERVICE_NS,
                )
                payloads.append(link_payload.pack(header, self._body(now)))
            self.turn += 1
        return payloads

    def _body(self, now: Time) -> bytes:
        from skyrange.codec.drip import EntityTag, Link, encode_sam, split_with_parity
        from skyrange.remoteid.drip.registry import RANGE_RAA

        turn = 0 if self.is_sham else self.turn
        noise = sha512(f"{self.name}/{turn}".encode()).digest()
        key, now_s = noise[:32], (self.epoch.unix_ns + now) // NS_PER_S - EPOCH_2019_S
        since_s = self.schedule.start_ns // NS_PER_S + self.epoch.unix_ns // NS_PER_S - EPOCH_2019_S
        link = Link(
            max(0, since_s - VALIDITY_S),
            now_s + VALIDITY_S if not self.is_sham else since_s + VALIDITY_S,
            EntityTag.of_key(RANGE_RAA, 0, key).bytes_,
            key,
            self.apex_tag,
            false_signature(noise),
        )
        return encode(MessagePack(tuple(split_with_parity(encode_sam(link), now_s, parity=False))))


def false_signature(noise: bytes) -> bytes:
    """A wrong Ed25519 signature that a verifier cannot reject early, from 64 bytes of noise.

    The second half is a number below the order of the group, which is more than 2²⁵²; a greater one is refused before
    any work is done (RFC 8032, section 5.1.7, step 1).
    """
    return noise[:63] + bytes([noise[63] & 0x0F])


def make(params: VerificationFlood, context: AttackContext) -> Attack:
    """The attack; its sham sends one and the same Link."""
    links = FalseLinks(
        context.id,
        find_root(context),
        [claim_identity(f"{context.id}.{number}").address for number in range(1, params.senders + 1)],
        params.channel,
        params.rate_hz,
        context.epoch,
        context.schedule,
        context.sham,
    )
    return make_sender(context, params.transmitter_m, params.power_dbm, links)


VERIFICATION_FLOOD = AttackPlugin(
    VerificationFlood,
    make,
    "Sends well-formed DRIP Links with wrong signatures, on which receivers spend their budget of verifications.",
    technique="T0814",
    counterfactual="mute",
    surface=("medium",),
    persists="acts",
    effect="receivers that verify a limited number of signatures per second verify genuine aircraft late or never",
    threat=ThreatModel(
        knowledge="the formats of RFC 9575, and the tag of the root of the registry, which is public",
        position="within radio range of the receivers",
        equipment="a Wi-Fi transmitter that sends frames of its own; no key, and a hash for each Link",
        budget="a beacon of 0.43 ms for each Link, within the rules of channel access",
    ),
    controls=Controls(
        load="the sham: frames of the same length and rate with one and the same Link, which costs one verification",
        content="none, because a right signature would need the key of the root",
        placement="the same flood on another channel or at another place",
    ),
    realism={
        "verifications": "simulated: each receiver verifies Ed25519 signatures up to its verifications_per_s",
        "time of a verification": "assumed: none in simulated time; the budget stands for the processor",
        "deferral, collisions and losses": "simulated: carrier sense, back-off and signal against interference",
    },
)
"""The attack `remote_id.verification_flood`."""
