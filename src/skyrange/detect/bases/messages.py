"""Base of detectors that read the headers of MAVLink frames, and count or follow streams of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, TypeAlias

from skyrange.contracts.alerts import Alert, Scalar
from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import ObservedFrames
from skyrange.contracts.plugins.form import state
from skyrange.core.time import Time
from skyrange.detect.bases.scores import ScoreDetector
from skyrange.detect.message_heads import MessageHeads, name_message, read_heads
from skyrange.detect.series import Floats
from skyrange.detect.streams import StreamNumbers

Details: TypeAlias = Callable[[int], tuple[str, Mapping[str, Scalar]]]
"""What is said of the header in a row: what was found, a part of the alert's kind, and data."""


class MessageDetector(ScoreDetector):
    """Judges the headers of MAVLink frames at link ends, in both directions."""

    needs: ClassVar[tuple[str, ...]] = ("judge",)

    streams: StreamNumbers = state(StreamNumbers)
    """Numbers of streams; a `table` has a row for each."""

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Judge the frames since the last service, if there are any that count."""
        heads = self.select(frames, read_heads(frames))
        return self.judge(now, frames, heads) if len(heads.rows) else ()

    def select(self, frames: ObservedFrames, heads: MessageHeads) -> MessageHeads:
        """The headers that count: all, unless a kind leaves some out."""
        return heads

    def judge(self, now: Time, frames: ObservedFrames, heads: MessageHeads) -> Sequence[Alert]:
        """The alerts about n headers of `frames`."""
        raise NotImplementedError

    def number(self, keys: Ints, /, **fills: float) -> Ints:
        """(n,) the numbers of the streams of n keys; tables get a row for each new one, as `grow` does."""
        streams = self.streams.assign(keys)
        self.grow(len(self.streams), **fills)
        return streams

    def alerts(
        self, frames: ObservedFrames, heads: MessageHeads, streams: Ints, scores: Floats, details: Details
    ) -> list[Alert]:
        """The alerts of the (n,) streams and scores of n headers: who claims to have sent which message, and details.

        `details` is called with the row of each header that raises an alert.
        """
        rows, found = self.episodes.update(heads.at_ns, streams, scores)
        alerts = []
        for row, score in zip(rows.tolist(), found.tolist(), strict=True):
            finding, more = details(row)
            data = {
                "system": int(heads.systems[row]),
                "component": int(heads.components[row]),
                "message": name_message(int(heads.messages[row])),
                **more,
            }
            link = frames.ports[int(heads.places[row])].link
            alerts.append(self.alert(int(heads.at_ns[row]), link, score, data, finding))
        return alerts
