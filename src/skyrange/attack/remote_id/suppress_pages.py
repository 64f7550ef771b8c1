"""Page suppression: noise on the frames that carry DRIP signatures, and not on the ordinary broadcasts between them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.transmission import OrdersNoise, WifiChannel
from skyrange.codec.drip import SamType
from skyrange.codec.f3411 import MessageType
from skyrange.codec.f3411.encode import PACK_HEADER, SIZE
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.codec.remote_id.noise_request import NoiseRequest, pack
from skyrange.core.time import NS_PER_S, NS_PER_US, Time
from skyrange.radio.phy import OVERHEAD_BYTES, TRANSPORT_WAVEFORM, airtime_ns
from skyrange.remoteid.drip.sender import PAGE_NS

LONGEST_NS: Final = 12 * NS_PER_S
"""How long Manifests are remembered: RFC 9575, section 6.3, has one in 5 s at least."""
SHORTEST_NS: Final = NS_PER_S // 2
"""Shortest period that is believed: the recommended one is a second. Frames that come at once have none."""
LONG_NS: Final = 2 * NS_PER_S
ENOUGH: Final = 2
ENOUGH_SHORT: Final = 6
"""Manifests that have to come a period after another one, of periods of at least `LONG_NS` and of shorter ones."""
TOLERANCE_NS: Final = 100 * NS_PER_US
"""Of times that are expected: less than a pack of signatures takes."""
MAX_SURPRISES: Final = 3
"""Manifests out of their times in a row: fewer are late because the channel was busy."""
MAX_SENDERS: Final = 256
MAX_UNHEARD: Final = 60
"""Predictions without any frame of the sender heard; then it is forgotten."""
_DATA_AT: Final = 8
"""Where the authentication data begin in page 0 (F3411-22a, Authentication message)."""


@dataclass(slots=True)
class Rhythm:
    """The times of one sender's Manifests over Wi-Fi, and the period after which they repeat."""

    heard: list[Time] = field(default_factory=list)
    """Starts of the last ones."""
    period_ns: Time | None = None
    unheard: int = 0
    """Manifests expected since any frame of the sender was heard."""
    surprises: int = 0
    """Manifests heard since the last one that came when it was expected."""

    def hear(self, start_ns: Time, *, is_expected: bool) -> list[Time]:
        """Learn from a Manifest that was heard; the times of those to come, if the period is known only now."""
        self.surprises = 0 if is_expected else self.surprises + 1
        if self.surprises > MAX_SURPRISES:
            self.period_ns = None  # the sender has changed its times
        self.heard = [heard_ns for heard_ns in self.heard if start_ns - heard_ns <= LONGEST_NS] + [start_ns]
        if self.period_ns is not None:
            return []
        self.period_ns = find_period(self.heard)
        if self.period_ns is None:
            return []
        self.surprises = 0
        return [heard_ns + self.period_ns for heard_ns in self.heard if heard_ns + self.period_ns > start_ns]


@dataclass(slots=True)
class ManifestTimes:
    """The Manifests (RFC 9575) to come over Wi-Fi, of all senders."""

    rhythms: dict[bytes, Rhythm] = field(default_factory=dict)
    """By address of the sender."""
    _expected: list[tuple[Time, bytes]] = field(default_factory=list)
    """Heap of those to come, with the addresses of their senders."""
    _recent: dict[bytes, Time] = field(default_factory=dict)
    """The last time at which one was expected, by sender."""

    @property
    def next_ns(self) -> Time | None:
        """When the next one is expected."""
        return self._expected[0][0] if self._expected else None

    def hear_frame(self, address: bytes) -> None:
        """Note that a sender is still there."""
        if address in self.rhythms:
            self.rhythms[address].unheard = 0

    def hear_manifest(self, address: bytes, start_ns: Time) -> None:
        """Learn from a Manifest."""
        rhythm = self.rhythms.get(address)
        if rhythm is None:
            while len(self.rhythms) >= MAX_SENDERS:
                self._forget(next(iter(self.rhythms)))
            rhythm = self.rhythms[address] = Rhythm()
        is_expected = abs(start_ns - self._recent.get(address, 0)) <= TOLERANCE_NS
        coming = rhythm.hear(start_ns, is_expected=is_expected)
        if rhythm.period_ns is None or coming:
            self._expect_none_of(address)
        for at_ns in coming:
            heappush(self._expected, (at_ns, address))

    def take(self, now: Time) -> list[Time]:
        """The times of those that are expected until `now`; each is taken once."""
        taken = []
        while self._expected and self._expected[0][0] <= now:
            at_ns, address = heappop(self._expected)
            rhythm = self.rhythms.get(address)
            if rhythm is None or rhythm.period_ns is None:
                continue
            rhythm.unheard += 1
            if rhythm.unheard > MAX_UNHEARD:
                self._forget(address)
                continue
            heappush(self._expected, (at_ns + rhythm.period_ns, address))
            self._recent[address] = at_ns
            taken.append(at_ns)
        return taken

    def _forget(self, address: bytes) -> None:
        del self.rhythms[address]
        self._recent.pop(address, None)
        self._expect_none_of(address)

    def _expect_none_of(self, address: bytes) -> None:
        self._expected = [expected for expected in self._expected if expected[1] != address]
        heapify(self._expected)


def find_period(starts: Sequence[Time]) -> Time | None:
    """The shortest period with which all of these times repeat; `None` while they show none.

    A sender whose program polls slower than it broadcasts has several gaps in turn, and a period that is their sum.
    """
    for first in reversed(starts[:-1]):
        period_ns = starts[-1] - first
        if period_ns < SHORTEST_NS:
            continue
        again = [start_ns for start_ns in starts if start_ns - period_ns >= starts[0] - TOLERANCE_NS]
        if len(again) >= (ENOUGH if period_ns >= LONG_NS else ENOUGH_SHORT) and all(
            any(abs(start_ns - period_ns - other) <= TOLERANCE_NS for other in starts) for start_ns in again
        ):
            return period_ns
    return None


def carries_manifest(body: bytes) -> bool:
    """Whether a pack begins with the first page of a DRIP Manifest, as its first bytes tell."""
    at = PACK_HEADER + _DATA_AT
    return (
        len(body) > at
        and body[0] >> 4 == MessageType.MESSAGE_PACK
        and body[PACK_HEADER] >> 4 == MessageType.AUTHENTICATION
        and body[PACK_HEADER + 1] & 0x0F == 0
        and body[at] == SamType.MANIFEST  # the first byte of the authentication data
    )


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
