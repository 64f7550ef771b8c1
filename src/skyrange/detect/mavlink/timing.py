"""MAVLink timing detector: periodic messages that come late, early or irregularly, by CUSUM charts of their intervals.

It reads the headers of all MAVLink frames that arrive at a link end, and the times from one message of a sender to its
next. For each stream (sender and message) it learns mean and standard deviation of the intervals from `learn_after_s`
on for `learn_s`; a stream is periodic if it had at least eight intervals and a standard deviation below half the mean.
Each further interval gives z, its deviation from the mean in standard deviations (at least `least_deviation_s`, since
programs poll). Three CUSUM charts (Page 1954, `run_length`) accumulate z − k for late, −z − k for early messages, and
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
from functools import cache
from math import sqrt
from typing import Final, NamedTuple

import numpy as np

import skyrange.plugin as sky
from skyrange.contracts.frames import Ints
from skyrange.core import elementary, matrices
from skyrange.core.compiled import compiled
from skyrange.core.elementary import log, log10
from skyrange.detect.messages import Flags, MessageHeads
from skyrange.detect.series import Floats

STATES = 100
_SCALE = sqrt(2.0)


def run_length(reference: float, interval: float) -> float:
    """The average number of standard normal values to an alarm; `reference` is k and `interval` is h.

    A one-sided CUSUM of standard normal values z (E. S. Page, "Continuous Inspection Schemes", Biometrika 41, 1954) is
    S ← max(0, S + z − k), with an alarm at S ≥ h. Its average run length follows from a Markov chain over a division of
    0…h (D. Brook and D. A. Evans, "An approach to the probability distribution of cusum run length", Biometrika 59,
    1972).
    """
    width = 2.0 * interval / (2 * STATES - 1)
    steps = (np.arange(-STATES, STATES) + 0.5) * width + reference
    below = np.array([0.5 * elementary.erfc(-step / _SCALE) for step in steps.tolist()])
    probability = np.diff(below)  # of a step of j − STATES + 1 states
    places = np.arange(STATES)
    moves = places[None, :] - places[:, None]
    chain = probability[moves + STATES - 1]
    chain[:, 0] = below[STATES - places]
    return float(matrices.solve(np.eye(STATES) - chain, np.ones(STATES))[0])


@cache
def find_interval(reference: float, length: float) -> float:
    """The decision interval h whose average run length is `length` values (10 … 1e9), to 0.1 %."""
    low, high = 0.05, 0.1 + 2.0 * log(length) / reference
    while high - low > 1e-3 * low:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run_length(reference, middle) < length else (low, middle)
    return 0.5 * (low + high)


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


@sky.detector("mavlink.timing")
class MessageTiming(sky.MessageDetector):
    """Raises an alert if periodic MAVLink messages come late, early or irregularly (CUSUM charts)."""

    learn_after_s: sky.Number = sky.param(
        "Time before the detector learns intervals, in seconds.", default=3.0, ge=0.0, le=3600.0
    )
    learn_s: sky.Number = sky.param(
        "Time in which the detector learns intervals, in seconds.", default=12.0, ge=5.0, le=86_400.0
    )
    least_deviation_s: sky.Number = sky.param(
        "Least standard deviation of intervals, in seconds. Ground stations poll every 20 ms.",
        default=0.02, ge=1e-6, le=10.0,
    )  # fmt: skip
    shift: sky.Number = sky.param("Change to be found soonest, in standard deviations.", default=1.0, ge=0.1, le=10.0)
    clip: sky.Number = sky.param(
        "Most standard deviations that one period contributes.", default=4.0, ge=1.0, le=1000.0
    )
    false_alarm_s: sky.Number = sky.param(
        "Average time between false alarms of one stream, in seconds.", default=36_000.0, ge=60.0, le=1e8
    )
    states: dict[int, tuple[int, int, int]] = sky.state(dict)
    """Sender → mode and state in its last heartbeat."""
    last_ns: Ints = sky.table()
    phase: Ints = sky.table()
    learned: Floats = sky.table(6, dtype=np.float64)
    charts: Floats = sky.table(3, dtype=np.float64)

    def select(self, frames: sky.ObservedFrames, heads: MessageHeads) -> MessageHeads:
        """Those that arrived, without heartbeats that report another mode or state than the one before."""
        return heads.take(heads.received & ~self._is_extra(frames, heads))

    def judge(self, now: sky.Time, frames: sky.ObservedFrames, heads: MessageHeads) -> Sequence[sky.Alert]:
        """Take in the messages since the last service. Returns an alert for each stream that begins or doubles."""
        begin_ns = sky.from_seconds(self.learn_after_s)
        end_ns = begin_ns + sky.from_seconds(self.learn_s)
        streams = self.number(heads.senders << 24 | heads.messages, phase=_FRESH, last_ns=-1, learned=0.0, charts=0.0)
        if now >= end_ns:
            self._design(np.unique(streams[self.phase[streams] == _FRESH]))
        peaks, which = np.zeros(len(streams)), np.zeros(len(streams), dtype=np.int64)
        memory = _Memory(self.last_ns, self.phase, self.learned, self.charts)
        _accumulate(streams, heads.at_ns, memory, _Limits(self.clip, self.shift / 2.0, begin_ns, end_ns), peaks, which)
        learned = self.learned
        return self.alerts(
            frames, heads, streams, peaks,
            lambda row: (CHARTS[int(which[row])], {
                "period_s": float(learned[streams[row], _MEAN]),
                "deviation_s": float(learned[streams[row], _DEVIATION]),
            }),
        )  # fmt: skip

    def _is_extra(self, frames: sky.ObservedFrames, heads: MessageHeads) -> Flags:
        """(n,) whether a head is of a heartbeat that reports another mode or state than the one before it."""
        beats = sky.read_messages(frames, "HEARTBEAT")
        extra = np.zeros(len(frames), dtype=np.bool_)
        senders = np.zeros(len(frames), dtype=np.int64)
        senders[heads.rows] = heads.senders
        values = beats.values
        states = zip(*(values[name].tolist() for name in ("custom_mode", "base_mode", "system_status")), strict=True)
        for row, state in zip(beats.rows.tolist(), states, strict=True):
            sender = int(senders[row])
            extra[row] = self.states.get(sender, state) != state
            self.states[sender] = state
        return extra[heads.rows]

    def _design(self, streams: Ints) -> None:
        """Decide which streams are periodic, and compute their charts."""
        for stream in streams.tolist():
            facts = self.learned[stream]
            count = facts[_COUNT]
            self.phase[stream] = _IGNORED
            if count < LEAST_INTERVALS:
                continue
            mean = facts[_SUM] / count
            deviation = np.sqrt(max(0.0, facts[_SQUARES] / count - mean * mean) * count / (count - 1.0))
            if deviation > MOST_VARIATION * mean:
                continue
            length = round(log10(min(max(3.0 * self.false_alarm_s / mean, 10.0), 1e9)), 2)  # few different ones
            facts[_MEAN], facts[_DEVIATION] = mean, max(deviation, self.least_deviation_s)
            facts[_INTERVAL] = find_interval(self.shift / 2.0, elementary.exp10(length))
            self.phase[stream] = _WATCHED


class _Memory(NamedTuple):
    """What is known of each stream."""

    last_ns: Ints
    phase: Ints
    learned: Floats
    charts: Floats


class _Limits(NamedTuple):
    """Parameters of the charts, and the begin and end of learning."""

    clip: float
    reference: float
    """k: what each value has to exceed."""
    begin_ns: int
    end_ns: int


@compiled
def _accumulate(streams: Ints, at_ns: Ints, memory: _Memory, limits: _Limits, peaks: Floats, which: Ints) -> None:
    """Learn from the intervals or add them to the charts; writes each row's highest sum over h, and its chart."""
    last_ns, phase, learned, charts = memory
    clip, reference, begin_ns, end_ns = limits
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
