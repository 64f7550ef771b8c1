"""What is the true id of a frame that a node could only number as it came in?

A node numbers what comes from another node by arrival, under the name of the lane's source. True serials follow the
same count but for losses, so the names are kept as stretches: memory grows with what went missing, not with the run.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping

from skyrange.core.ids import FrameId

UNRECORDED = "unrecorded"
"""The sender of a frame that came from a node of the range whose record of it is lost, or that is referred to only."""

Lane = tuple[str, str]
"""A link and a direction."""


class _Stretches:
    """True senders and serials of one lane's provisional serials."""

    __slots__ = ("_ends", "_odd", "_senders", "_shifts", "_starts")

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._senders: list[str] = []
        self._shifts: list[int] = []
        self._odd: dict[int, tuple[str, int]] = {}  # what was not told in ascending order

    def put(self, serial: int, sender: str, true: int) -> None:
        shift = true - serial
        if self._ends and serial < self._ends[-1]:
            self._odd[serial] = (sender, true)
        elif self._ends and (serial, sender, shift) == (self._ends[-1], self._senders[-1], self._shifts[-1]):
            self._ends[-1] += 1
        else:
            self._starts.append(serial)
            self._ends.append(serial + 1)
            self._senders.append(sender)
            self._shifts.append(shift)

    def get(self, serial: int) -> tuple[str, int]:
        if serial in self._odd:
            return self._odd[serial]
        place = bisect_right(self._starts, serial) - 1
        if place < 0 or serial >= self._ends[place]:
            return UNRECORDED, serial
        return self._senders[place], serial + self._shifts[place]


class Renames:
    """The true ids behind the ids that one node's part of a record has."""

    def __init__(self, incoming: Mapping[Lane, str], shifts: Mapping[tuple[str, str, str], int]) -> None:
        """`incoming` has the source of each lane that leads in from another node.

        `shifts` is added to the serials of (link, direction, sender): of a node that began anew, so did its counts.
        """
        self._incoming = incoming
        self._shifts = shifts
        self._stretches: dict[Lane, _Stretches] = {lane: _Stretches() for lane in incoming}

    def put(self, lane: Lane, serial: int, sender: str, true: int) -> None:
        """The frame numbered `serial` as it came in is `sender`'s frame `true`."""
        self._stretches[lane].put(serial, sender, true)

    def of(self, id_: FrameId) -> FrameId:
        """The true id; `UNRECORDED`'s where the frame itself is not in the record."""
        link, direction, sender, serial = id_
        if self._incoming.get((link, direction)) == sender:
            return FrameId(link, direction, *self._stretches[link, direction].get(serial))
        shift = self._shifts.get((link, direction, sender), 0)
        return FrameId(link, direction, sender, serial + shift) if shift else id_

    def text(self, id_: str) -> FrameId:
        """The true id of one that is spelt out."""
        return self.of(FrameId.parse(id_))
