"""Frames that a tap puts on its link later, such as copies or a record."""

from __future__ import annotations

from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Final

from skyrange.contracts.verdicts import Inject
from skyrange.core.time import NEVER, Time

MAX_INJECTS: Final = 64
"""Frames that a tap puts on its link at one time."""


@dataclass(slots=True)
class WaitingFrames:
    """Frames by the times at which they are due; those of one time in the order in which they were added."""

    most: int = 0
    """Frames that wait at most: the earliest are discarded. 0 is any number."""
    heap: list[tuple[Time, int, Inject]] = field(default_factory=list)
    """When a frame is due, its number, and the frame."""
    added: int = 0
    woken_ns: Time = -NEVER

    def add(self, due: Time, frame: Inject) -> None:
        """Put a frame on the link at `due`."""
        heappush(self.heap, (due, self.added, frame))
        self.added += 1
        if 0 < self.most < len(self.heap):
            heappop(self.heap)

    def discard_before(self, oldest: Time) -> None:
        """Discard the frames that were due before `oldest`."""
        while self.heap and self.heap[0][0] < oldest:
            heappop(self.heap)

    def next_due(self) -> Time | None:
        """When the tap has to be woken: never, if nothing waits."""
        return max(self.heap[0][0], self.woken_ns + 1) if self.heap else None

    def take(self, now: Time, again_ns: Time = 0) -> list[Inject]:
        """The frames that are due, at most `MAX_INJECTS`; with `again_ns`, each of them waits again for so long."""
        self.woken_ns = now
        taken: list[Inject] = []
        while self.heap and self.heap[0][0] <= now and len(taken) < MAX_INJECTS:
            due, _, frame = heappop(self.heap)
            taken.append(frame)
            if again_ns:
                self.add(due + again_ns, frame)
        return taken
