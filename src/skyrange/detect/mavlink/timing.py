"""MAVLink timing detector: periodic messages that come late, early or irregularly, by CUSUM charts of their intervals.

It reads the headers of all MAVLink frames that arrive at a link end, and the times from one message of a sender to its
next. For each stream (sender and message) it learns mean and standard deviation of the intervals from `learn_after_s`
on for `learn_s`; a stream is periodic if it had at least eight intervals and a standard deviation below half the mean.
Each further interval gives z, its deviation from the mean in standard deviations (at least `least_deviation_s`, since
programs poll). Three CUSUM charts (Page 1954; see `cusum`) accumulate z − k for late, −z − k for early messages, and
(√|z| − 0.822)/0.349 − k for irregular ones; the root is nearly standard normal if z is. The score is the highest sum
divided by the decision interval h.

`shift` is the change of the mean that the charts are designed for, in standard deviations, k is half of it (Page), and
h gives each stream one false alarm in `false_alarm_s` on average, if intervals are independent and normal: each chart
has three times that average run length. 100 aircraft with ten streams have a thousand times as many alarms.

Losses are no change of the times: one interval counts as one value of at most `clip`, and if it is as long as m + 1
periods, as m values. So one lost message raises nothing, and four in a row do, as a delay that begins does.

It cannot detect a constant delay that has begun before, delays below the deviations that it has learned, and an
attacker who sends in the rhythm of the true sender. Heartbeats that report another mode than the one before are left
out, since autopilots send them beside the regular ones. Silence is `heartbeat.gap`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import log10
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from skyrange.contracts.alerts import Alert
from skyrange.contracts.detectors import DetectorContext, DetectorPlugin
from skyrange.contracts.frames.payloads import Ints
from skyrange.contracts.monitors import Monitor, ObservedFrames
from skyrange.contracts.params import Number
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_MS, Time, from_seconds
from skyrange.detect.episodes import EpisodeParams, Episodes, subject_of_link
from skyrange.detect.mavlink.cusum import find_interval
from skyrange.detect.mavlink.heads import MessageHeads, name_message, read_heads
from skyrange.detect.streams import StreamNumbers, extend
from skyrange.detect.telemetry import read_messages

KIND = "mavlink.timing"
ABOUT = "Raises an alert if periodic MAVLink messages come late, early or irregularly (CUSUM charts)."
SERVICE_NS: Time = 500 * NS_PER_MS
CHARTS: Final = ("late", "early", "irregular")
LEAST_INTERVALS: Final = 8
MOST_VARIATION: Final = 0.5
MOST_SCORE: Final = 64.0
"""Highest score of a chart, so that it recovers after a flood."""
_ROOT_MEAN: Final = 0.822179
"""E √|z| = 2^(1/4) Γ(3/4)/√π of a standard normal z."""
_ROOT_DEVIATION: Final = 0.349138
"""√(√(2/π) − E² √|z|)."""
_FRESH, _WATCHED, _IGNORED = 0, 1, 2
_COUNT, _SUM, _SQUARES, _MEAN, _DEVIATION, _INTERVAL = range(6)
Floats = NDArray[np.float64]


class TimingParams(EpisodeParams):
    """Parameters of the MAVLink timing detector."""

    learn_after_s: Number = Field(
        default=3.0, ge=0.0, le=3600.0, description="Time before the detector learns intervals, in seconds."
    )
    learn_s: Number = Field(
        default=12.0, ge=5.0, le=86_400.0, description="Time in which the detector learns intervals, in seconds."
    )
    least_deviation_s: Number = Field(
        default=0.02,
        ge=1e-6,
        le=10.0,
        description="Least standard deviation of intervals, in seconds. Ground stations poll every 20 ms.",
    )
    shift: Number = Field(
        default=1.0, ge=0.1, le=10.0, description="Change to be found soonest, in standard deviations."
    )
    clip: Number = Field(
        default=4.0, ge=1.0, le=1000.0, description="Most standard deviations that one period contributes."
    )
    false_alarm_s: Number = Field(
        default=36_000.0,
        ge=60.0,
        le=1e8,
        description="Average time between false alarms of one stream, in seconds.",
    )


@compiled
def _accumulate(
    streams: Ints, at_ns: Ints, last_ns: Ints, phase: Ints, learned: Floats, charts: Floats, clip: float,
    reference: float, begin_ns: int, end_ns: int, peaks: Floats, which: Ints,
) -> None:  # fmt: skip
    """Learn from the intervals or add them to the charts; writes each row's highest sum over h, and its chart."""
    for row in range(streams.shape[0]):
        stream, at = streams[row], at_ns[row]
        last = last_ns[stream]
        last_ns[stream] = at
        peaks[row], which[row] = 0.0, 0
        if last < 0 or last < begin_ns:
            continue
        interval = (at - last) / 1e9
        facts = learned[stream]
        if at < end_ns:
            facts[_COUNT] += 1.0
            facts[_SUM] += interval
            facts[_SQUARES] += interval * interval
            continue
        if phase[stream] != _WATCHED:
            continue
        z = (interval - facts[_MEAN]) / facts[_DEVIATION]
        periods = max(1.0, np.rint(interval / facts[_MEAN]) - 1.0)
        most = clip * periods
        z = min(max(z, -clip), most)
        root = (np.sqrt(min(abs(z), clip)) - _ROOT_MEAN) / _ROOT_DEVIATION
        chart = charts[stream]
        chart[0] += z - reference
        chart[1] -= z + reference
        chart[2] += min(root, clip) - reference
        for place in range(3):
            chart[place] = min(max(chart[place], 0.0), MOST_SCORE * facts[_INTERVAL])
            if chart[place] > peaks[row]:
                peaks[row], which[row] = chart[place], place
        peaks[row] /= facts[_INTERVAL]


class TimingDetector:
    """A `skyrange.contracts.monitors.Monitor`. The subject of an alert is the owner of the link."""

    service_ns: Time = SERVICE_NS

    def __init__(self, params: TimingParams) -> None:
        self._params = params
        self._begin_ns = from_seconds(params.learn_after_s)
        self._end_ns = self._begin_ns + from_seconds(params.learn_s)
        self._reference = params.shift / 2.0
        self._streams = StreamNumbers()
        self._states: dict[int, tuple[int, int, int]] = {}
        self._last_ns = np.zeros(0, dtype=np.int64)
        self._phase = np.zeros(0, dtype=np.int64)
        self._learned = np.zeros((0, 6))
        self._charts = np.zeros((0, 3))
        self._episodes = Episodes(params)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Take in the messages since the last service. Returns an alert for each stream that begins or doubles."""
        heads = read_heads(frames)
        heads = heads.take(heads.received & ~self._is_extra(frames, heads))
        if not len(heads.rows):
            return []
        streams = self._streams.assign(heads.senders << 24 | heads.messages)
        self._grow(len(self._streams))
        if now >= self._end_ns:
            self._design(np.unique(streams[self._phase[streams] == _FRESH]))
        peaks, which = np.zeros(len(streams)), np.zeros(len(streams), dtype=np.int64)
        _accumulate(
            streams, heads.at_ns, self._last_ns, self._phase, self._learned, self._charts, self._params.clip,
            self._reference, self._begin_ns, self._end_ns, peaks, which,
        )  # fmt: skip
        raised, scores = self._episodes.update(heads.at_ns, streams, peaks)
        alerts = []
        for row, score in zip(raised.tolist(), scores.tolist(), strict=True):
            stream = int(streams[row])
            link = frames.ports[int(heads.places[row])].link
            data: dict[str, str | float] = {
                "link": link,
                "system": int(heads.systems[row]),
                "component": int(heads.components[row]),
                "message": name_message(int(heads.messages[row])),
                "period_s": float(self._learned[stream, _MEAN]),
                "deviation_s": float(self._learned[stream, _DEVIATION]),
            }
            kind = f"{KIND}.{CHARTS[int(which[row])]}"
            alerts.append(Alert(int(heads.at_ns[row]), subject_of_link(link), kind, score, data))
        return alerts

    def _is_extra(self, frames: ObservedFrames, heads: MessageHeads) -> NDArray[np.bool_]:
        """(n,) whether a head is of a heartbeat that reports another mode or state than the one before it."""
        beats = read_messages(frames, "HEARTBEAT")
        extra = np.zeros(len(frames), dtype=np.bool_)
        senders = np.zeros(len(frames), dtype=np.int64)
        senders[heads.rows] = heads.senders
        values = beats.values
        states = zip(*(values[name].tolist() for name in ("custom_mode", "base_mode", "system_status")), strict=True)
        for row, state in zip(beats.rows.tolist(), states, strict=True):
            sender = int(senders[row])
            extra[row] = self._states.get(sender, state) != state
            self._states[sender] = state
        return extra[heads.rows]

    def _design(self, streams: Ints) -> None:
        """Decide which streams are periodic, and compute their charts."""
        params = self._params
        for stream in streams.tolist():
            facts = self._learned[stream]
            count = facts[_COUNT]
            self._phase[stream] = _IGNORED
            if count < LEAST_INTERVALS:
                continue
            mean = facts[_SUM] / count
            deviation = np.sqrt(max(0.0, facts[_SQUARES] / count - mean * mean) * count / (count - 1.0))
            if deviation > MOST_VARIATION * mean:
                continue
            length = round(log10(min(max(3.0 * params.false_alarm_s / mean, 10.0), 1e9)), 2)  # few different ones
            facts[_MEAN], facts[_DEVIATION] = mean, max(deviation, params.least_deviation_s)
            facts[_INTERVAL] = find_interval(self._reference, 10.0**length)
            self._phase[stream] = _WATCHED

    def _grow(self, size: int) -> None:
        self._phase = extend(self._phase, size, _FRESH)
        self._last_ns = extend(self._last_ns, size, -1)
        self._learned, self._charts = extend(self._learned, size, 0.0), extend(self._charts, size, 0.0)


def make_timing_detector(params: TimingParams, context: DetectorContext | None = None) -> Monitor:
    """A new detector."""
    return TimingDetector(params)


MAVLINK_TIMING = DetectorPlugin(TimingParams, make_timing_detector, ABOUT)
