"""Queue of an endpoint that takes time for each frame: one server, a fixed service time, a bounded queue, FIFO.

In Kendall's notation G/D/1/K with K = `queue_frames` + 1: arrivals of any kind, a deterministic service time, one
server (L. Kleinrock, Queueing Systems, volume 1, 1975). Its state is the time at which it has processed all it has.
"""

from __future__ import annotations

from skyrange.contracts.links import ProcessingLimit
from skyrange.contracts.mailboxes import Note
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, Time


class ProcessingQueue:
    """The frames that wait at one endpoint, from all links that end there, in order of arrival."""

    __slots__ = ("_idle_at", "_overflows", "_queue_ns", "endpoint", "service_ns")

    def __init__(self, limit: ProcessingLimit) -> None:
        self.endpoint = limit.endpoint
        self.service_ns: Time = max(1, round(NS_PER_S / limit.frames_per_s))
        """Time that a frame takes, rounded to whole ns."""
        self._queue_ns: Time = limit.queue_frames * self.service_ns
        self._idle_at: Time = -(2**62)
        self._overflows = 0

    def admit(self, now: Time) -> Time | None:
        """Take a frame that arrives at `now`: when it is processed, or `None` where the queue is full.

        It is called in order of time. A frame that is being processed takes no place in the queue.
        """
        left_ns = self._idle_at - now
        if left_ns <= 0:
            self._idle_at = now + self.service_ns
        elif left_ns > self._queue_ns:  # as many wait as may, beside the one that is being processed
            return None
        else:
            self._idle_at += self.service_ns
        return self._idle_at

    def count_overflow(self, frame: FrameId) -> Note | None:
        """Count a frame that found no place; a note of the 1st, 2nd, 4th, 8th …, so that no flood fills the record."""
        self._overflows += 1
        if self._overflows & (self._overflows - 1):
            return None
        return Note("event.processing_overflow", self.endpoint, {"count": self._overflows}, (frame,))
