"""Wi-Fi channel of a control link: contention, rate, retries, association, and what both ends hear of each other."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from hashlib import blake2b
from typing import Any, Final, NamedTuple

from skyrange.contracts.channel_plans import EndReport, FrameOutcome
from skyrange.contracts.frames import Fate
from skyrange.contracts.links import OpenChannel, Uniforms
from skyrange.contracts.mailboxes import ChannelOrder, End
from skyrange.contracts.medium import Floats
from skyrange.core import elementary
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time
from skyrange.radio.control_link.interference import Interference
from skyrange.radio.control_link.params import WifiParams
from skyrange.radio.control_link.wifi_rates import (
    ACK_BYTES,
    BUSY_DBM,
    CCMP_BYTES,
    CW_MAX,
    CW_MIN,
    DIFS_NS,
    LIFETIME_NS,
    MAX_RETRIES,
    MIN_SNIR_DB,
    OVERHEAD_BYTES,
    SIFS_NS,
    SLOT_NS,
    ack_rate,
    airtime_ns,
    success_probability,
)

BEACON_NS: Final[Time] = 100 * 1024 * NS_PER_US
"""Beacon interval of 100 time units, as access points have it by default."""
BEACON_LOSS_COUNT: Final = 7
"""Beacons in a row without which a client gives up its association, as in Linux's mac80211 (`beacon_loss_count`)."""
BEACON_BYTES: Final = 100
MAX_OCCUPANCY: Final = 0.95
_OUTCOMES: Final = 256
"""Outcomes of frames that are kept; a policy reads them every 20 ms."""
_GOLDEN: Final = 0.6180339887498949
"""One uniform number serves the backoffs of all attempts: each is the last one turned by the golden ratio."""


def wifi_address(name: str) -> bytes:
    """The MAC address of a control radio, locally administered, which its name gives."""
    digest = bytearray(blake2b(f"wifi|{name}".encode(), digest_size=6).digest())
    digest[0] = digest[0] & 0xFC | 0x02
    return bytes(digest)


class AnnouncedChange(NamedTuple):
    """A change of channel that an access point announces in its beacons."""

    order: ChannelOrder
    at: Time
    """When it changes."""


class Transmitter:
    """A radio that sends one frame at a time: an access point, or that of an aircraft."""

    __slots__ = (
        "_queue",
        "address",
        "airtime_ns",
        "announced",
        "busy_until",
        "channel",
        "channel_since",
        "name",
        "occupancy",
        "order",
        "power_dbm",
        "row",
    )

    def __init__(self, name: str, power_dbm: float, channel: int = 1) -> None:
        self.name = name
        self.channel = channel
        self.channel_since: Time = -(2**62)
        """When it came to its channel."""
        self.order: ChannelOrder | None = None
        """The last order to change the channel, not yet carried out."""
        self.announced: AnnouncedChange | None = None
        self.address = wifi_address(name)
        self.power_dbm = power_dbm
        self.row = -1
        """Its row among all radios."""
        self.busy_until: Time = -(2**62)
        self.airtime_ns: Time = 0
        """What it has sent since this was last set to 0."""
        self.occupancy = 0.0
        """Share of time in which others keep its channel busy."""
        self._queue: deque[tuple[Time, int]] = deque()

    def queued_bytes(self, now: Time) -> int:
        """Bytes of the frames that wait or are being sent."""
        while self._queue and self._queue[0][0] <= now:
            self._queue.popleft()
        return sum(size for _, size in self._queue)

    def hold(self, until: Time, size: int) -> None:
        """Have a frame in the queue until it is sent or given up."""
        self.busy_until = until
        self._queue.append((until, size))


class SentFrame(NamedTuple):
    """What became of a frame that a radio sent, as both ends can know it."""

    at: Time
    """When it had been acknowledged or given up."""
    acknowledged: bool
    delivered: bool
    failures: int
    """Transmissions that failed their check although their preamble had the SNIR that their rate needs."""
    other_heard: bool
    """Whether the sender heard the receiver's own frames with that SNIR."""


class Attempt(NamedTuple):
    """One transmission of a frame."""

    start: Time
    end: Time
    rate: int
    """Its place in `RATES_MBPS`."""
    size_bytes: int
    """Length on the air."""


class WifiDirection:
    """One direction of a Wi-Fi link (`skyrange.contracts.links.OpenChannel`)."""

    __slots__ = (
        "_overhead",
        "_queue_bytes",
        "attempts",
        "heard_dbm",
        "interference",
        "latency_ns",
        "link",
        "outcomes",
        "rate",
        "reverse",
        "signal_dbm",
        "thermal_dbm",
        "transmitter",
    )

    reverse: WifiDirection

    def __init__(self, link: WifiLink, transmitter: Transmitter, noise_dbm: float) -> None:
        self.link = link
        self.transmitter = transmitter
        self.interference = Interference(noise_dbm)
        self.latency_ns = link.latency_ns
        self._queue_bytes = link.params.queue_bytes
        self._overhead = link.overhead_bytes
        self.signal_dbm = -math.inf
        """Power of its frames at the receiver."""
        self.rate = 0
        """The rate in use, by its place in `RATES_MBPS`."""
        self.thermal_dbm = noise_dbm
        self.heard_dbm = -math.inf
        """Power of the last frame whose preamble the receiver decoded."""
        self.outcomes: deque[SentFrame] | None = None
        """Of the last frames, in order of time; `None` if nobody reads them."""
        self.attempts: list[Attempt] | None = None
        """The transmissions of the last frame; `None` if nobody listens."""

    def snir_db(self, at: Time) -> float:
        """Signal-to-noise-and-interference ratio at an instant, without reactive jammers."""
        return self.signal_dbm - 10.0 * elementary.log10(self.interference.steady_mw(at))

    def carry(self, now: Time, size: int, draws: Uniforms) -> tuple[Fate, Time, Time | None]:
        """As `OpenChannel.carry`."""
        radio = self.transmitter
        if self.attempts is not None:
            self.attempts.clear()
        if self.link.successes is None:  # nothing is known before the first update, in the first instant of a run
            return Fate.DELIVERED, now + self.latency_ns, None
        if not self.link.accepts_data(now):
            return Fate.LOST, now, None
        start = max(now, radio.busy_until)
        if radio.queued_bytes(now) + size > self._queue_bytes:
            return Fate.OVERFLOW, now, None
        give_up = start + LIFETIME_NS
        length = airtime_ns(self.rate, size + self._overhead)
        answer = ack_rate(self.rate)
        answer_ns = SIFS_NS + airtime_ns(answer, ACK_BYTES)
        window, turn = CW_MIN, draws[1]
        no_frame, no_answer = 1.0, 1.0
        delivered: Time | None = None
        failures, answered_at_last = 0, False
        for _ in range(1 + MAX_RETRIES):
            backoff_ns = int(turn * (window + 1)) * SLOT_NS
            start += int((DIFS_NS + backoff_ns) / (1.0 - radio.occupancy))
            start = self.interference.idle_from(start, BUSY_DBM)
            if start > give_up:
                start = give_up
                break
            end = start + length
            radio.airtime_ns += length + answer_ns
            if self.attempts is not None:
                self.attempts.append(Attempt(start, end, self.rate, size + self._overhead))
            arrives = self._success(start, end, self.rate, size + self._overhead)
            answered = self.reverse._success(end + SIFS_NS, end + answer_ns, answer, ACK_BYTES)
            start = end + answer_ns
            if delivered is None:
                no_frame *= 1.0 - arrives
                if draws[0] >= no_frame:
                    delivered, arrives = end, 1.0
                else:
                    failures += 1
            if delivered is not None:  # without an acknowledgement it is sent again, and the receiver drops the copy
                no_answer *= 1.0 - arrives * answered
                if draws[2] >= no_answer:
                    answered_at_last = True
                    break
            window, turn = min(2 * window + 1, CW_MAX), (turn + _GOLDEN) % 1.0
        radio.hold(start, size)
        if self.outcomes is not None:
            strong = self.snir_db(now) >= MIN_SNIR_DB[self.rate]
            returned = self.reverse.snir_db(now) >= MIN_SNIR_DB[self.rate]
            self.outcomes.append(
                SentFrame(start, answered_at_last, delivered is not None, failures if strong else 0, returned)
            )
        if delivered is None:
            return Fate.LOST, now, None
        return Fate.DELIVERED, delivered + self.latency_ns, None

    def beacon_success(self, at: Time) -> float:
        """The probability that the receiver decodes a beacon that is due at an instant, on the channel of both.

        It is not sent if noise keeps the sender's channel busy until the next one is due.
        """
        start = self.interference.idle_from(at, BUSY_DBM)
        if start - at >= BEACON_NS:
            return 0.0
        return self._success(start, start + airtime_ns(0, BEACON_BYTES), 0, BEACON_BYTES)

    def _success(self, start: Time, end: Time, rate: int, size_bytes: int) -> float:
        """The probability that the receiver decodes a frame on the air from `start` to `end`."""
        return find_success(self.signal_dbm, self.interference, start, end, rate, size_bytes)


def find_success(
    signal_dbm: float, interference: Interference, start: Time, end: Time, rate: int, size_bytes: int
) -> float:
    """The probability that a receiver decodes a frame on the air from `start` to `end`, at a rate, by its place."""
    probability = 1.0
    for share, noise_mw in interference.pieces(start, end):
        snir_db = signal_dbm - 10.0 * elementary.log10(noise_mw)
        probability *= success_probability(rate, snir_db, 8.0 * size_bytes * share)
    return probability


class WifiLink:
    """The Wi-Fi channel of one control link (`skyrange.contracts.links.VariableChannel`)."""

    __slots__ = (
        "_beacon_ns",
        "aircraft",
        "associated",
        "down_until",
        "latency_ns",
        "name",
        "overhead_bytes",
        "params",
        "station",
        "successes",
        "to_aircraft",
        "to_station",
        "told",
    )

    def __init__(self, name: str, params: WifiParams, station: Transmitter, aircraft: Transmitter, noise_dbm: float):
        """`station` is the access point; the links of one operator share it."""
        self.name = name
        self.params = params
        self.overhead_bytes = OVERHEAD_BYTES - (0 if params.encrypted else CCMP_BYTES)
        """Bytes on the air around a frame of the link."""
        self.latency_ns: Time = round(params.latency_ms * NS_PER_MS)
        self.station = station
        self.aircraft = aircraft
        self.to_aircraft = WifiDirection(self, station, noise_dbm)
        self.to_station = WifiDirection(self, aircraft, noise_dbm)
        self.to_aircraft.reverse, self.to_station.reverse = self.to_station, self.to_aircraft
        self.associated = True
        self.told = False
        """Whether the aircraft has heard of the change of channel that its access point announces."""
        self.down_until: Time = -(2**62)
        """Until when the association takes that was lost last."""
        self._beacon_ns: Time | None = None
        self.successes: Floats | None = None
        """(2, rates): average success of each rate, to the aircraft and to the station; `None` before the first
        update."""

    def open(self, direction: str) -> OpenChannel:
        """The direction `fwd`, from the station to the aircraft, or `rev`."""
        return self.to_aircraft if direction == "fwd" else self.to_station

    def describe(self) -> Mapping[str, Any]:
        """What the manifest says of it."""
        return {"kind": "wifi", "access_point": self.station.name, **self.params.model_dump(mode="json")}

    def watch(self) -> None:
        """Keep what becomes of frames, for `report`."""
        for direction in (self.to_aircraft, self.to_station):
            direction.outcomes = deque(maxlen=_OUTCOMES)

    def report(self, end: End, since: Time, now: Time) -> EndReport:
        """What an end knows at `now`, with the outcomes that it has known since `since`. It changes nothing."""
        aircraft = end == "aircraft"
        sends, receives = (self.to_station, self.to_aircraft) if aircraft else (self.to_aircraft, self.to_station)
        outcomes = [
            FrameOutcome(
                frame.at, is_own, frame.acknowledged if is_own else frame.delivered, 0 if is_own else frame.failures
            )
            for is_own, frames in ((True, sends.outcomes), (False, receives.outcomes))
            for frame in frames or ()
            if since < frame.at <= now and (not is_own or frame.acknowledged or frame.other_heard)
        ]
        return EndReport(
            self.name,
            (self.aircraft if aircraft else self.station).channel,
            self.associated,
            receives.heard_dbm - receives.thermal_dbm,
            sorted(outcomes),
        )

    def accepts_data(self, at: Time) -> bool:
        """Whether its ends accept data frames: a station without association drops them (IEEE 802.11-2020, 11.3)."""
        return self.associated and at >= self.down_until

    def retune(self, order: ChannelOrder) -> None:
        """As `TunableChannel.retune`."""
        (self.aircraft if order.end == "aircraft" else self.station).order = order

    def update_association(self, now: Time, *, beacons_heard: bool) -> str:
        """Give up the association after too many lost beacons, and find it again; returns why, if it has changed."""
        if beacons_heard:
            self._beacon_ns = now
            if not self.associated:
                self.associated = True
                self.disconnect(now)
                return "beacons"
        elif self._beacon_ns is None:
            self._beacon_ns = now
        elif self.associated and now - self._beacon_ns > BEACON_LOSS_COUNT * BEACON_NS:
            self.associated = False
            return "no beacons"
        return ""

    def disconnect(self, now: Time) -> None:
        """Lose the association at `now`; the next one takes its time."""
        self.down_until = max(self.down_until, now + round(self.params.reassociation_ms * NS_PER_MS))
