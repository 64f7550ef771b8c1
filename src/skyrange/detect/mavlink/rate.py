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
from numpy.typing import NDArray
from pydantic import Field

from skyrange.contracts.alerts import Alert
from skyrange.contracts.detectors import DetectorContext, DetectorPlugin
from skyrange.contracts.frames.payloads import Ints
from skyrange.contracts.monitors import Monitor, ObservedFrames
from skyrange.contracts.params import Number, Whole
from skyrange.core.time import NS_PER_S, Time, from_seconds, to_seconds
from skyrange.detect.episodes import EpisodeParams, Episodes, subject_of_link
from skyrange.detect.mavlink.heads import message_numbers, name_message, read_heads
from skyrange.detect.streams import StreamNumbers, extend

KIND = "mavlink.rate"
ABOUT = "Raises an alert if a MAVLink stream sends more often than it did, or a new one more often than a limit."
SERVICE_NS: Time = NS_PER_S
PARTS: Final = 5
"""Parts of the time to learn, in each of which a stream with a rate has sent."""
_TRANSFER: Final = (
    "MISSION_ITEM", "MISSION_ITEM_INT", "MISSION_REQUEST", "MISSION_REQUEST_INT", "PARAM_VALUE", "PARAM_REQUEST_READ",
    "FILE_TRANSFER_PROTOCOL", "LOG_DATA", "LOG_ENTRY", "LOG_REQUEST_DATA",
)  # fmt: skip


class RateParams(EpisodeParams):
    """Parameters of the MAVLink rate detector."""

    learn_after_s: Number = Field(
        default=3.0, ge=0.0, le=3600.0, description="Time before the detector learns rates, in seconds."
    )
    learn_s: Number = Field(
        default=10.0, ge=5.0, le=86_400.0, description="Time in which the detector learns rates, in seconds."
    )
    window_s: Whole = Field(default=10, ge=1, le=60, description="Time over which messages are counted, in seconds.")
    multiple: Number = Field(
        default=1.5, ge=1.0, le=100.0, description="Multiple of the learned rate that is expected at most."
    )
    slack: Whole = Field(
        default=4, ge=0, le=10_000, description="Messages in a window that are expected beyond the multiple."
    )
    others_per_s: Number = Field(
        default=10.0,
        ge=0.1,
        le=1e5,
        description="Messages per second that are expected at most of a stream without a learned rate.",
    )
    transfer_per_s: Number = Field(
        default=100.0,
        ge=0.1,
        le=1e5,
        description="The same for messages of transfers: mission items, parameters, files and logs.",
    )


class RateDetector:
    """A `skyrange.contracts.monitors.Monitor`. The subject of an alert is the owner of the link."""

    service_ns: Time = SERVICE_NS

    def __init__(self, params: RateParams) -> None:
        self._params = params
        self._begin_ns, self._length_ns = from_seconds(params.learn_after_s), from_seconds(params.learn_s)
        self._streams = StreamNumbers()
        self._keys = np.zeros((0, 2), dtype=np.int64)
        """(streams, 2) sender and message."""
        self._learned = np.zeros((0, PARTS), dtype=np.int64)
        self._counts = np.zeros((0, params.window_s), dtype=np.int64)
        """Messages in the last intervals between services; interval i is in column i modulo their number."""
        self._turn = 0
        self._episodes = Episodes(params)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Count the messages since the last service. Returns an alert for each stream that begins or doubles."""
        heads = read_heads(frames)
        senders, messages = heads.senders, heads.messages
        streams = self._streams.assign(senders << 24 | messages)
        size = len(self._streams)
        self._keys, self._learned, self._counts = (
            extend(values, size, 0) for values in (self._keys, self._learned, self._counts)
        )
        self._keys[streams, 0], self._keys[streams, 1] = senders, messages
        part = (heads.at_ns - self._begin_ns) * PARTS // self._length_ns
        learning = (part >= 0) & (part < PARTS)
        np.add.at(self._learned, (streams[learning], part[learning]), 1)
        column = self._turn % self._counts.shape[1]
        self._turn += 1
        self._counts[:, column] = np.bincount(streams, minlength=len(self._counts))
        learns = now < self._begin_ns + self._length_ns
        learned = np.zeros(size) if learns else self._rates(size)
        expected = self._expect(learned, learns)
        counts = self._counts[:size].sum(axis=1)
        raised, scores = self._episodes.update(now, np.arange(size), counts / expected)
        return [
            self._alert(now, frames, stream, int(counts[stream]), float(learned[stream]), score)
            for stream, score in zip(raised.tolist(), scores.tolist(), strict=True)
        ]

    def _rates(self, size: int) -> NDArray[np.float64]:
        """(size,) messages per second that each stream has learned; 0 for none."""
        learned = self._learned[:size]
        regular = (learned > 0).all(axis=1)
        rates: NDArray[np.float64] = np.where(regular, learned.sum(axis=1) / to_seconds(self._length_ns), 0.0)
        return rates

    def _expect(self, rates: NDArray[np.float64], learns: bool) -> NDArray[np.float64]:
        """(n,) the most messages in a window that each of the first n streams is expected to send."""
        params = self._params
        transfer = np.isin(self._keys[: len(rates), 1], _transfers()) | learns
        others = np.where(transfer, params.transfer_per_s, params.others_per_s) * params.window_s
        expected: NDArray[np.float64] = np.where(
            rates > 0.0, params.multiple * rates * params.window_s + params.slack, others
        )
        return expected

    def _alert(self, now: Time, frames: ObservedFrames, stream: int, count: int, learned: float, score: float) -> Alert:
        sender, message = self._keys[stream].tolist()
        link = frames.ports[sender >> 17].link
        data: dict[str, str | float] = {
            "link": link,
            "system": sender >> 8 & 0xFF,
            "component": sender & 0xFF,
            "message": name_message(message),
            "per_s": count / self._params.window_s,
            "learned_per_s": learned,
        }
        return Alert(now, subject_of_link(link), KIND, score, data)


def _transfers() -> Ints:
    numbers = message_numbers()
    return np.array([numbers[name] for name in _TRANSFER], dtype=np.int64)


def make_rate_detector(params: RateParams, context: DetectorContext | None = None) -> Monitor:
    """A new detector."""
    return RateDetector(params)


MAVLINK_RATE = DetectorPlugin(RateParams, make_rate_detector, ABOUT)
