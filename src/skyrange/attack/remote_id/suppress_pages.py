"""Page suppression: noise on the frames that carry DRIP signatures, and not on the ordinary broadcasts between them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.transmission import OrdersNoise, WifiChannel
from skyrange.attack.remote_id.manifest_times import ManifestTimes, carries_manifest
from skyrange.codec.f3411 import MessageType
from skyrange.codec.f3411.encode import SIZE
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.codec.remote_id.noise_request import NoiseRequest, pack
from skyrange.radio.phy import OVERHEAD_BYTES, TRANSPORT_WAVEFORM, airtime_ns
from skyrange.remoteid.drip.sender import PAGE_NS

SERVICE_NS: Final = 100 * sky.NS_PER_US
"""The jammer's program is a loop on a software-defined radio; the order takes as long again (`radio.CHANNEL`)."""
WIFI_BURST_NS: Final = 500 * sky.NS_PER_US
"""From the middle of a pack of signatures, which takes 0.35 to 0.43 ms, beyond its end. Its sender would hear a burst
that begins before the frame, and wait for the end of the noise."""
JITTER_NS: Final = 10 * sky.NS_PER_MS
"""advDelay of an advertisement (Bluetooth Core 5.4 vol. 6 part B 4.4.2.2.1)."""
MAX_PAGE: Final = 8
"""Last page of a message of unknown length: nine pages, and the parity page after them."""
ADVERTISING_KHZ: Final = (2_402_000, 2_426_000, 2_480_000)
"""The three advertising channels of Bluetooth."""


@sky.attack(
    "remote_id.suppress_pages",
    technique="T0804",
    effect="receivers get positions without signatures: they come to trust nobody, and trust in others grows stale",
    knowledge="the formats of RFC 9575; it learns the senders' periods from what it hears",
    position="within some hundred metres of the receivers, by power and walls, and where it hears the senders",
    equipment="a software-defined radio for 2.4 GHz that reacts within 0.2 ms, with an amplifier",
    budget="over Wi-Fi 0.5 ms of noise a Manifest; over Bluetooth 4 up to 0.4 s a message",
    placement="the same jammer where it does not hear the senders, or remote_id.jam with as much noise a second",
    realism={
        "missed pages": "simulated: power at each receiver over the part of a frame that the noise covers",
        "drift between the clocks of sender and jammer": "assumed: none; 20 ppm would be 0.1 ms in 5 s",
        "hearing": "simulated: as the companion of an aircraft, which misses half of the advertisements",
        "hearing while it transmits": "assumed: none",
    },
)
class SuppressPages(OrdersNoise, sky.Reception):
    """Jams the frames that carry DRIP signatures: over Wi-Fi by their period, over Bluetooth 4 after their first page.

    Over Wi-Fi it learns the period of each sender's Manifests, and jams the second half of each that is to come. Over
    Bluetooth 4 it hears a page, and jams those that follow it. While it transmits it hears nothing.
    """

    channel: WifiChannel = sky.param("Wi-Fi channel on which it expects packs of signatures.", default=6)

    service_ns: sky.Time = SERVICE_NS
    burst: NoiseRequest
    """An order of noise; its centre, width and duration are replaced."""
    wifi_khz: int
    manifests: ManifestTimes = sky.state(ManifestTimes)
    bluetooth_until: sky.Time = -1
    """End of the noise on the advertising channels."""
    wifi_from: sky.Time = -1
    """Start of the last noise over Wi-Fi."""

    def prepare(self, context: sky.AttackContext) -> None:
        self.burst = NoiseRequest(self.noise_cdbm, 0, 1, 1)
        self.wifi_khz = (2407 + 5 * self.channel) * 1000

    def hear(self, now: sky.Time, arrival: sky.Arrival, header: RidHeader, body: bytes, out: sky.Outbox) -> None:
        """Learn from a Manifest over Wi-Fi; order noise on the pages that follow one over Bluetooth 4."""
        self.manifests.hear_frame(header.address)
        if header.transport == Transport.BT4:
            self._hear_page(now, header, body, arrival.ref, out)
        elif header.transport in (Transport.WIFI_BEACON, Transport.WIFI_NAN) and carries_manifest(body):
            self._hear_manifest(header, body)

    def send_due(self, now: sky.Time, out: sky.Outbox) -> None:
        """Order noise on the Manifests that are to come now."""
        for at_ns in self.manifests.take(now):
            if now - at_ns < WIFI_BURST_NS and self._order(now, (self.wifi_khz,), 20_000, WIFI_BURST_NS, (), out):
                self.wifi_from = now

    def next_wakeup(self) -> sky.Time | None:
        return self.manifests.next_ns

    def _hear_page(self, now: sky.Time, header: RidHeader, body: bytes, ref: sky.FrameId, out: sky.Outbox) -> None:
        if len(body) != SIZE or body[0] >> 4 != MessageType.AUTHENTICATION or header.time_ns <= self.bluetooth_until:
            return
        page, last = body[1] & 0x0F, body[2]
        left = (last if page == 0 and last <= MAX_PAGE else MAX_PAGE) - page + 1  # and the parity page
        until_ns = header.time_ns + max(left, 1) * PAGE_NS + JITTER_NS
        if self._order(now, ADVERTISING_KHZ, 2_000, until_ns - now, (ref,), out):
            self.bluetooth_until = until_ns

    def _hear_manifest(self, header: RidHeader, body: bytes) -> None:
        kind = header.transport
        length_ns = airtime_ns(int(TRANSPORT_WAVEFORM[kind]), len(body) + int(OVERHEAD_BYTES[kind]))
        start_ns = header.time_ns - length_ns
        if header.time_ns > self.wifi_from and start_ns < self.wifi_from + WIFI_BURST_NS + SERVICE_NS:
            return  # it was transmitting itself
        self.manifests.hear_manifest(header.address, start_ns)

    def _order(
        self, now: sky.Time, centres_khz: Iterable[int], width_khz: int, length_ns: sky.Time,
        causes: tuple[sky.FrameId, ...], out: sky.Outbox,
    ) -> bool:  # fmt: skip
        """Order noise on each of these channels until it ends or the attack stops; whether the attack acts."""
        left_us = (min(length_ns, self.schedule.stop_ns - now)) // sky.NS_PER_US
        if not self.schedule.start_ns <= now or left_us <= 0:
            return False
        for centre_khz in centres_khz:
            order = self.burst._replace(
                centre_khz=centre_khz, bandwidth_khz=width_khz, duration_us=left_us, time_ns=now
            )
            out.send(self.up, pack(order), causes)
        return True
