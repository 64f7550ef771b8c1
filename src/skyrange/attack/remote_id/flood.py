"""Flood of Remote ID: well-formed, harmless broadcasts at a rate that keeps the channel busy."""

from __future__ import annotations

from dataclasses import replace

import skyrange.plugin as sky
from skyrange.attack.bases.remote_id import StandingAircraft
from skyrange.attack.bases.transmission import WifiBeacons, join


@sky.attack(
    "remote_id.flood",
    effect="senders defer to the flood and collide with it, so that their broadcasts come late or not at all",
    knowledge="the channel in use and the format of ASTM F3411",
    position="within radio range of the senders",
    equipment="several Wi-Fi transmitters that send frames of their own",
    budget="airtime of 0.55 ms for each frame, within the rules of channel access",
    load="none, because the load is the attack",
    content="none, because the content is harmless; the sham is the attack itself",
    realism={
        "deferral, collisions and losses": "simulated: carrier sense, back-off and signal against interference",
        "work of the receivers": "assumed: a companion and a ground receiver decode every frame",
    },
)
class Flood(WifiBeacons):
    """Fills a Wi-Fi channel with well-formed beacons of harmless aircraft on the ground."""

    stations: sky.Whole = sky.param(
        "Radios that contend for the channel, each with its identity: more leave less for others, and collide more.",
        default=10, ge=1, le=50,
    )  # fmt: skip
    rate_hz: sky.Number = sky.param(
        "Beacons per second of each radio; 1500 in all fill a channel at 6 Mb/s.", default=150.0, ge=1, le=2_000
    )

    sent: tuple[bytes, bytes] = (b"", b"")

    def build(self, context: sky.AttackContext) -> sky.Attack:
        return join(self._station(number, context) for number in range(self.stations))

    def _station(self, number: int, context: sky.AttackContext) -> sky.Attack:
        name, station = f"{self.id}.{number + 1}", self.copy()
        station.phase_ns = round(number * sky.NS_PER_S / (self.rate_hz * self.stations))
        aircraft = StandingAircraft.at(self.transmitter_m, context.origin, name)
        station.sent = sky.claim_identity(name).address, aircraft.body()
        return station.build_radio(replace(context, id=name))

    def beacon(self, now: sky.Time) -> tuple[bytes, bytes]:
        return self.sent
