"""Replay of Remote ID: recorded broadcasts are sent again later, from the attacker's position."""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.forged_remote_id import standing_aircraft
from skyrange.attack.bases.transmission import radiated_power, transmitter_place
from skyrange.codec.f3411 import SingleMessage
from skyrange.codec.f3411.encode import PACK_HEADER, SIZE
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import ANY_CHANNEL, NO_RSSI, RidHeader

MAX_BROADCASTS: Final = 100_000
"""Largest number of broadcasts that the recorder holds; the oldest are discarded."""


@sky.attack(
    "remote_id.replay",
    technique="T0856",
    effect="receivers show aircraft where they were before",
    knowledge="nothing; it learns the broadcasts that it receives",
    position="within radio range of its victims and of the receivers",
    equipment="a Wi-Fi or Bluetooth receiver and transmitter",
    budget="one frame for each frame heard",
    load="the sham: frames of the same length and transport, with an aircraft on the ground at the transmitter",
    content="none, because a replayed frame without its content is that sham; nor can a real aircraft make it true, "
    "because its time is that of the recording",
    placement="the same replay from another place",
    realism={"signal strength": "simulated: from the transmitter's place"},
)
class Replay(sky.Reception):
    """Sends received Remote ID broadcasts again later, from another place.

    It records the broadcasts that it receives from time 0 on, and sends each again after a fixed delay. The sham sends
    broadcasts of the same length at the same times, which report an aircraft on the ground at the transmitter.
    """

    transmitter_m: sky.Enu = transmitter_place("attacker's radio")
    delay_s: sky.Number = sky.param(
        "Time in seconds from the reception of a broadcast until it is sent again.", default=30.0, gt=0, le=86_400
    )
    power_dbm: sky.Number = radiated_power()

    delay_ns: sky.Time
    harmless: list[SingleMessage]
    """What the sham sends."""
    heard: deque[tuple[sky.Time, bytes, sky.FrameId]] = sky.state(partial(deque, maxlen=MAX_BROADCASTS))

    def prepare(self, context: sky.AttackContext) -> None:
        self.delay_ns = sky.from_seconds(self.delay_s)
        self.harmless = standing_aircraft(context.radio, context.origin, self.transmitter_m)

    def hear(self, now: sky.Time, arrival: sky.Arrival, header: RidHeader, body: bytes, out: sky.Outbox) -> None:
        due = arrival.at + self.delay_ns
        again = header._replace(channel=ANY_CHANNEL, rssi_cdbm=NO_RSSI, time_ns=due)
        if self.sham:
            again, body = again._replace(address=sky.claim_identity(self.name).address), self._of_length(len(body))
        self.heard.append((due, link_payload.pack(again, body), arrival.ref))

    def send_due(self, now: sky.Time, out: sky.Outbox) -> None:
        """Send those that are due."""
        while self.heard and self.heard[0][0] <= now:
            _, payload, ref = self.heard.popleft()
            out.send(self.up, payload, (ref,))

    def next_wakeup(self) -> sky.Time | None:
        return self.heard[0][0] if self.heard else None

    def _of_length(self, length: int) -> bytes:
        """A harmless body of a length: as many messages as fit."""
        if length < PACK_HEADER + SIZE:
            return sky.encode_remote_id(self.harmless[0])
        return sky.encode_remote_id(sky.MessagePack(tuple(self.harmless[: (length - PACK_HEADER) // SIZE])))
