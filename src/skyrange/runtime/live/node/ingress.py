"""Rate limit of what a node takes in from its links: all that a range sends itself, and of a flood what it can bear.

What comes from one link beyond that is dropped and counted, so that a flood on one link harms no other, and nothing
that waits grows without end.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from skyrange.core.time import NS_PER_S, Time

FRAMES_HZ: Final = 2_000.0
"""Sustained frame rate of one link; an aircraft at operator load has 105."""
BYTES_HZ: Final = float(1 << 21)
"""Sustained byte rate of one link."""
BURST_S: Final = 2.0
"""So many seconds of both rates may come at once: five seconds of telemetry after a pause, what a hundred ground
receivers received."""
MAX_WAITING_BYTES: Final = 1 << 26
"""Of all links together."""


@dataclass(slots=True)
class _TokenBucket:
    """What a link may still hand in."""

    at_ns: Time
    frames: float = FRAMES_HZ * BURST_S
    bytes: float = BYTES_HZ * BURST_S


@dataclass(slots=True)
class IngressRateLimiter:
    """Payloads that were received and wait for the node's next turn."""

    dropped: int = 0
    waiting: list[tuple[Time, str, bytes]] = field(default_factory=list)
    """When each was read, on which directed link, and its bytes."""
    _bytes: int = 0
    _buckets: dict[str, _TokenBucket] = field(default_factory=dict)

    def admit(self, at: Time, link: str, data: bytes) -> None:
        """Keep what was read at `at` on the directed link `link`, or drop it."""
        left = self._buckets.get(link)
        if left is None:
            left = self._buckets[link] = _TokenBucket(at)
        past_s = max(at - left.at_ns, 0) / NS_PER_S
        left.at_ns = at
        left.frames = min(left.frames + past_s * FRAMES_HZ, FRAMES_HZ * BURST_S)
        left.bytes = min(left.bytes + past_s * BYTES_HZ, BYTES_HZ * BURST_S)
        if left.frames < 1 or left.bytes < len(data) or self._bytes + len(data) > MAX_WAITING_BYTES:
            self.dropped += 1
            return
        left.frames -= 1
        left.bytes -= len(data)
        self._bytes += len(data)
        self.waiting.append((at, link, data))

    def drain(self) -> list[tuple[Time, str, bytes]]:
        """Take all that waits, in order."""
        waiting, self.waiting = self.waiting, []
        self._bytes = 0
        return waiting
