"""Replay of Remote ID: recorded broadcasts are sent again later, from the attacker's position."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.remote_id import StandingAircraft
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import ANY_CHANNEL, NO_RSSI, RidHeader


@sky.attack(
    "remote_id.replay",
    technique="T0856",
    effect="receivers show aircraft where they were before",
    knowledge="nothing; it learns the broadcasts that it receives",
    position="within radio range of its victims and of the receivers",
    equipment="a Wi-Fi or Bluetooth receiver and transmitter",
    budget="one frame for each frame heard",
    load="the sham: frames of the same length and transport, which report an aircraft on the ground at the transmitter",
    content="none, because a replayed frame without its content is that sham; nor can a real aircraft make it true, "
    "because its time is that of the recording",
    placement="the same replay from another place",
    realism={"signal strength": "simulated: from the transmitter's place"},
)
class Replay(sky.Reception):
    """Sends received Remote ID broadcasts again later, from another place.

    It records the broadcasts that it receives from time 0 on.
    """

    delay_s: sky.Number = sky.param(
        "Time in seconds from the reception of a broadcast until it is sent again.", default=30.0, gt=0, le=86_400
    )
    delay_ns: sky.Time
    harmless: StandingAircraft
    """What the sham sends."""

    def prepare(self, context: sky.AttackContext) -> None:
        self.delay_ns = sky.from_seconds(self.delay_s)
        self.harmless = StandingAircraft.at(self.transmitter_m, context.origin, context.radio)

    def hear(self, now: sky.Time, arrival: sky.Arrival, header: RidHeader, body: bytes, out: sky.Outbox) -> None:
        due = arrival.at + self.delay_ns
        again = header._replace(channel=ANY_CHANNEL, rssi_cdbm=NO_RSSI, time_ns=due)
        if self.sham:
            again, body = again._replace(address=sky.claim_identity(self.name).address), self.harmless.body(len(body))
        self.waiting.append((due, link_payload.pack(again, body), arrival.ref))
