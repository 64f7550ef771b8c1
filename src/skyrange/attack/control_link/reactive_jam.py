"""Reactive jammer: noise only while a frame of a Wi-Fi control link is on the air."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.transmission import OrdersNoise
from skyrange.attack.bases.wifi_links import OnWifiLinks
from skyrange.codec.remote_id.noise_request import NoiseRequest, pack


@sky.attack(
    "control_link.reactive_jam",
    effect="frames of the control link are repeated and lost, while the channel seems free between them",
    knowledge="the channel of the control link; to follow it, the address of its access point",
    position="where it hears the senders, and is heard by the receivers",
    equipment="a software-defined radio that reacts within a preamble",
    budget="noise for the time of the frames alone, up to 60 dBm, in one channel for each access point",
    placement="the same jammer on a channel that nobody uses, or where it does not hear the senders",
    realism={
        "lost frames": "simulated: power of signal and noise over the part of a frame that the noise covers",
        "following": "assumed: an access point whose beacons reach it with -82 dBm is found after follow_s",
        "reaction time": "assumed: 20 µs by default, one preamble; software-defined radios have done so",
    },
)
class ReactiveJam(OrdersNoise, OnWifiLinks):
    """Transmits noise only while a frame of a Wi-Fi control link is on the air, so that its check sequence fails."""

    follow_s: sky.Number | None = sky.param(
        "Seconds until it follows an access point to another channel; default: never. A scan of 13 takes up to 1.3 s.",
        default=None, ge=0.001, le=65,
    )  # fmt: skip
    turnaround_us: sky.Whole = sky.param(
        "Microseconds from the start of a frame to the noise; 20 is the preamble's end.", default=20, ge=1, le=254
    )
    period_ns: sky.Time = 100 * sky.NS_PER_MS
    """How often its program renews the order to the radio. An order is for twice as long, if none replaces it."""
    orders: list[NoiseRequest]
    """One for each channel, or access point; its duration and time are replaced."""

    def prepare(self, context: sky.AttackContext) -> None:
        follow_ms = 0 if self.follow_s is None else max(1, round(self.follow_s * 1000))
        self.orders = [
            NoiseRequest(self.noise_cdbm, centre_khz, 20_000, 0, 0, self.turnaround_us, bssid, follow_ms)
            for centre_khz, bssid in self.find_channels(with_access_points=follow_ms > 0)
        ]

    def send(self, now: sky.Time, number: int) -> list[bytes]:
        left_us = min(self.left_us(now), 2 * self.period_ns // sky.NS_PER_US)
        return [pack(order._replace(duration_us=left_us, time_ns=now)) for order in self.orders if left_us]
