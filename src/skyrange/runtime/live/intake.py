"""How much of what sockets hand in does a node take in? All of a range's own, and of a flood what it can bear.

Whatever came from one link beyond that is dropped and counted, so that who floods one link harms no other, and
nothing that waits grows without end.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from skyrange.core.time import NS_PER_S, Time

FRAMES_HZ: Final = 2_000.0
"""Of one link, lasting; an aircraft at operator load has 105."""
BYTES_HZ: Final = float(1 << 21)
BURST_S: Final = 2.0
"""So much of both may come at once: five seconds of telemetry after a pause, what a hundred ground receivers heard."""
MOST_BYTES: Final = 1 << 26
"""That wait, of all links."""


@dataclass(slots=True)
class _Allowance:
    """What a link may still hand in."""

    at_ns: Time
    frames: float = FRAMES_HZ * BURST_S
    bytes: float = BYTES_HZ * BURST_S


@dataclass(slots=True)
class Intake:
    """What was heard and waits for the node's next turn."""

    dropped: int = 0
    waiting: list[tuple[Time, str, bytes]] = field(default_factory=list)
    """When it was read, on which lane, what."""
    _bytes: int = 0
    _allowances: dict[str, _Allowance] = field(default_factory=dict)

    def take(self, at: Time, lane: str, data: bytes) -> None:
        """Keep what was read at `at`, or drop it."""
        left = self._allowances.get(lane)
        if left is None:
            left = self._allowances[lane] = _Allowance(at)
        past_s = max(at - left.at_ns, 0) / NS_PER_S
        left.at_ns = at
        left.frames = min(left.frames + past_s * FRAMES_HZ, FRAMES_HZ * BURST_S)
        left.bytes = min(left.bytes + past_s * BYTES_HZ, BYTES_HZ * BURST_S)
        if left.frames < 1 or left.bytes < len(data) or self._bytes + len(data) > MOST_BYTES:
            self.dropped += 1
            return
        left.frames -= 1
        left.bytes -= len(data)
        self._bytes += len(data)
        self.waiting.append((at, lane, data))

    def drain(self) -> list[tuple[Time, str, bytes]]:
        """All that waits, in order."""
        waiting, self.waiting = self.waiting, []
        self._bytes = 0
        return waiting
