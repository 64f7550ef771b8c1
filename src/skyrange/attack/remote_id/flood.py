"""Flood of Remote ID: well-formed, harmless broadcasts at a rate that keeps the channel busy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.radio import Broadcaster, transmitter, up_link
from skyrange.attack.remote_id.forgery import claim_identity
from skyrange.codec.f3411 import BasicId, IdType, Location, MessagePack, SelfId, Status, UaType, encode
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, Params, Whole
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, Time

MESSAGES: Final = 9
"""The most in one pack (ASTM F3411-22a): the longest frame."""


class Flood(Params):
    """Wi-Fi beacons of an honest identity, far more often than F3411 asks for."""

    transmitter_m: Enu = Field(
        description="Position of the transmitter, [east_m, north_m, up_m] in metres from the origin or the attack's "
        "anchor."
    )
    power_dbm: Number = Field(default=20.0, ge=-30, le=50, description="Radiated power (EIRP) in dBm.")
    rate_hz: Number = Field(
        default=1_500.0,
        ge=1,
        le=5_000,
        description="Beacons per second; about 1500 fill a channel, at 6 Mb/s and 0.55 ms for each.",
    )
    channel: Annotated[Whole, Field(ge=1, le=13)] = Field(default=6, description="Wi-Fi channel.")


@dataclass(slots=True)
class Beacons:
    """The same broadcast at a constant rate; none before the attack starts."""

    body: bytes
    header: RidHeader
    rate_hz: float
    schedule: Schedule
    turn: int = 0

    @property
    def due(self) -> Time:
        """When the next broadcast is due."""
        return round(self.turn * NS_PER_S / self.rate_hz)

    def make(self, now: Time) -> list[bytes]:
        """The broadcasts that are due."""
        payloads = []
        while self.due <= now:
            if self.schedule.start_ns <= now < self.schedule.stop_ns:
                header = self.header._replace(counter=self.turn & 0xFF, time_ns=now)
                payloads.append(link_payload.pack(header, self.body))
            self.turn += 1
        return payloads


def make(params: Flood, context: AttackContext) -> Attack:
    """The attack; the sham is the attack itself, because its content is true and harmless."""
    place = params.transmitter_m
    identity = claim_identity(context.id)
    lat_deg, lon_deg = context.origin.geodetic_of(place[0], place[1])
    altitude_m = context.origin.ellipsoid_of(context.origin.alt_msl_m) + place[2]
    location = Location(status=Status.GROUND, lat_deg=lat_deg, lon_deg=lon_deg, alt_geo_m=altitude_m)
    basic = BasicId(IdType.SERIAL_NUMBER, UaType.HELICOPTER_OR_MULTIROTOR, identity.uas_id)
    body = encode(MessagePack((location, basic, *[SelfId(0, "standing here")] * (MESSAGES - 2))))
    header = RidHeader(Transport.WIFI_BEACON, channel=params.channel, address=identity.address)
    source = Beacons(body, header, params.rate_hz, context.schedule)
    agent = Broadcaster(context.radio, Port(context.radio, context.up), source)
    radio = transmitter(context, place, params.power_dbm)
    return Attack(agents=[agent], links=[up_link(context)], radios=[radio])


FLOOD = AttackPlugin(
    Flood,
    make,
    "Fills a Wi-Fi channel with well-formed beacons of a harmless aircraft on the ground.",
    technique="T0814",
    counterfactual="mute",
    surface=("medium",),
    effect="senders that hear the flood defer to it, so that their broadcasts come late or not at all",
    threat=ThreatModel(
        knowledge="the channel in use and the format of ASTM F3411",
        position="within radio range of the senders",
        equipment="a Wi-Fi transmitter that sends frames of its own",
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
