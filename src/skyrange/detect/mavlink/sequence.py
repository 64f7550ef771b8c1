"""MAVLink sequence detector: two senders under one identity, and recordings, by the sequence numbers of frames.

It reads the sequence number, sender and checksum of all MAVLink frames that arrive at a link end. Each component
numbers its frames 0…255 and over again (mavlink.io, Serialization). The method is that of F. Guo and T. Chiueh,
"Sequence Number-Based MAC Address Spoof Detection", Recent Advances in Intrusion Detection (RAID 2005), LNCS 3858,
for the 12-bit numbers of IEEE 802.11: frames of a second sender do not follow the numbers of the first. Limits and
verification are this detector's own: it waits until the old counter goes on, so a sender that restarts raises nothing.
The rules, for each sender:

- A number up to `most_lost` + 1 ahead of the last follows it. Any other starts a second counter. Evidence: the first
  counter goes on after frames of the second, or the second after the first (*interleaved*).
- Evidence: a number that the sender used less than `silence_s` ago, with another content (*conflict*), or with the same
  content more than `late_s` ago (*old*, a replay). Networks repeat and overtake frames within less.

The score is the number of pieces of evidence since there were none for `quiet_s`, divided by `evidence`. With
`most_lost` nine losses in a row begin a new counter: at 10 % independent loss, after one frame in 10⁹. `late_s` is
several round trips of a cellular link; `silence_s` is less than 256 frames of a telemetry stream (both assumed).

It cannot detect a sender that alters frames in place or replaces another altogether, and ignores losses. A sender that
restarts within `silence_s` at a number that it has just used raises an alert, and so does one that sends more than 256
frames in `silence_s` and loses 128 of them in a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

import skyrange.plugin as sky
from skyrange.contracts.frames import Ints
from skyrange.core.compiled import compiled
from skyrange.detect.messages import MessageHeads
from skyrange.detect.streams import EventCounts

FINDINGS: Final = ("", "interleaved", "conflict", "old")
_NUMBERS: Final = 256
_NEVER: Final = -(2**62)
_CURRENT, _LAST, _LAST_NS = 0, 1, 3
"""Columns of the state of a sender: which counter sent last; last number of both; time of both."""


@sky.detector("mavlink.sequence")
class SequenceNumbers(sky.MessageDetector):
    """Raises an alert if sequence numbers of a MAVLink sender show a second sender, or a recording."""

    most_lost: sky.Whole = sky.param(
        "Most frames lost in a row that do not look like another counter.", default=8, ge=0, le=120
    )
    late_s: sky.Number = sky.param(
        "Longest time by which a network delivers a frame, or a copy of it, late, in seconds.",
        default=1.0, gt=0.0, le=60.0,
    )  # fmt: skip
    silence_s: sky.Number = sky.param(
        "Time after which a counter that did not go on is forgotten, in seconds. Choose less than the sender needs for "
        "256 frames.",
        default=10.0, gt=0.0, le=120.0,
    )  # fmt: skip
    evidence: sky.Whole = sky.param("Pieces of evidence that make a score of 1.", default=1, ge=1, le=1000)
    states: Ints = sky.table(5)
    seen: Ints = sky.table(_NUMBERS)
    seen_ns: Ints = sky.table(_NUMBERS)
    counts: EventCounts

    def prepare(self, context: sky.DetectorContext) -> None:
        """Count evidence until there is none for `quiet_s`."""
        self.counts = EventCounts(sky.from_seconds(self.quiet_s))

    def select(self, frames: sky.ObservedFrames, heads: MessageHeads) -> MessageHeads:
        """Those that arrived."""
        return heads.take(heads.received)

    def judge(self, now: sky.Time, frames: sky.ObservedFrames, heads: MessageHeads) -> Sequence[sky.Alert]:
        """Follow the frames since the last service. Returns an alert for each sender that begins or doubles."""
        streams = self.number(heads.senders, states=-1, seen=-1, seen_ns=_NEVER)
        begins = np.unique(streams[self.states[streams, _CURRENT] < 0])
        self.states[begins] = (0, -1, -1, _NEVER, _NEVER)
        findings = np.zeros(len(streams), dtype=np.int64)
        _follow(
            _Frames(streams, heads.at_ns, heads.sequences, heads.checksums),
            _Memory(self.states, self.seen, self.seen_ns),
            _Limits(self.most_lost, sky.from_seconds(self.late_s), sky.from_seconds(self.silence_s)),
            findings,
        )
        rows = np.flatnonzero(findings)
        events, event_findings = heads.take(rows), findings[rows]
        counts = self.counts.add(events.at_ns, streams[rows])
        return self.alerts(
            frames, events, streams[rows], counts / self.evidence,
            lambda row: (FINDINGS[int(event_findings[row])], {"number": int(events.sequences[row])}),
        )  # fmt: skip


class _Frames(NamedTuple):
    """Frames in the order of their arrival."""

    streams: Ints
    at_ns: Ints
    sequences: Ints
    contents: Ints


class _Memory(NamedTuple):
    """What is known of each stream."""

    states: Ints
    seen: Ints
    """The content of the last frame with each sequence number; -1 without one."""
    seen_ns: Ints


class _Limits(NamedTuple):
    """Parameters of the detector."""

    most_lost: int
    late_ns: int
    silence_ns: int


@compiled
def _follow(frames: _Frames, memory: _Memory, limits: _Limits, findings: Ints) -> None:
    """Follow the counters of all senders; writes the index in `FINDINGS` of each frame."""
    streams, at_ns, sequences, contents = frames
    states, seen, seen_ns = memory
    most_lost, late_ns, silence_ns = limits
    for row in range(streams.shape[0]):
        stream, at, number = streams[row], at_ns[row], sequences[row]
        state = states[stream]
        current = state[_CURRENT]
        finding = 0
        fits = -1
        for turn in range(2):
            counter = current if turn == 0 else 1 - current
            ahead = (number - state[_LAST + counter]) % _NUMBERS
            alive = at - state[_LAST_NS + counter] <= silence_ns
            if fits < 0 and alive and 1 <= ahead <= most_lost + 1:
                fits = counter
        age = at - seen_ns[stream, number]
        used = age <= silence_ns and seen[stream, number] >= 0
        behind = (state[_LAST + current] - number) % _NUMBERS
        if fits == current:
            pass
        elif used and seen[stream, number] != contents[row]:
            finding = 2
        elif used:
            finding = 3 if age > late_ns else 0
        elif fits >= 0:
            finding = 1
        elif behind <= most_lost and at - state[_LAST_NS + current] <= late_ns:
            fits = -2  # overtaken by a frame or two: the counter stays
        if finding < 2 and not (used and fits != current) and fits != -2:
            if fits < 0:
                fits = 1 - current if state[_LAST + current] >= 0 else current
            state[_CURRENT] = fits
            state[_LAST + fits] = number
            state[_LAST_NS + fits] = at
        seen[stream, number] = contents[row]
        seen_ns[stream, number] = at
        findings[row] = finding
