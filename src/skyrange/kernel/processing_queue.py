"""Queue of an endpoint that takes time for frames: one processor, first come, first served, a bounded queue.

What a frame takes is known in parts: each defence at the endpoint has a time for a frame that it inspects and may drop
it, and a limited endpoint takes a fixed time for what is left. With the fixed time alone it is G/D/1/K in Kendall's
notation with K = `queue_frames` + 1: arrivals of any kind, a deterministic service time, one server (L. Kleinrock,
Queueing Systems, volume 1, 1975).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from skyrange.contracts.frames import Frame
from skyrange.contracts.links import ProcessingLimit
from skyrange.contracts.mailboxes import Note
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, Time
from skyrange.core.whole_numbers import worth_noting

if TYPE_CHECKING:
    from skyrange.kernel.directed_link import DirectedLink


@dataclass(slots=True)
class Job:
    """A frame at an endpoint: one that arrived, or one that it sends and that its defences inspect."""

    link: DirectedLink
    frame: Frame
    position: int
    """Of the next tap that sees it."""
    sending: bool
    served: bool = False
    """Whether the processor has spent the time that this tap takes, or after the last the endpoint itself."""


class ProcessingQueue:
    """The frames that wait at one endpoint, from and to all its links, in order of arrival."""

    __slots__ = (
        "_final",
        "_incoming",
        "_overflows",
        "_places",
        "_until",
        "_waiting",
        "current",
        "endpoint",
        "service_ns",
    )

    def __init__(self, endpoint: str, limit: ProcessingLimit | None = None) -> None:
        """Without a `limit` the endpoint itself takes no time, and any number of frames may wait for its defences."""
        self.endpoint = endpoint
        self.service_ns: Time = 0
        """Time that the endpoint takes for a frame beside its defences, rounded to whole ns."""
        self._places: int | None = None
        if limit is not None:
            self.service_ns = max(1, round(NS_PER_S / limit.frames_per_s))
            self._places = limit.queue_frames
        self.current: Job | None = None
        """What is being processed."""
        self._until: Time = 0
        self._final = False
        self._waiting: deque[Job] = deque()
        self._incoming = 0
        self._overflows = 0

    def admit(self, now: Time, job: Job) -> bool:
        """Take a frame at `now`; `False` where it arrives and finds the queue full. It is called in order of time.

        A frame that is being processed takes no place, and neither does what the endpoint sends: its sender waits.
        """
        if not job.sending:
            waiting = self._incoming
            if waiting and self._final and self._until <= now:
                waiting -= 1  # the processor turns to the next frame at this time
            if self.current is not None and self._places is not None and waiting >= self._places:
                return False
            self._incoming += 1
        self._waiting.append(job)
        return True

    def begin(self) -> Job | None:
        """Turn to the frame that has waited longest; `None` where none waits or one is being processed."""
        if self.current is not None or not self._waiting:
            return None
        job = self.current = self._waiting.popleft()
        self._incoming -= not job.sending
        return job

    def serve(self, now: Time, service_ns: Time, *, final: bool) -> Time:
        """Spend a time on the current frame, the last one if `final`: when it ends."""
        self._until, self._final = now + service_ns, final
        return self._until

    def end(self) -> None:
        """Have done with the current frame."""
        self.current = None
        self._final = False

    def is_sending(self, link: DirectedLink) -> bool:
        """Whether a frame that leaves on this link waits, or is being processed."""
        if self.current is not None and self.current.sending and self.current.link is link:
            return True
        return len(self._waiting) > self._incoming and any(job.sending and job.link is link for job in self._waiting)

    def list_waiting(self) -> list[tuple[Time, Job]]:
        """The frames that wait, each with the time at which it will be processed if no defence takes time for any."""
        at, waiting = self._until, []
        for job in self._waiting:
            at += 0 if job.sending else self.service_ns
            waiting.append((at, job))
        return waiting

    def count_overflow(self, frame: FrameId) -> Note | None:
        """Count a frame that found no place; a note of the 1st, 2nd, 4th, 8th …, so that no flood fills the record."""
        self._overflows += 1
        if not worth_noting(self._overflows):
            return None
        return Note("event.processing_overflow", self.endpoint, {"count": self._overflows}, (frame,))
