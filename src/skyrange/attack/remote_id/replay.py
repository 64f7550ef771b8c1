"""Replay of Remote ID: recorded broadcasts are sent again later, from the attacker's position."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, Place, ThreatModel
from skyrange.attack.radio import SERVICE_NS, down_link, transmitter, up_link
from skyrange.attack.remote_id.forgery import claim_identity
from skyrange.codec.f3411 import (
    BasicId,
    IdType,
    Location,
    MessagePack,
    SelfId,
    SingleMessage,
    Status,
    UaType,
    encode,
)
from skyrange.codec.f3411.encode import PACK_HEADER, SIZE
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import ANY_CHANNEL, NO_RSSI
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.params import Enu, Number, Params
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import Time, from_seconds

MAX_BROADCASTS = 100_000
"""Largest number of broadcasts that the recorder holds; the oldest are discarded."""


class Replay(Params):
    """Records the broadcasts that it receives from time 0 on, and sends each again after a fixed delay."""

    transmitter_m: Enu = Field(
        description="Position of the attacker's radio, [east_m, north_m, up_m] in metres from the origin or the "
        "attack's anchor."
    )
    delay_s: Number = Field(
        default=30.0,
        gt=0,
        le=86_400,
        description="Time in seconds from the reception of a broadcast until it is sent again.",
    )
    power_dbm: Number = Field(default=20.0, ge=-30, le=50, description="Radiated power (EIRP) in dBm.")


@dataclass(slots=True)
class Replayer:
    """Receives on its `rid_down` link and sends on its `rid_up` link, `delay_ns` later.

    With `stands_enu_m` it is a sham: it sends broadcasts of the same length at the same times, which report an aircraft
    on the ground at that place.
    """

    name: str
    up: Port
    down: Port
    delay_ns: Time
    origin: Origin
    stands_enu_m: Place | None = None
    service_ns: Time = SERVICE_NS
    ports: Sequence[Port] = field(init=False)
    heard: deque[tuple[Time, bytes, FrameId]] = field(default_factory=lambda: deque(maxlen=MAX_BROADCASTS))

    def __post_init__(self) -> None:
        self.ports = [self.up, self.down]

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Record the broadcasts that arrived and send those that are due; ignore anything else that arrived."""
        out = Outbox()
        for arrival in inbox:
            try:
                header, body = link_payload.unpack(arrival.payload)
            except DecodeError:
                continue
            again = header._replace(channel=ANY_CHANNEL, rssi_cdbm=NO_RSSI, time_ns=arrival.at + self.delay_ns)
            if self.stands_enu_m is not None:
                again = again._replace(address=claim_identity(self.name).address)
                body = self._harmless(body, self.stands_enu_m)
            self.heard.append((arrival.at + self.delay_ns, link_payload.pack(again, body), arrival.ref))
        while self.heard and self.heard[0][0] <= now:
            _, payload, ref = self.heard.popleft()
            out.send(self.up, payload, (ref,))
        return out

    def next_wakeup(self) -> Time | None:
        """When the oldest recorded broadcast is due."""
        return self.heard[0][0] if self.heard else None

    def _harmless(self, body: bytes, place: Place) -> bytes:
        """A body of the same length with this transmitter's own identity and place, and Self-IDs for the rest."""
        lat_deg, lon_deg = self.origin.geodetic_of(place[0], place[1])
        messages: list[SingleMessage] = [
            Location(
                status=Status.GROUND,
                lat_deg=lat_deg,
                lon_deg=lon_deg,
                alt_geo_m=self.origin.ellipsoid_of(self.origin.alt_msl_m) + place[2],
            ),
            BasicId(IdType.SERIAL_NUMBER, UaType.HELICOPTER_OR_MULTIROTOR, claim_identity(self.name).uas_id),
            *[SelfId(0, "standing here")] * 9,
        ]
        if len(body) < PACK_HEADER + SIZE:
            return encode(messages[0])
        return encode(MessagePack(tuple(messages[: (len(body) - PACK_HEADER) // SIZE])))


def make(params: Replay, context: AttackContext) -> Attack:
    """The attack."""
    agent = Replayer(
        context.radio,
        Port(context.radio, context.up),
        Port(context.radio, context.down),
        from_seconds(params.delay_s),
        context.origin,
        params.transmitter_m if context.sham else None,
    )
    radio = transmitter(context, params.transmitter_m, params.power_dbm, listens=True)
    return Attack(agents=[agent], links=[up_link(context), down_link(context)], radios=[radio])


REPLAY = AttackPlugin(
    Replay,
    make,
    "Sends received Remote ID broadcasts again later, from another place.",
    technique="T0856",
    surface=("medium",),
    persists="acts",
    effect="receivers show aircraft where they were before",
    threat=ThreatModel(
        knowledge="nothing; it learns the broadcasts that it receives",
        position="within radio range of its victims and of the receivers",
        equipment="a Wi-Fi or Bluetooth receiver and transmitter",
        budget="one frame for each frame heard",
    ),
    controls=Controls(
        load="the sham: frames of the same length and transport, with an aircraft on the ground at the transmitter",
        content="none, because a replayed frame without its content is that sham; nor can a real aircraft make it "
        "true, because its time is that of the recording",
        placement="the same replay from another place",
    ),
    realism={"signal strength": "simulated: from the transmitter's place"},
)
