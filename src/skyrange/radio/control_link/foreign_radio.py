"""Radio of somebody else on the channel of a Wi-Fi link: how its frames reach the ends, and what it hears of theirs.

An attacker's card in monitor mode sends whole 802.11 frames with the addresses of the link's ends (Linux,
Documentation/networking/mac80211-injection.rst). Here each is one transmission at 6 Mb/s, after DIFS and backoff, with
the flag IEEE80211_RADIOTAP_F_TX_NOACK: the receiver's acknowledgement goes to the address that the frame claims, so the
attacker's card would wait for it in vain. A receiver accepts such a frame if it decodes it, is associated (a data frame
is one of class 3: IEEE 802.11-2020, 11.3), and can decrypt it, where the link is encrypted (12.5.3.4).
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.contracts.frames import Fate
from skyrange.contracts.links import OpenChannel, RadioSite, Uniforms
from skyrange.core.time import Time
from skyrange.radio.control_link.interference import Interference
from skyrange.radio.control_link.params import WifiParams
from skyrange.radio.control_link.wifi_link import Transmitter, WifiLink, find_success
from skyrange.radio.control_link.wifi_rates import (
    ACK_BYTES,
    BUSY_DBM,
    CW_MIN,
    DIFS_NS,
    LIFETIME_NS,
    SIFS_NS,
    SLOT_NS,
    airtime_ns,
)

RATE: Final = 0
"""Place of 6 Mb/s in `RATES_MBPS`: the lowest of OFDM, which reaches farthest."""
QUEUE_BYTES: Final = int(WifiParams.model_fields["queue_bytes"].default)
"""Size of its queue: that of the link's radios by default (assumed)."""


class AirPath:
    """The way from one radio to another: power of the signal at the receiver, and the noise that it meets there."""

    __slots__ = ("interference", "signal_dbm")

    def __init__(self, noise_dbm: float) -> None:
        self.signal_dbm = -math.inf
        """Before the first update nothing is received."""
        self.interference = Interference(noise_dbm)

    def success(self, start: Time, end: Time, rate: int, size_bytes: int) -> float:
        """The probability that the receiver decodes a frame on the air from `start` to `end`."""
        return find_success(self.signal_dbm, self.interference, start, end, rate, size_bytes)


class ForgedDirection:
    """Frames that it sends to one end in the name of the other (`skyrange.contracts.links.OpenChannel`)."""

    __slots__ = ("_radio", "path")

    def __init__(self, radio: ForeignRadio, noise_dbm: float) -> None:
        self._radio = radio
        self.path = AirPath(noise_dbm)

    def carry(self, now: Time, size: int, draws: Uniforms) -> tuple[Fate, Time, Time | None]:
        """As `OpenChannel.carry`."""
        sender, link = self._radio.transmitter, self._radio.link
        if sender.queued_bytes(now) + size > QUEUE_BYTES:
            return Fate.OVERFLOW, now, None
        start = max(now, sender.busy_until)
        give_up = start + LIFETIME_NS
        backoff_ns = int(draws[1] * (CW_MIN + 1)) * SLOT_NS
        start += int((DIFS_NS + backoff_ns) / (1.0 - sender.occupancy))
        start = self.path.interference.idle_from(start, BUSY_DBM)
        if start > give_up:
            sender.hold(give_up, size)
            return Fate.LOST, now, None
        length = size + link.overhead_bytes
        end = start + airtime_ns(RATE, length)
        sender.airtime_ns += end - start
        sender.hold(end, size)
        if draws[0] < 1.0 - self.path.success(start, end, RATE, length):
            return Fate.LOST, now, None
        sender.airtime_ns += SIFS_NS + airtime_ns(RATE, ACK_BYTES)  # the receiver answers before it decrypts
        if not link.accepts_data(end) or not self._radio.can_decrypt:
            return Fate.LOST, now, None
        return Fate.DELIVERED, end + link.latency_ns, None


class ForeignRadio:
    """A radio that is none of a Wi-Fi link's ends (`skyrange.contracts.links.OwnRadio`).

    It stays on the channel that the link has in the scenario.
    """

    __slots__ = ("can_decrypt", "from_aircraft", "from_station", "link", "to_aircraft", "to_station", "transmitter")

    def __init__(self, link: WifiLink, site: RadioSite, transmitter: Transmitter, noise_dbm: float) -> None:
        """`transmitter` is what all radios of one name and channel share; `noise_dbm` is that of every receiver."""
        self.link = link
        self.transmitter = transmitter
        self.can_decrypt = site.has_key or not link.params.encrypted
        self.to_aircraft, self.to_station = ForgedDirection(self, noise_dbm), ForgedDirection(self, noise_dbm)
        self.from_station, self.from_aircraft = AirPath(noise_dbm), AirPath(noise_dbm)
        for direction in (link.to_aircraft, link.to_station):
            direction.attempts = []

    def open(self, direction: str) -> OpenChannel:
        """As `OwnRadio.open`."""
        return self.to_aircraft if direction == "fwd" else self.to_station

    def hear(self, direction: str, draw: float) -> Time | None:
        """As `OwnRadio.hear`: the first of the frame's transmissions that it decodes is enough.

        One that sends meanwhile hears all the same.
        """
        if not self.can_decrypt:
            return None
        fwd = direction == "fwd"
        sent, path = (self.link.to_aircraft, self.from_station) if fwd else (self.link.to_station, self.from_aircraft)
        missed = 1.0
        for attempt in sent.attempts or ():
            missed *= 1.0 - path.success(*attempt)
            if draw >= missed:
                return attempt.end
        return None
