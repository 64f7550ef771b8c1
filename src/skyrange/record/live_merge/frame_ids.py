"""True ids of frames that a node of a live run could number only in order of arrival.

A node numbers the frames from another node by arrival, under the name of the link direction's source. True serials
follow the same count except for losses, so the mapping is stored as ranges: memory grows with the number of losses,
not with the length of the run.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping

from skyrange.core.ids import FrameId

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
