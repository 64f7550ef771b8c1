"""MAVLink rate detector: streams that send more than they did, and floods of messages that were not there before.

It reads the headers of all MAVLink frames at a link end and counts them for each stream: a sender (system id and
component id) and a message, in one direction. The rule: the messages in the last `window_s`, divided by the most that
are expected there. After `learn_after_s`, in which a ground station transfers missions and requests streams, it counts
for `learn_s`. A stream that sent in every part of that time has a rate, and `multiple` times the rate plus `slack`
messages are expected. From all other streams `others_per_s` are expected, and `transfer_per_s` where the message
belongs to a transfer of missions, parameters, files or logs, whose rate the window of the protocol and the link limit.
`transfer_per_s` also holds for every stream until the rates are learned.

Sources: `multiple` is below 2, so that a second sender of a stream is found, and above 1 by more than the rounding of a
rate; `slack` is for heartbeats beside the regular ones, which autopilots send when the mode changes. `others_per_s` and
`transfer_per_s` are assumptions: a ground station sends a few commands a second, and a radio of 57,600 bit/s carries
about a hundred frames of 50 bytes a second.

It cannot detect a flood that begins before the time to learn is over, which is learned; a stream that replaces another
at the same rate; and messages that are lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

import skyrange.plugin as sky
from skyrange.contracts.alerts import Scalar
from skyrange.detect.messages import MessageHeads, message_numbers, name_message, read_heads
from skyrange.detect.series import Floats

PARTS: Final = 5
"""Parts of the time to learn, in each of which a stream with a rate has sent."""
_TRANSFER: Final = (
    "MISSION_ITEM", "MISSION_ITEM_INT", "MISSION_REQUEST", "MISSION_REQUEST_INT", "PARAM_VALUE", "PARAM_REQUEST_READ",
    "FILE_TRANSFER_PROTOCOL", "LOG_DATA", "LOG_ENTRY", "LOG_REQUEST_DATA",
)  # fmt: skip


@sky.detector("mavlink.rate")
class MessageRate(sky.MessageDetector):
    """Raises an alert if a MAVLink stream sends more often than it did, or a new one more often than a limit."""

    learn_after_s: sky.Number = sky.param(
        "Time before the detector learns rates, in seconds.", default=3.0, ge=0.0, le=3600.0
    )
    learn_s: sky.Number = sky.param(
        "Time in which the detector learns rates, in seconds.", default=10.0, ge=5.0, le=86_400.0
    )
    window_s: sky.Whole = sky.param("Time over which messages are counted, in seconds.", default=10, ge=1, le=60)
    multiple: sky.Number = sky.param(
        "Multiple of the learned rate that is expected at most.", default=1.5, ge=1.0, le=100.0
    )
    slack: sky.Whole = sky.param(
        "Messages in a window that are expected beyond the multiple.", default=4, ge=0, le=10_000
    )
    others_per_s: sky.Number = sky.param(
        "Messages per second that are expected at most of a stream without a learned rate.",
        default=10.0, ge=0.1, le=1e5,
    )  # fmt: skip
    transfer_per_s: sky.Number = sky.param(
        "The same for messages of transfers: mission items, parameters, files and logs.",
        default=100.0, ge=0.1, le=1e5,
    )  # fmt: skip
    service_ns: sky.Time = sky.NS_PER_S
    keys: sky.Ints = sky.table(2)
    """(streams, 2) sender and message."""
    learned: sky.Ints = sky.table(PARTS)
    counts: sky.Ints
    """Messages in the last intervals between services; interval i is in column i modulo their number."""
    turn: int = 0

    def prepare(self, context: sky.DetectorContext) -> None:
        self.counts = np.zeros((0, self.window_s), dtype=np.int64)

    def observe(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        """Count the messages since the last service, also where there are none."""
        return self.judge(now, frames, read_heads(frames))

    def judge(self, now: sky.Time, frames: sky.ObservedFrames, heads: MessageHeads) -> Sequence[sky.Alert]:
        senders, messages = heads.senders, heads.messages
        streams = self.number(senders << 24 | messages, keys=0, learned=0, counts=0)
        size = len(self.streams)
        self.keys[streams, 0], self.keys[streams, 1] = senders, messages
        begin_ns, length_ns = sky.from_seconds(self.learn_after_s), sky.from_seconds(self.learn_s)
        part = (heads.at_ns - begin_ns) * PARTS // length_ns
        learning = (part >= 0) & (part < PARTS)
        np.add.at(self.learned, (streams[learning], part[learning]), 1)
        self.counts[:, self.turn % self.window_s] = np.bincount(streams, minlength=len(self.counts))
        self.turn += 1
        learns = now < begin_ns + length_ns
        rates = np.zeros(size) if learns else self._rates(size)
        counts = self.counts[:size].sum(axis=1)
        raised, scores = self.episodes.update(now, np.arange(size), counts / self._expect(rates, learns=learns))
        alerts = []
        for stream, score in zip(raised.tolist(), scores.tolist(), strict=True):
            sender, message = self.keys[stream].tolist()
            data: dict[str, Scalar] = {
                "system": sender >> 8 & 0xFF,
                "component": sender & 0xFF,
                "message": name_message(message),
                "per_s": int(counts[stream]) / self.window_s,
                "learned_per_s": float(rates[stream]),
            }
            alerts.append(self.alert(now, frames.ports[sender >> 17].link, score, data))
        return alerts

    def _rates(self, size: int) -> Floats:
        """(size,) messages per second that each stream has learned; 0 for none."""
        learned = self.learned[:size]
        regular = (learned > 0).all(axis=1)
        return np.asarray(np.where(regular, learned.sum(axis=1) / sky.to_seconds(sky.from_seconds(self.learn_s)), 0.0))

    def _expect(self, rates: Floats, *, learns: bool) -> Floats:
        """(n,) the most messages in a window that each of the first n streams is expected to send."""
        transfer = np.isin(self.keys[: len(rates), 1], [message_numbers()[name] for name in _TRANSFER]) | learns
        others = np.where(transfer, self.transfer_per_s, self.others_per_s) * self.window_s
        return np.asarray(np.where(rates > 0.0, self.multiple * rates * self.window_s + self.slack, others))
