"""Reactive jammer: noise only while a frame of a Wi-Fi control link is on the air."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.transmission import SILENT_CDBM, radiated_power, transmitter_place
from skyrange.attack.control_link.wifi_links import WIFI_LINKS, find_wifi_links
from skyrange.codec.remote_id.noise_request import NoiseRequest, pack

PERIOD_NS: Final[sky.Time] = 100 * sky.NS_PER_MS
"""The jammer's program renews its order to the radio this often; an order is for twice as long, if none replaces it."""


@sky.attack(
    "control_link.reactive_jam",
    technique="T0814",
    counterfactual="mute",
    surface=("gcs", "medium"),
    effect="frames of the control link are repeated and lost, while the channel seems free between them",
    knowledge="the channel of the control link; to follow it, the address of its access point",
    position="where it hears the senders, and is heard by the receivers",
    equipment="a software-defined radio that reacts within a preamble",
    budget="noise for the time of the frames alone, up to 60 dBm, in one channel for each access point",
    load="none, because the noise is the attack; the sham has the same orders at −200 dBm",
    content="none, because noise has no content",
    placement="the same jammer on a channel that nobody uses, or where it does not hear the senders",
    realism={
        "lost frames": "simulated: power of signal and noise over the part of a frame that the noise covers",
        "following": "assumed: an access point whose beacons reach it with -82 dBm is found after follow_s",
        "reaction time": "assumed: 20 µs by default, one preamble; software-defined radios have done so",
    },
)
class ReactiveJam(sky.Periodic):
    """Transmits noise only while a frame of a Wi-Fi control link is on the air, so that its check sequence fails.

    It listens, and answers each frame of the links' channels with noise until the frame ends.
    """

    transmitter_m: sky.Enu = transmitter_place("jammer")
    links: tuple[str, ...] = WIFI_LINKS
    power_dbm: sky.Number = radiated_power(default=30.0, le=60)
    follow_s: sky.Number | None = sky.param(
        "Time in seconds after which it finds an access point that has changed its channel, and follows; default: it "
        "stays. A scan of 13 channels, each for a beacon interval, takes 1.3 s at most.",
        default=None, ge=0.001, le=65,
    )  # fmt: skip
    turnaround_us: sky.Whole = sky.param(
        "Time from the start of a frame to that of the noise, in microseconds; 20 is the preamble's end.",
        default=20, ge=1, le=254,
    )  # fmt: skip

    orders: Sequence[NoiseRequest]
    """One for each channel, or access point; its duration and time are replaced."""

    def prepare(self, context: sky.AttackContext) -> None:
        """Find the channels and access points of the links."""
        self.period_ns = PERIOD_NS
        power_cdbm = SILENT_CDBM if self.sham else round(self.power_dbm * 100)
        follow_ms = 0 if self.follow_s is None else max(1, round(self.follow_s * 1000))
        links = find_wifi_links(context, self.links).values()
        targets = {(round(link.centre_mhz * 1000), link.station_address if follow_ms else b"") for link in links}
        self.orders = [
            NoiseRequest(power_cdbm, centre_khz, 20_000, 0, 0, self.turnaround_us, bssid, follow_ms)
            for centre_khz, bssid in sorted(targets)
        ]

    def send(self, now: sky.Time, number: int) -> Iterable[bytes]:
        """The orders, if the attack acts; the last ones end when it stops."""
        left_us = min(self.left_us(now), 2 * PERIOD_NS // sky.NS_PER_US)
        return [pack(order._replace(duration_us=left_us, time_ns=now)) for order in self.orders] if left_us else ()
