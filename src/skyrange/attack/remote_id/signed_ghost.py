"""Signed ghost: false positions in authenticated Remote ID (DRIP), signed with a key that the attacker holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.radio import make_sender, place_transmitter
from skyrange.attack.remote_id.drip_keys import KeyOrigin, find_registration
from skyrange.attack.remote_id.forgery import (
    ClaimedIdentity,
    ClaimedVelocity,
    Forger,
    RadiatedPower,
    TransmitterPlace,
    Transports,
    claim_identity,
)
from skyrange.codec.f3411 import IdType
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.claims import ClaimedTrack
from skyrange.contracts.params import Enu, Number, Params, refuse
from skyrange.core.errors import Problem
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_S, Time
from skyrange.remoteid.broadcast_profiles import TRANSPORTS, Broadcast, sender_address

if TYPE_CHECKING:  # its imports are slow, and only authenticated broadcasts need them
    from skyrange.remoteid.drip.broadcasts import AuthenticationPages
    from skyrange.remoteid.drip.registry import Registration


class SignedGhost(Params):
    """An aircraft that is not where it says it is, with real DRIP signatures, from the attacker's own transmitter."""

    key: KeyOrigin = Field(
        default="registered",
        description="Key that signs. registered: the attacker's own, which the registry has endorsed (an insider); "
        "stolen: that of the aircraft in vehicle; unregistered: one that only a made-up registry endorses.",
    )
    vehicle: str | None = Field(
        default=None,
        description="Aircraft whose key is stolen, such as 'red/r1'; its remote_id.auth has to be 'drip'.",
    )
    address: Literal["own", "vehicle"] = Field(
        default="own",
        description="Sender address. own: the attacker's; vehicle: that of the aircraft in vehicle, so that receivers "
        "take both for one sender.",
    )
    at: Enu = Field(
        description="Claimed position at the start of the attack, [east_m, north_m, up_m] in metres from the origin or "
        "the attack's anchor."
    )
    velocity_mps: ClaimedVelocity = (0.0, 0.0, 0.0)
    rate_hz: Number = Field(default=1.0, ge=0.1, le=10, description="Broadcasts per second on each transport.")
    auth_rates: Literal["required", "recommended"] = Field(
        default="required", description="How often it sends authentication messages, as remote_id.auth_rates."
    )
    transports: Transports = ("wifi_beacon",)
    transmitter_m: TransmitterPlace = None
    power_dbm: RadiatedPower = 20.0

    @model_validator(mode="after")
    def _fits_its_key(self) -> SignedGhost:
        faults = []
        if self.key == "stolen" and self.vehicle is None:
            faults.append(Problem("vehicle", "missing", "the aircraft whose key is stolen, because key = 'stolen'"))
        if self.key != "stolen" and self.vehicle is not None:
            faults.append(Problem("vehicle", self.vehicle, f"no vehicle with key = {self.key!r}"))
        if self.key != "stolen" and self.address == "vehicle":
            faults.append(Problem("address", self.address, f"'own' with key = {self.key!r}, which is of no vehicle"))
        if faults:
            raise refuse(*faults)
        return self


@dataclass(slots=True)
class SignedForger:
    """A forger of one aircraft whose broadcasts are signed, as those of an honest transmitter are."""

    forger: Forger
    pages: AuthenticationPages

    @property
    def due(self) -> Time:
        """When the next broadcast or page is due."""
        return min(self.forger.due, self.pages.next_ns)

    def make(self, now: Time) -> list[bytes]:
        """The `rid_up` payloads that are due; none before the attack starts."""
        forger = self.forger
        payloads = forger.make(now)
        for payload in payloads:
            self.pages.sent(0, now, link_payload.unpack(payload).body)
        clock_us = np.array([(forger.epoch.unix_ns + now) // 1000], dtype=np.int64)
        self.pages.sign(now, clock_us, np.array([forger.due], dtype=np.int64))
        for page in self.pages.take(now, now + 1):
            counter = page.counter
            if page.transport != Transport.BT4:
                counter = forger.counter & 0xFF
                forger.counter += 1
            address = forger.identities[0].address
            header = RidHeader(Transport(page.transport), counter=counter, address=address, time_ns=page.at_ns)
            payloads.append(link_payload.pack(header, page.body))
        return payloads


def make(params: SignedGhost, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for a vehicle that is not in the scenario or signs nothing.

    The sham is an aircraft on the ground at the transmitter, registered and signed by its own key.
    """
    registration = find_registration(context, params.key, params.vehicle)
    if context.sham:
        registration = find_registration(context, "registered", None)
    place = place_transmitter(context, params.transmitter_m, params.at)
    identity = _identity(params, context, registration)
    forger = Forger(
        identities=[identity],
        places=[params.at],
        velocity_mps=params.velocity_mps,
        transports=[one for name in params.transports for one in TRANSPORTS[name]],
        period_ns=round(NS_PER_S / params.rate_hz),
        origin=context.origin,
        epoch=context.epoch,
        schedule=context.schedule,
        stands_enu_m=(place[0], place[1], 0.0) if context.sham else None,
    )
    source = SignedForger(forger, _pages(params, context, registration, identity))
    attack = make_sender(context, place, params.power_dbm, source)
    shown = {"ghost" if params.vehicle is None else f"{params.vehicle} as claimed": params.at}
    claims = [ClaimedTrack(context.radio, params.at, params.velocity_mps, identity.uas_id)]
    return replace(attack, shown=shown, claims=claims, threat=THREATS[params.key])


def _identity(params: SignedGhost, context: AttackContext, registration: Registration) -> ClaimedIdentity:
    from skyrange.codec.drip import session_id

    own = claim_identity(context.id, session_id(registration.identity.tag))
    if params.address == "own" or params.vehicle is None or context.sham:
        return own
    return own._replace(address=sender_address(params.vehicle))


def _pages(
    params: SignedGhost, context: AttackContext, registration: Registration, identity: ClaimedIdentity
) -> AuthenticationPages:
    from skyrange.remoteid.drip.broadcasts import AuthenticationPages
    from skyrange.remoteid.drip.credentials import Credentials
    from skyrange.remoteid.drip.schedule import RECOMMENDED, REQUIRED

    rates = REQUIRED if params.auth_rates == "required" else RECOMMENDED
    credentials = Credentials(registration, rates, seed=hash64(context.id))
    return AuthenticationPages(
        [
            Broadcast(
                context.id,
                uas_id=identity.uas_id,
                id_type=IdType.SPECIFIC_SESSION,
                transports=params.transports,
                credentials=credentials,
            )
        ]
    )


_POSITION: Final = "within radio range of the receivers"
_BUDGET: Final = "the frames of one aircraft: about 200 bytes a period, and one to four pages of signatures each 5 s"
THREATS: Final[Mapping[KeyOrigin, ThreatModel]] = {
    "registered": ThreatModel(
        knowledge="the formats of ASTM F3411 and RFC 9575",
        position=_POSITION,
        equipment="a transmitter, and a key of its own that the registry has endorsed",
        budget=_BUDGET,
    ),
    "stolen": ThreatModel(
        knowledge="the formats of ASTM F3411 and RFC 9575, and the private key of the victim",
        position=f"{_POSITION}; before that, at the victim or its supplier",
        equipment="a transmitter",
        budget=_BUDGET,
    ),
    "unregistered": ThreatModel(
        knowledge="the formats of ASTM F3411 and RFC 9575",
        position=_POSITION,
        equipment="a transmitter, and keys that it has made itself",
        budget=_BUDGET,
    ),
}
"""What each origin of the key needs."""

SIGNED_GHOST = AttackPlugin(
    SignedGhost,
    make,
    "Forges Remote ID with real DRIP signatures: by the attacker's own registered key, a stolen key, or a made-up "
    "registry.",
    technique="T0859",
    honest=True,
    surface=("medium",),
    persists="acts",
    effect="receivers verify the signatures of an aircraft that is not there, believe it, and avoid it",
    threat=THREATS["registered"],
    controls=Controls(
        load="the sham: the same frames and pages, with a registered aircraft on the ground at the transmitter",
        content="the honest arm: the same frames and keys, from a real aircraft that flies where the ghost is claimed",
        placement="the same claims with the transmitter or the ghost elsewhere",
    ),
    realism={
        "signatures": "simulated: Ed25519 over the bytes of RFC 9575, verified by each receiver",
        "signal strength": "simulated: from the transmitter's place, not from the claimed one",
        "theft of the key": "assumed: the attacker has it from the start",
    },
)
"""The attack `remote_id.signed_ghost`."""
