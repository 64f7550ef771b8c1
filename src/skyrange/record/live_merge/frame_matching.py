"""Matching of frames sent by one node with frames received by another, and the true ids of those received.

Nodes add nothing to the payload, so a receiver knows only the bytes and their time of arrival. Candidates are the
frames of the same link direction that carry these bytes, were sent by then, and have not been matched. The candidate
that left first is chosen. This is exact if payloads do not recur; MAVLink frames are numbered, so theirs rarely do.
If payloads recur, order decides: on a reliable link a frame that a later one has overtaken is lost, so it is chosen
only if there is no other candidate.

A node numbers the frames from another node by arrival, under the name of the link direction's source. True serials
follow the same count except for losses, so the mapping is stored as ranges: memory grows with the number of losses,
not with the length of the run.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from skyrange.core.ids import FrameId
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

    def __init__(self, *, reliable: bool) -> None:
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
        matched = candidates.pop(min(fitting)[2])
        if not candidates:
            del self._pending[payload]
        self._latest = max(self._latest, matched.order)
        return matched

    def expired(self, now: Time) -> list[SentFrame[Row]]:
        """Remove and return the frames that can no longer arrive at `now`."""
        expired = [frame for candidates in self._pending.values() for frame in candidates if self._stale(frame, now)]
        for payload in {frame.payload for frame in expired}:
            kept = [frame for frame in self._pending[payload] if not self._stale(frame, now)]
            if kept:
                self._pending[payload] = kept
            else:
                del self._pending[payload]
        return expired

    def remaining(self) -> list[tuple[SentFrame[Row], bool]]:
        """The frames still pending at the end, each with whether it was overtaken on a reliable link and so is lost."""
        return [(frame, self._overtaken(frame)) for candidates in self._pending.values() for frame in candidates]

    def _overtaken(self, frame: SentFrame[Row]) -> bool:
        return self._reliable and frame.order < self._latest

    def _stale(self, frame: SentFrame[Row], now: Time) -> bool:
        waits = self._reliable and frame.order > self._latest
        return now - frame.left_ns > (RELIABLE_WINDOW_NS if waits else DATAGRAM_WINDOW_NS)


UNRECORDED = "unrecorded"
"""The sender of a frame whose sending node has no record of it, or of a frame that is only referred to."""

LinkDirection = tuple[str, str]
"""A link and a direction."""


class _SerialRanges:
    """True senders and serials by the provisional serials of one link direction."""

    __slots__ = ("_ends", "_exceptions", "_senders", "_shifts", "_starts")

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._senders: list[str] = []
        self._shifts: list[int] = []
        self._exceptions: dict[int, tuple[str, int]] = {}  # serials not added in ascending order

    def add(self, serial: int, sender: str, true: int) -> None:
        shift = true - serial
        if self._ends and serial < self._ends[-1]:
            self._exceptions[serial] = (sender, true)
        elif self._ends and (serial, sender, shift) == (self._ends[-1], self._senders[-1], self._shifts[-1]):
            self._ends[-1] += 1
        else:
            self._starts.append(serial)
            self._ends.append(serial + 1)
            self._senders.append(sender)
            self._shifts.append(shift)

    def get(self, serial: int) -> tuple[str, int]:
        if serial in self._exceptions:
            return self._exceptions[serial]
        place = bisect_right(self._starts, serial) - 1
        if place < 0 or serial >= self._ends[place]:
            return UNRECORDED, serial
        return self._senders[place], serial + self._shifts[place]


class FrameIdMap:
    """Map from the frame ids in one node's record to the true ids."""

    def __init__(
        self, incoming: Mapping[LinkDirection, str], serial_offsets: Mapping[tuple[str, str, str], int]
    ) -> None:
        """`incoming` has the source endpoint of each link direction that leads here from another node.

        `serial_offsets` are added to the serials of (link, direction, sender): a restarted node counts from 0 again.
        """
        self._incoming = incoming
        self._shifts = serial_offsets
        self._ranges: dict[LinkDirection, _SerialRanges] = {
            direction_key: _SerialRanges() for direction_key in incoming
        }

    def add(self, direction_key: LinkDirection, serial: int, sender: str, true: int) -> None:
        """Note that the frame with the provisional `serial` is frame number `true` of `sender`."""
        self._ranges[direction_key].add(serial, sender, true)

    def resolve(self, id_: FrameId) -> FrameId:
        """The true id; its sender is `UNRECORDED` if the frame itself is not in the record."""
        link, direction, sender, serial = id_
        if self._incoming.get((link, direction)) == sender:
            return FrameId(link, direction, *self._ranges[link, direction].get(serial))
        shift = self._shifts.get((link, direction, sender), 0)
        return FrameId(link, direction, sender, serial + shift) if shift else id_

    def resolve_text(self, id_: str) -> FrameId:
        """The true id for an id given as text."""
        return self.resolve(FrameId.parse(id_))
