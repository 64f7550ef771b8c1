"""Which sent frame is it that came in? Matches what left one node with what reached another, by payload and order.

Nothing is added in band: a receiver knows the bytes and when they came. Of the frames of one lane that carry those
bytes, were sent by then and have not come in yet, the one that left first is taken, which is exact wherever bytes
do not recur (MAVLink counts its frames). Where they do, the lane's order decides: on a reliable lane a frame that
was overtaken is lost, so it is taken only where no other would do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

TOLERANCE_NS = 5 * NS_PER_MS
"""By so much the clocks of two nodes may differ after their offsets are taken off."""
WINDOW_NS = 10 * NS_PER_S
"""A datagram that has not come in so long after it left does not come in any more."""
PATIENCE_NS = 300 * NS_PER_S
"""Nor does, after so long, a frame on a reliable lane, whose retransmissions double up to a minute each."""

Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class Sent(Generic[Row]):
    """A frame that left. `order` counts as frames leave; `left_ns` is later than `sent_ns` where it was held."""

    order: int
    sent_ns: Time
    left_ns: Time
    payload: bytes
    row: Row
    """Whatever the caller wants back."""


class LaneMatching(Generic[Row]):
    """The frames of one lane that left and have not come in.

    Calls come in order of time, where a frame that came in at `at` counts as `at + TOLERANCE_NS`: everything that
    was sent by then is known. Memory holds what left within `WINDOW_NS` (`PATIENCE_NS`) and did not come in.
    """

    def __init__(self, reliable: bool) -> None:
        """`reliable`: what comes in does so in the order in which it left."""
        self.ambiguous = 0
        """How many matches could as well have been with another frame of the same bytes."""
        self._reliable = reliable
        self._pending: dict[bytes, list[Sent[Row]]] = {}
        self._latest = -1

    def sent(self, frame: Sent[Row]) -> None:
        """A frame left."""
        self._pending.setdefault(frame.payload, []).append(frame)

    def received(self, at: Time, payload: bytes) -> Sent[Row] | None:
        """Bytes came in at `at`: the frame that they are, which is then no longer pending; None where none fits."""
        same = self._pending.get(payload)
        fitting = [
            (self._overtaken(frame), frame.order, place)
            for place, frame in enumerate(same or ())
            if frame.sent_ns <= at + TOLERANCE_NS and not self._stale(frame, at)
        ]
        if same is None or not fitting:
            return None
        self.ambiguous += len(fitting) > 1
        found = same.pop(min(fitting)[2])
        if not same:
            del self._pending[payload]
        self._latest = max(self._latest, found.order)
        return found

    def expired(self, now: Time) -> list[Sent[Row]]:
        """Those that cannot come in any more at `now`; they are no longer pending."""
        gone = [frame for same in self._pending.values() for frame in same if self._stale(frame, now)]
        for payload in {frame.payload for frame in gone}:
            kept = [frame for frame in self._pending[payload] if not self._stale(frame, now)]
            if kept:
                self._pending[payload] = kept
            else:
                del self._pending[payload]
        return gone

    def rest(self) -> list[tuple[Sent[Row], bool]]:
        """At the end, those that are pending, and whether each was overtaken on a reliable lane: then it was lost."""
        return [(frame, self._overtaken(frame)) for same in self._pending.values() for frame in same]

    def _overtaken(self, frame: Sent[Row]) -> bool:
        return self._reliable and frame.order < self._latest

    def _stale(self, frame: Sent[Row], now: Time) -> bool:
        waits = self._reliable and frame.order > self._latest
        return now - frame.left_ns > (PATIENCE_NS if waits else WINDOW_NS)
