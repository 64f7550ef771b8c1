"""Flood of Remote ID: well-formed, harmless broadcasts at a rate that keeps the channel busy."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Annotated, Final

from pydantic import Field

import skyrange.plugin as sky
from skyrange.attack.bases.forged_remote_id import standing_aircraft
from skyrange.attack.bases.transmission import WIFI_CHANNEL, WifiBeacons, WifiChannel

MESSAGES: Final = 9
"""The most in one pack (ASTM F3411-22a): the longest frame."""


@sky.attack(
    "remote_id.flood",
    technique="T0814",
    counterfactual="mute",
    effect="senders defer to the flood and collide with it, so that their broadcasts come late or not at all",
    knowledge="the channel in use and the format of ASTM F3411",
    position="within radio range of the senders",
    equipment="several Wi-Fi transmitters that send frames of their own",
    budget="airtime of 0.55 ms for each frame, within the rules of channel access",
    load="none, because the load is the attack",
    content="none, because the content is true and harmless; the sham is the attack itself",
    placement="the same flood on another channel or at another place",
    realism={
        "deferral, collisions and losses": "simulated: carrier sense, back-off and signal against interference",
        "work of the receivers": "assumed: a companion and a ground receiver decode every frame",
    },
)
class Flood(WifiBeacons):
    """Fills a Wi-Fi channel with well-formed beacons of harmless aircraft on the ground.

    The beacons of honest identities come far more often than F3411 asks for.
    """

    stations: Annotated[sky.Whole, Field(ge=1, le=50)] = sky.param(
        "Radios that contend for the channel, each with an identity of its own; the more, the smaller the share of "
        "everybody else, and the more collisions.",
        default=10,
    )
    rate_hz: sky.Number = sky.param(
        "Beacons per second of each radio; 1500 in all fill a channel, at 6 Mb/s and 0.55 ms for each.",
        default=150.0, ge=1, le=2_000,
    )  # fmt: skip
    channel: WifiChannel = WIFI_CHANNEL

    address: bytes = b""
    body: bytes = b""

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """The radios; the sham is the attack itself, because its content is true and harmless."""
        made = [self._station(number, context) for number in range(self.stations)]
        return sky.Attack(
            agents=[one for part in made for one in part.agents],
            links=[one for part in made for one in part.links],
            radios=[one for part in made for one in part.radios],
        )

    def _station(self, number: int, context: sky.AttackContext) -> sky.Attack:
        name, station = f"{self.id}.{number + 1}", copy(self)
        station.phase_ns = round(number * sky.NS_PER_S / (self.rate_hz * self.stations))
        station.address = sky.claim_identity(name).address
        messages = standing_aircraft(name, context.origin, self.transmitter_m)
        station.body = sky.encode_remote_id(sky.MessagePack(tuple(messages[:MESSAGES])))
        return station.build_radio(replace(context, id=name))

    def beacon(self, now: sky.Time) -> tuple[bytes, bytes]:
        """The same each time."""
        return self.address, self.body
