"""Signed ghost: false positions in authenticated Remote ID (DRIP), signed with a key that the attacker holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.remote_id import ForgedRemoteId, KeyOrigin, find_registration
from skyrange.codec.f3411 import IdType
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.remoteid.broadcast_profiles import Broadcast, sender_address

if TYPE_CHECKING:  # its imports are slow, and only authenticated broadcasts need them
    from skyrange.remoteid.drip.broadcasts import AuthenticationPages
    from skyrange.remoteid.drip.registry import Registration


def _threat(equipment: str, more_knowledge: str = "", before: str = "") -> sky.ThreatModel:
    return sky.ThreatModel(
        knowledge=f"the formats of ASTM F3411 and RFC 9575{more_knowledge}",
        position=f"within radio range of the receivers{before}",
        equipment=equipment,
        budget="the frames of one aircraft: about 200 bytes a period, and one to four pages of signatures each 5 s",
    )


THREATS: Final[Mapping[KeyOrigin, sky.ThreatModel]] = {
    "registered": _threat("a transmitter, and a key of its own that the registry has endorsed"),
    "stolen": _threat(
        "a transmitter", ", and the private key of the victim", "; before that, at the victim or its supplier"
    ),
    "unregistered": _threat("a transmitter, and keys that it has made itself"),
}
"""What each origin of the key needs."""


@sky.attack(
    "remote_id.signed_ghost",
    technique="T0859",
    effect="receivers verify the signatures of an aircraft that is not there, believe it, and avoid it",
    knowledge="the formats of ASTM F3411 and RFC 9575",
    position="within radio range of the receivers",
    equipment="a transmitter, and a key of its own that the registry has endorsed",
    budget="the frames of one aircraft: about 200 bytes a period, and one to four pages of signatures each 5 s",
    load="the sham: the same frames and pages, which report a registered aircraft on the ground at the transmitter",
    content="the honest arm: the same frames and keys, from a real aircraft that flies where the ghost is claimed",
    placement="the same claims with the transmitter or the ghost elsewhere",
    realism={
        "signatures": "simulated: Ed25519 over the bytes of RFC 9575, verified by each receiver",
        "signal strength": "simulated: from the transmitter's place, not from the claimed one",
        "theft of the key": "assumed: the attacker has it from the start",
    },
)
class SignedGhost(ForgedRemoteId):
    """Forges Remote ID with real DRIP signatures: by the attacker's own registered key, a stolen key, or a made-up
    registry.

    An aircraft that is not where it says it is signs as an honest transmitter does, from the attacker's own. The sham
    reports an aircraft on the ground at the transmitter, registered and signed by its own key; none stands there.
    """

    key: KeyOrigin = sky.param(
        "Key that signs. registered: the attacker's own, which the registry has endorsed (an insider); stolen: that of "
        "the aircraft in vehicle; unregistered: one that only a made-up registry endorses.",
        default="registered",
    )
    vehicle: str | None = sky.param(
        "Aircraft whose key is stolen, such as 'red/r1'; its remote_id.auth has to be 'drip'.", default=None
    )
    address: Literal["own", "vehicle"] = sky.param(
        "Sender address. own: the attacker's; vehicle: that of the aircraft in vehicle, so that receivers take both "
        "for one sender.",
        default="own",
    )
    auth_rates: Literal["required", "recommended"] = sky.param(
        "How often it sends authentication messages, as remote_id.auth_rates.", default="required"
    )

    pages: AuthenticationPages

    def find_problems(self) -> sky.Problems:
        if self.key == "stolen" and self.vehicle is None:
            yield sky.Problem("vehicle", "missing", "the aircraft whose key is stolen, because key = 'stolen'")
        if self.key != "stolen" and self.vehicle is not None:
            yield sky.Problem("vehicle", self.vehicle, f"no vehicle with key = {self.key!r}")
        if self.key != "stolen" and self.address == "vehicle":
            yield sky.Problem("address", self.address, f"'own' with key = {self.key!r}, which is of no vehicle")

    def prepare(self, context: sky.AttackContext) -> None:
        """Take the key. Raises `InputError` for a vehicle that is not in the scenario or signs nothing."""
        from skyrange.codec.drip import session_id

        registration = find_registration(context, self.key, self.vehicle)
        if self.sham:
            registration = find_registration(context, "registered", None)
        identity = sky.claim_identity(self.id, session_id(registration.identity.tag))
        if self.address == "vehicle" and self.vehicle is not None and not self.sham:
            identity = identity._replace(address=sender_address(self.vehicle))
        self.identities, self.pages = [identity], self._pages(registration, identity.uas_id)

    def _pages(self, registration: Registration, uas_id: str) -> AuthenticationPages:
        from skyrange.remoteid.drip.broadcasts import AuthenticationPages
        from skyrange.remoteid.drip.sender import RECOMMENDED, REQUIRED, Credentials

        rates = REQUIRED if self.auth_rates == "required" else RECOMMENDED
        credentials = Credentials(registration, rates, seed=sky.hash64(self.id))
        sender = Broadcast(
            self.id, uas_id=uas_id, id_type=IdType.SPECIFIC_SESSION, transports=self.transports,
            credentials=credentials,
        )  # fmt: skip
        return AuthenticationPages([sender])

    def build(self, context: sky.AttackContext) -> sky.Attack:
        return replace(super().build(context), threat=THREATS[self.key])

    @property
    def due(self) -> sky.Time:
        """When the next broadcast or page is due."""
        return min(self.broadcast_due, self.pages.next_ns)

    def transmit(self, now: sky.Time) -> list[bytes]:
        """The payloads that are due, with pages; none before the attack starts."""
        payloads = super().transmit(now)
        for payload in payloads:
            self.pages.sent(0, now, link_payload.unpack(payload).body)
        clock_us = np.array([(self.epoch.unix_ns + now) // 1000], dtype=np.int64)
        self.pages.sign(now, clock_us, np.array([self.broadcast_due], dtype=np.int64))
        for page in self.pages.take(now, now + 1):
            counter = page.counter
            if page.transport != Transport.BT4:
                counter = self.counter & 0xFF
                self.counter += 1
            address = self.identities[0].address
            header = RidHeader(Transport(page.transport), counter=counter, address=address, time_ns=page.at_ns)
            payloads.append(link_payload.pack(header, page.body))
        return payloads
