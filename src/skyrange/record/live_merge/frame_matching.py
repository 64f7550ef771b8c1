"""Matching of frames sent by one node with frames received by another, by payload and order.

Nodes add nothing to the payload, so a receiver knows only the bytes and their time of arrival. Candidates are the
frames of the same link direction that carry these bytes, were sent by then, and have not been matched. The candidate
that left first is chosen. This is exact if payloads do not recur; MAVLink frames are numbered, so theirs rarely do.
If payloads recur, order decides: on a reliable link a frame that a later one has overtaken is lost, so it is chosen
only if there is no other candidate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

TOLERANCE_NS = 5 * NS_PER_MS
"""Largest difference between the clocks of two nodes after correction by their offsets."""
DATAGRAM_WINDOW_NS = 10 * NS_PER_S
"""A datagram that has not arrived within this time counts as lost."""
RELIABLE_WINDOW_NS = 300 * NS_PER_S
"""The candidates for a frame on a reliable link, whose retransmission timeouts double up to a minute each."""

Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class SentFrame(Generic[Row]):
    """A frame that left its node. `order` numbers frames as they leave; a delayed frame has `left_ns` > `sent_ns`."""

    order: int
    sent_ns: Time
    left_ns: Time
    payload: bytes
    row: Row
    """Data of the caller, returned with the match."""


class FrameMatcher(Generic[Row]):
    """The frames of one link direction that left and are not matched yet.

    Calls must be in order of time, where a frame received at `at` counts as `at + TOLERANCE_NS`, so that everything
    sent by then is known. Memory holds unmatched frames that left within `DATAGRAM_WINDOW_NS` (`RELIABLE_WINDOW_NS`).
    """

    def __init__(self, reliable: bool) -> None:
        """`reliable` means that frames arrive in the order in which they left."""
        self.ambiguous = 0
        """Number of matches for which there was more than one candidate."""
        self._reliable = reliable
        self._pending: dict[bytes, list[SentFrame[Row]]] = {}
        self._latest = -1

    def add_sent(self, frame: SentFrame[Row]) -> None:
        """Add a frame that left."""
        self._pending.setdefault(frame.payload, []).append(frame)

    def match_received(self, at: Time, payload: bytes) -> SentFrame[Row] | None:
        """Match bytes received at `at`; returns and removes the frame that was sent, or `None` if none fits."""
        candidates = self._pending.get(payload)
        fitting = [
            (self._overtaken(frame), frame.order, place)
            for place, frame in enumerate(candidates or ())
            if frame.sent_ns <= at + TOLERANCE_NS and not self._stale(frame, at)
        ]
        if candidates is None or not fitting:
            return None
        self.ambiguous += len(fitting) > 1
        found = candidates.pop(min(fitting)[2])
        if not candidates:
            del self._pending[payload]
        self._latest = max(self._latest, found.order)
        return found

    def expired(self, now: Time) -> list[SentFrame[Row]]:
        """Remove and return the frames that can no longer arrive at `now`."""
        gone = [frame for candidates in self._pending.values() for frame in candidates if self._stale(frame, now)]
        for payload in {frame.payload for frame in gone}:
            kept = [frame for frame in self._pending[payload] if not self._stale(frame, now)]
            if kept:
                self._pending[payload] = kept
            else:
                del self._pending[payload]
        return gone

    def remaining(self) -> list[tuple[SentFrame[Row], bool]]:
        """The frames still pending at the end, each with whether it was overtaken on a reliable link and so is lost."""
        return [(frame, self._overtaken(frame)) for candidates in self._pending.values() for frame in candidates]

    def _overtaken(self, frame: SentFrame[Row]) -> bool:
        return self._reliable and frame.order < self._latest

    def _stale(self, frame: SentFrame[Row], now: Time) -> bool:
        waits = self._reliable and frame.order > self._latest
        return now - frame.left_ns > (RELIABLE_WINDOW_NS if waits else DATAGRAM_WINDOW_NS)
