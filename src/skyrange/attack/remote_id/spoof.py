"""Spoofing of Remote ID: ghosts, false positions of real aircraft, and swarms of ghosts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import cos, pi, sin, sqrt
from typing import Annotated, Literal

from pydantic import Field, model_validator

from skyrange.attack.contract import (
    ORACLE,
    Attack,
    AttackContext,
    AttackPlugin,
    Controls,
    Place,
    ThreatModel,
    Transmitter,
)
from skyrange.attack.radio import (
    CHANNEL,
    SERVICE_NS,
    Broadcaster,
    check_vehicle,
    place_transmitter,
    transmitter,
    up_link,
)
from skyrange.attack.remote_id.forgery import (
    ClaimedIdentity,
    ClaimedVelocity,
    Forger,
    RadiatedPower,
    TransmitterPlace,
    Transports,
    claim_identity,
)
from skyrange.contracts.claims import ClaimedTrack
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import LinkSpec, TapPlacement
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.params import Enu, Number, Params, Whole, refuse
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import Port, endpoint, hash64, link_name
from skyrange.core.time import NS_PER_S, Time
from skyrange.remoteid.broadcast_profiles import TRANSPORTS

STREAM = "attack.swarm"
"""Name of the random stream that places the ghosts of a swarm."""


class Spoof(Params):
    """Forged Remote ID, transmitted by the attacker's own radio or injected on an aircraft's link to its radio."""

    form: Literal["ghost", "position", "swarm"] = Field(
        default="ghost",
        description="ghost: an aircraft that does not exist; position: a false position of a real aircraft; swarm: "
        "many ghosts around a place.",
    )
    at: Enu = Field(
        description="Claimed position at the start of the attack, or centre of the swarm: [east_m, north_m, up_m] in "
        "metres from the origin or the attack's anchor."
    )
    velocity_mps: ClaimedVelocity = (0.0, 0.0, 0.0)
    vehicle: str | None = Field(
        default=None, description="Aircraft whose identity form = 'position' uses, such as 'red/r1'."
    )
    uas_id: str | None = Field(
        default=None,
        min_length=1,
        max_length=20,
        pattern=r"^[\x20-\x7e]+$",
        description="UAS ID of a ghost, at most 20 printable ASCII characters; default: one derived from the attack's "
        "id.",
    )
    count: Annotated[Whole, Field(ge=1, le=2000)] = Field(default=20, description="Number of ghosts in a swarm.")
    radius_m: Number = Field(default=100.0, gt=0, le=10_000, description="Radius of a swarm in metres.")
    rate_hz: Number = Field(
        default=1.0, ge=0.1, le=10, description="Broadcasts per second of each forged aircraft on each transport."
    )
    transports: Transports = ("wifi_beacon",)
    via: Literal["radio", "link"] = Field(
        default="radio",
        description="radio: broadcast from the attacker's own transmitter; link: inject on the rid_up link of an "
        "aircraft.",
    )
    on: str | None = Field(
        default=None,
        description="Aircraft on whose rid_up link via = 'link' injects; default: the aircraft in vehicle.",
    )
    transmitter_m: TransmitterPlace = None
    power_dbm: RadiatedPower = 20.0

    @model_validator(mode="after")
    def _fits_its_form(self) -> Spoof:
        faults = []
        if self.form == "position" and self.vehicle is None:
            faults.append(
                Problem("vehicle", "missing", "the aircraft whose identity to use, because form = 'position'")
            )
        if self.form != "position" and self.vehicle is not None:
            faults.append(
                Problem("vehicle", self.vehicle, f"no vehicle with form = {self.form!r}", "Use on or uas_id.")
            )
        if self.form != "ghost" and self.uas_id is not None:
            faults.append(
                Problem("uas_id", self.uas_id, f"no uas_id with form = {self.form!r}, which sets the UAS ID itself")
            )
        if self.via == "link" and self.on is None and self.vehicle is None:
            faults.append(Problem("on", "missing", "the aircraft on whose rid_up link to inject"))
        if self.via == "radio" and self.on is not None:
            faults.append(Problem("on", self.on, "no aircraft with via = 'radio'", "Set via = 'link', or omit on."))
        if self.via == "link" and self.transmitter_m is not None:
            faults.append(Problem("transmitter_m", repr(list(self.transmitter_m)), "no position with via = 'link'"))
        if faults:
            raise refuse(*faults)
        return self


@dataclass(slots=True)
class Injector:
    """A tap that injects a forger's broadcasts on the `rid_up` of an aircraft, as if its companion had sent them."""

    src: str
    source: Forger

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Let every frame pass."""
        return ()

    def next_wakeup(self) -> Time | None:
        """When the next broadcast is due."""
        return self.source.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Inject the broadcasts that are due."""
        return [Inject(payload, "fwd", self.src, ORACLE) for payload in self.source.make(now)]


@dataclass(slots=True)
class RealSwarm:
    """An agent that sends the broadcasts of each forged aircraft on the link of a radio of its own: the honest arm."""

    name: str
    ports: Sequence[Port]
    """The end of each radio's `rid_up` link, in the forger's order."""
    source: Forger
    service_ns: Time = field(default=SERVICE_NS)

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Send the broadcasts that are due."""
        out = Outbox()
        for number, payload in self.source.make_numbered(now):
            out.send(self.ports[number], payload)
        return out

    def next_wakeup(self) -> Time | None:
        """When the next broadcast is due."""
        return self.source.due


@dataclass(frozen=True, slots=True)
class _MakeInjector:
    """Makes the tap of a link. Only one link matches, so all taps share the forger."""

    src: str
    source: Forger

    def __call__(self, link: str) -> Injector:
        return Injector(self.src, self.source)


def make(params: Spoof, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario or have no `rid_up` link."""
    for name, vehicle in (("vehicle", params.vehicle), ("on", params.on)):
        if vehicle is not None:
            check_vehicle(context, name, vehicle)
    place = place_transmitter(context, params.transmitter_m, params.at)
    forger = Forger(
        identities=_identities(params, context),
        places=_places(params, context),
        velocity_mps=params.velocity_mps,
        transports=[one for name in params.transports for one in TRANSPORTS[name]],
        period_ns=round(NS_PER_S / params.rate_hz),
        origin=context.origin,
        epoch=context.epoch,
        schedule=context.schedule,
        stands_enu_m=(place[0], place[1], 0.0) if context.sham else None,
    )
    shown = {"ghost" if params.form != "position" else f"{params.vehicle} as claimed": params.at}
    if params.form == "swarm":
        shown = {f"ghost {number}": claimed for number, claimed in enumerate(forger.places, start=1)}
    if params.via == "radio":
        claims = [
            ClaimedTrack(context.radio, start, params.velocity_mps, identity.uas_id)
            for start, identity in zip(forger.places, forger.identities, strict=True)
        ]
        if context.honest and params.form == "swarm":
            return _real_swarm(context, forger, claims, params.power_dbm, shown)
        agent = Broadcaster(context.radio, Port(context.radio, context.up), forger)
        radio = transmitter(context, place, params.power_dbm)
        return Attack(agents=[agent], links=[up_link(context)], radios=[radio], shown=shown, claims=claims)
    victim = params.on or params.vehicle
    assert victim is not None  # the parameters' own check
    link = link_name("rid_up", victim)
    if link not in context.links:
        raise InputError.one(context.id, "on", link, "a link of the scenario", nearest(link, context.links))
    companion = endpoint(victim, "companion")
    return Attack(taps=[TapPlacement(link, "companion", _MakeInjector(companion, forger), context.id)], shown=shown)


def _real_swarm(
    context: AttackContext, forger: Forger, claims: Sequence[ClaimedTrack], power_dbm: float, shown: dict[str, Place]
) -> Attack:
    """The honest arm of a swarm: as many radios as aircraft, because each is at another place."""
    owners = [f"{context.id}.{number}" for number in range(len(claims))]
    radios = [endpoint(owner, "radio") for owner in owners]
    links = [
        LinkSpec(link_name("rid_up", owner), radio, ORACLE, CHANNEL)
        for owner, radio in zip(owners, radios, strict=True)
    ]
    ports = [Port(radio, link.name) for radio, link in zip(radios, links, strict=True)]
    return Attack(
        agents=[RealSwarm(context.radio, ports, forger)],
        links=links,
        radios=[Transmitter(one, claim.start_enu_m, power_dbm) for one, claim in zip(radios, claims, strict=True)],
        claims=[replace(claim, radio=radio) for claim, radio in zip(claims, radios, strict=True)],
        shown=shown,
    )


def _identities(params: Spoof, context: AttackContext) -> list[ClaimedIdentity]:
    if params.form == "swarm":
        return [claim_identity(f"{context.id}.{number}") for number in range(params.count)]
    if context.sham or params.vehicle is None:
        return [claim_identity(context.id, "" if context.sham else params.uas_id or "")]
    return [claim_identity(context.id, context.vehicles[params.vehicle].uas_id)]


def _places(params: Spoof, context: AttackContext) -> list[Place]:
    """The claimed place, or the places of a swarm: uniform over a disk around that place, at its height."""
    if params.form != "swarm":
        return [params.at]
    places = []
    for number in range(params.count):
        along, around, *_ = context.chance.uniform4(STREAM, hash64(context.id), 0, number)
        away_m = params.radius_m * sqrt(along)
        east_m, north_m = away_m * cos(2 * pi * around), away_m * sin(2 * pi * around)
        places.append((params.at[0] + east_m, params.at[1] + north_m, params.at[2]))
    return places


SPOOF = AttackPlugin(
    Spoof,
    make,
    "Forges Remote ID: an aircraft that does not exist, a false position of a real one, or a swarm of ghosts.",
    technique="T0856",
    honest=True,
    surface=("medium", "rid_up"),
    persists="acts",
    effect="receivers show aircraft that are not there, and companions avoid them",
    threat=ThreatModel(
        knowledge="the format of ASTM F3411; for a false position, the UAS ID of its victim",
        position="within radio range of the receivers, or on the victim's computer",
        equipment="a Wi-Fi or Bluetooth transmitter that sends frames of its own",
        budget="a frame of about 200 bytes for each forged aircraft, transport and period",
    ),
    controls=Controls(
        load="the sham: the same frames, with an aircraft on the ground at the transmitter",
        content="the honest arm: the same frames, from a real aircraft that flies where the ghost claims to be",
        placement="the same claims with the transmitter or the ghost elsewhere",
    ),
    realism={"signal strength": "simulated: from the transmitter's place, not from the claimed one"},
)
