"""Channel change: access point and aircraft leave a jammed Wi-Fi channel, or hop all the time.

Jamming is told from distance by a consistency check (Xu, Trappe, Zhang & Wood, MobiHoc 2005): frames are lost although
the other end is received with the SNIR that their rate needs. A frame is given up after eight transmissions. While the
rate control finds a rate at which half of them succeed or more, at most one frame in 256 is given up; a run of frames
that were all given up is jamming, at a stated rate of false alarms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final

from pydantic import AfterValidator, BeforeValidator, Field

import skyrange.plugin as sky
from skyrange.contracts.channel_plans import EndReport
from skyrange.contracts.mailboxes import ChannelOrder
from skyrange.core import elementary
from skyrange.defence.placement import Alarm
from skyrange.radio.control_link.wifi_link import BEACON_LOSS_COUNT, BEACON_NS
from skyrange.radio.control_link.wifi_rates import MAX_RETRIES, MIN_SNIR_DB

APART: Final = 4
"""Channels this far apart, 20 MHz, do not overlap."""
GIVEN_UP: Final = 2.0 ** -(1 + MAX_RETRIES)
"""Probability that a frame is given up without jamming, at most."""
FRAMES_PER_H: Final = 3600 * 50
"""Frames an hour of one link at most, for the rate of false alarms: assumed, telemetry has some 15 a second."""
REASSOCIATION_NS: Final[sky.Time] = 400 * sky.NS_PER_MS
"""Longest time for a new association in measurements (Mishra, Shin & Arbaugh, 2003)."""


def _channels(numbers: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(numbers)) < len(numbers):
        raise sky.refuse(sky.Problem("", repr(list(numbers)), "each channel once"))
    if len(numbers) and max(numbers) - min(numbers) < APART:
        hint = "Channels less than 20 MHz apart overlap: 1, 6 and 11 do not."
        raise sky.refuse(sky.Problem("", repr(list(numbers)), "two channels at least 4 numbers apart", hint))
    return numbers


_Channel = Annotated[sky.Whole, Field(ge=1, le=13)]
_Channels = Annotated[
    tuple[_Channel, ...], BeforeValidator(sky.items, json_schema_input_type=list[int]), AfterValidator(_channels)
]


@sky.defence(
    "control_link.channel_change",
    surface=("gcs", "medium"),
    place="the radios of access point and aircraft; each knows acknowledgements, failed check sequences, the power of "
    "the other end and its association",
    effect="both ends go on on another channel, where the jammer is not",
    alerts=("channel.jammed", "channel.lost"),
    against=("control_link.reactive_jam", "remote_id.jam"),
    evasion="jams all channels of the list at once, or finds the new channel and follows",
    cost="nothing on a good link; an aircraft out of reach scans, and is found later; with hop_s some milliseconds "
    "without frames a hop",
    nominal=("hop",),
    realism={
        "frames and beacons": "simulated: power of signal and noise over each frame",
        "announcement": "cited: IEEE 802.11-2020, 11.8.8; three beacons are assumed",
        "scan": "cited: passive scan of 111 ms a channel, Linux's mac80211; the new association takes the link's "
        "reassociation_ms after the access point was found",
        "jamming told from distance": "cited: Xu, Trappe, Zhang & Wood, 2005; an access point that tells its frames "
        "apart by sender although the check failed is assumed",
        "shared hop sequence": "assumed: no Wi-Fi product hops",
    },
)
class ChannelChange(sky.ChannelDefence):
    """Leaves a jammed Wi-Fi channel by a Channel Switch Announcement, or by a scan once the association is lost."""

    channels: _Channels = sky.param(
        "Wi-Fi channels that both ends know, in the order in which they are tried; channel 6 is that of Remote ID.",
        default=(1, 11), min_length=2, max_length=13,
    )  # fmt: skip
    false_alarms_per_h: sky.Number = sky.param(
        "False alarms an hour and link, at most, from which the number of frames in a row that are given up follows: 4 "
        "by default.",
        default=0.01, gt=0, le=3600,
    )  # fmt: skip
    announcements: sky.Whole = sky.param(
        "Beacons in which the access point announces a change, one every 102.4 ms (IEEE 802.11-2020, 11.8.8; the "
        "number is assumed).",
        default=3, ge=1, le=50,
    )  # fmt: skip
    dwell_ms: sky.Number = sky.param(
        "Time on each channel of a scan in milliseconds; 111: a passive scan of Linux's mac80211, HZ/9.",
        default=111.0, ge=1, le=10_000,
    )  # fmt: skip
    retune_ms: sky.Number = sky.param(
        "Time in milliseconds in which a radio that changes its channel carries nothing; 5: as Linux's iwlwifi plans "
        "(IWL_CHANNEL_TUNE_TIME).",
        default=5.0, ge=0, le=1000,
    )  # fmt: skip
    margin_db: sky.Number = sky.param(
        "A lost association is jamming if the other end was last received with the SNIR of 6 Mb/s and this many dB "
        "more; 20: in Rayleigh fading 1 % of the time is weaker than the mean by that much.",
        default=20.0, ge=0, le=60,
    )  # fmt: skip
    hop_s: sky.Number | None = sky.param(
        "Both ends change by a pseudo-random sequence that they share, every so many seconds, attacked or not; "
        "default: they change only when they must. Their clocks agree by the beacons' time stamps (assumed).",
        default=None, gt=0.1, le=3600,
    )  # fmt: skip
    chance: sky.Chance

    def prepare(self, context: sky.DefenceContext) -> None:
        self.chance = context.chance

    def make_station(self, address: bytes, links: Sequence[str]) -> StationPolicy:
        """See `ChannelDefence`."""
        alarms = {link: Alarm(link.partition(":")[2]) for link in links}
        return StationPolicy(self, needed_in_a_row(self.false_alarms_per_h), alarms, self._hops(address))

    def make_aircraft(self, address: bytes, link: str) -> AircraftPolicy:
        """See `ChannelDefence`."""
        return AircraftPolicy(self, Alarm(link.partition(":")[2]), self._hops(address))

    def _hops(self, address: bytes) -> HopSequence | None:
        if self.hop_s is None:
            return None
        return HopSequence(sky.from_seconds(self.hop_s), self.channels, self.chance, sky.hash64(address.hex()))


@dataclass(slots=True)
class _Run:
    """Frames of one link in a row that were given up."""

    own: int = 0
    failed: int = 0
    """Transmissions of the other end in a row that failed their check."""

    def count(self, report: EndReport) -> int:
        """Count the new outcomes; returns how many frames in a row were given up."""
        for outcome in report.outcomes:
            if outcome.own:
                self.own = 0 if outcome.ok else self.own + 1
            else:
                self.failed = 0 if outcome.ok else self.failed + outcome.failures
        return max(self.own, self.failed // (1 + MAX_RETRIES))


@dataclass(slots=True)
class HopSequence:
    """The channel of each hop; both ends have the same."""

    period_ns: sky.Time
    channels: tuple[int, ...]
    chance: sky.Chance
    key: int
    _hop: int = -1

    def next(self, now: sky.Time) -> int | None:
        """The channel to change to, once for each hop; else `None`."""
        hop = now // self.period_ns
        if hop == self._hop:
            return None
        self._hop = hop
        return self.channels[int(self.chance.uniform4("channel hop", self.key, hop, 0)[0] * len(self.channels))]


@dataclass(slots=True)
class StationPolicy:
    """An access point that leaves a jammed channel, and announces it.

    It stays on a channel for as long as an aircraft that missed the announcement needs at most to find it there. While
    an aircraft is away that was received well, it goes on along its list, because the last channel may be jammed.
    """

    params: ChannelChange
    needed: int
    alarms: Mapping[str, Alarm]
    hops: HopSequence | None
    _runs: dict[str, _Run] = field(default_factory=dict)
    _settled_ns: sky.Time = 0

    def step(self, now: sky.Time, reports: Sequence[EndReport]) -> list[ChannelOrder | sky.Alert]:
        """As `ChannelPolicy.step`."""
        acts: list[ChannelOrder | sky.Alert] = []
        channel = reports[0].channel
        if now < self._settled_ns:
            self._runs.clear()
            return [*self._hop(now, reports[0])]
        jammed: EndReport | None = None
        for report in reports:
            run = self._runs.setdefault(report.link, _Run()).count(report)
            if run < self.needed if report.associated else not was_near(report, self.params):
                continue
            score = run / self.needed if report.associated else 1.0
            acts += self.alarms[report.link].raise_at(
                now, "channel.jammed", score, link=report.link, channel=channel, given_up=run
            )
            jammed = jammed or report
        if self.hops is not None:
            return [*acts, *self._hop(now, reports[0])]
        if jammed is not None:
            new_channel = next_channel(channel, self.params.channels)
            announced = self.params.announcements
            retune_ns = round(self.params.retune_ms * sky.NS_PER_MS)
            acts.append(ChannelOrder(jammed.link, "station", new_channel, announced, retune_ns))
            self._settled_ns = now + announced * BEACON_NS + stay_ns(self.params)
        return acts

    def _hop(self, now: sky.Time, report: EndReport) -> list[ChannelOrder]:
        return _hop(self.hops, now, report, "station", self.params)


@dataclass(slots=True)
class AircraftPolicy:
    """An aircraft's radio that scans for its access point while it has no association."""

    params: ChannelChange
    alarm: Alarm
    hops: HopSequence | None
    _next_ns: sky.Time | None = None

    def step(self, now: sky.Time, reports: Sequence[EndReport]) -> list[ChannelOrder | sky.Alert]:
        """As `ChannelPolicy.step`."""
        report = reports[0]
        acts: list[ChannelOrder | sky.Alert] = []
        if report.associated:
            self._next_ns = None
        elif self._next_ns is None:
            self._next_ns = now
            if was_near(report, self.params):
                acts += self.alarm.raise_at(now, "channel.lost", 1.0, link=report.link, channel=report.channel)
        if self.hops is not None:
            return [*acts, *_hop(self.hops, now, report, "aircraft", self.params)]
        if self._next_ns is not None and now >= self._next_ns:
            self._next_ns = now + round(self.params.dwell_ms * sky.NS_PER_MS)
            new_channel = after(report.channel, self.params.channels)
            acts.append(ChannelOrder(report.link, "aircraft", new_channel, action="scan"))
        return acts


def was_near(report: EndReport, params: ChannelChange) -> bool:
    """Whether the other end was last received so well that distance and fading do not explain its absence."""
    return bool(report.snr_db >= MIN_SNIR_DB[0] + params.margin_db)


def needed_in_a_row(false_alarms_per_h: float) -> int:
    """Frames in a row that have to be given up, so that chance makes no more than that many alarms an hour."""
    return max(1, math.ceil(elementary.log(false_alarms_per_h / FRAMES_PER_H) / elementary.log(GIVEN_UP)))


def after(channel: int, channels: Sequence[int]) -> int:
    """The channel after `channel` in the list, or the first one if it is not there."""
    return channels[(channels.index(channel) + 1) % len(channels)] if channel in channels else channels[0]


def next_channel(channel: int, channels: Sequence[int]) -> int:
    """The next channel in the list that does not overlap with `channel`."""
    candidate = channel
    for _ in channels:
        candidate = after(candidate, channels)
        if abs(candidate - channel) >= APART:
            return candidate
    return after(channel, channels)


def stay_ns(params: ChannelChange) -> sky.Time:
    """Longest time in which an aircraft finds the access point on a new channel: lost beacons, a scan, association."""
    scan_ns = round((len(params.channels) + 1) * params.dwell_ms * sky.NS_PER_MS)
    return (1 + BEACON_LOSS_COUNT) * BEACON_NS + scan_ns + REASSOCIATION_NS


def _hop(
    hops: HopSequence | None, now: sky.Time, report: EndReport, end: str, params: ChannelChange
) -> list[ChannelOrder]:
    new_channel = hops.next(now) if hops is not None else None
    if new_channel is None or new_channel == report.channel:
        return []
    retune_ns = round(params.retune_ms * sky.NS_PER_MS)
    return [ChannelOrder(report.link, "station" if end == "station" else "aircraft", new_channel, 0, retune_ns, "hop")]
