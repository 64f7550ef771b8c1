"""Flood of Remote ID: well-formed, harmless broadcasts at a rate that keeps the channel busy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

from pydantic import Field

from skyrange.attack.contract import ORACLE, Attack, AttackContext, AttackPlugin, Controls, ThreatModel, Transmitter
from skyrange.attack.radio import CHANNEL, SERVICE_NS, Broadcaster
from skyrange.attack.remote_id.forgery import claim_identity
from skyrange.codec.f3411 import BasicId, IdType, Location, MessagePack, SelfId, Status, UaType, encode
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.links import LinkSpec, Schedule
from skyrange.contracts.params import Enu, Number, Params, Whole
from skyrange.core.ids import Port, endpoint, link_name
from skyrange.core.time import NS_PER_S, Time

MESSAGES: Final = 9
"""The most in one pack (ASTM F3411-22a): the longest frame."""


class Flood(Params):
    """Wi-Fi beacons of honest identities, far more often than F3411 asks for."""

    transmitter_m: Enu = Field(
        description="Position of the transmitter, [east_m, north_m, up_m] in metres from the origin or the attack's "
        "anchor."
    )
    power_dbm: Number = Field(default=20.0, ge=-30, le=50, description="Radiated power (EIRP) in dBm.")
    stations: Annotated[Whole, Field(ge=1, le=50)] = Field(
        default=10,
        description="Radios that contend for the channel, each with an identity of its own; the more, the smaller the "
        "share of everybody else, and the more collisions.",
    )
    rate_hz: Number = Field(
        default=150.0,
        ge=1,
        le=2_000,
        description="Beacons per second of each radio; 1500 in all fill a channel, at 6 Mb/s and 0.55 ms for each.",
    )
    channel: Annotated[Whole, Field(ge=1, le=13)] = Field(default=6, description="Wi-Fi channel.")


@dataclass(slots=True)
class Beacons:
    """The same broadcast at a constant rate; none before the attack starts.

    A beacon is due `phase_ns` after a multiple of the period, so that radios do not begin together. The program wakes
    on its service grid; the radio holds the beacon until the time in its header, one service time later.
    """

    body: bytes
    header: RidHeader
    rate_hz: float
    phase_ns: Time
    schedule: Schedule
    turn: int = 0

    @property
    def due(self) -> Time:
        """When the next broadcast is due."""
        return round(self.turn * NS_PER_S / self.rate_hz) + self.phase_ns

    def make(self, now: Time) -> list[bytes]:
        """The broadcasts that are due."""
        payloads = []
        while self.due <= now:
            if self.schedule.start_ns <= now < self.schedule.stop_ns:
                header = self.header._replace(counter=self.turn & 0xFF, time_ns=self.due + SERVICE_NS)
                payloads.append(link_payload.pack(header, self.body))
            self.turn += 1
        return payloads


def make(params: Flood, context: AttackContext) -> Attack:
    """The attack; the sham is the attack itself, because its content is true and harmless."""
    agents, links, radios = [], [], []
    for number in range(1, params.stations + 1):
        name = f"{context.id}.{number}"
        radio, up = endpoint(name, "radio"), link_name("rid_up", name)
        phase_ns = round((number - 1) * NS_PER_S / (params.rate_hz * params.stations))
        source = _beacons(params, context, name, phase_ns)
        agents.append(Broadcaster(radio, Port(radio, up), source))
        links.append(LinkSpec(up, radio, ORACLE, CHANNEL))
        radios.append(Transmitter(radio, params.transmitter_m, params.power_dbm))
    return Attack(agents=agents, links=links, radios=radios)


def _beacons(params: Flood, context: AttackContext, name: str, phase_ns: Time) -> Beacons:
    place, identity = params.transmitter_m, claim_identity(name)
    lat_deg, lon_deg = context.origin.geodetic_of(place[0], place[1])
    altitude_m = context.origin.ellipsoid_of(context.origin.alt_msl_m) + place[2]
    location = Location(status=Status.GROUND, lat_deg=lat_deg, lon_deg=lon_deg, alt_geo_m=altitude_m)
    basic = BasicId(IdType.SERIAL_NUMBER, UaType.HELICOPTER_OR_MULTIROTOR, identity.uas_id)
    body = encode(MessagePack((location, basic, *[SelfId(0, "standing here")] * (MESSAGES - 2))))
    header = RidHeader(Transport.WIFI_BEACON, channel=params.channel, address=identity.address)
    return Beacons(body, header, params.rate_hz, phase_ns, context.schedule)


FLOOD = AttackPlugin(
    Flood,
    make,
    "Fills a Wi-Fi channel with well-formed beacons of harmless aircraft on the ground.",
    technique="T0814",
    counterfactual="mute",
    surface=("medium",),
    persists="acts",
    effect="senders defer to the flood and collide with it, so that their broadcasts come late or not at all",
    threat=ThreatModel(
        knowledge="the channel in use and the format of ASTM F3411",
        position="within radio range of the senders",
        equipment="several Wi-Fi transmitters that send frames of their own",
        budget="airtime of 0.55 ms for each frame, within the rules of channel access",
    ),
    controls=Controls(
        load="none, because the load is the attack",
        content="none, because the content is true and harmless; the sham is the attack itself",
        placement="the same flood on another channel or at another place",
    ),
    realism={
        "deferral, collisions and losses": "simulated: carrier sense, back-off and signal against interference",
        "work of the receivers": "assumed: a companion and a ground receiver decode every frame",
    },
)
