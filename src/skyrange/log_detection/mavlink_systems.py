"""Which MAVLink systems of a log are vehicles and which are ground stations, and the link of each frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Final, NamedTuple

from skyrange.codec.mavlink.frames import HEADER_V1, HEADER_V2, MAGIC_V2, dialect
from skyrange.codec.mavlink.message_columns import payload_dtype

HEARTBEAT: Final = 0
STATION_SYSTEM: Final = 255
"""A ground station's by convention (mavlink.io, Routing)."""
_STATION_COMPONENT: Final = dialect.MAV_COMP_ID_MISSIONPLANNER
_GCS: Final = dialect.MAV_TYPE_GCS
_NO_AUTOPILOT: Final = dialect.MAV_AUTOPILOT_INVALID
_TYPE, _AUTOPILOT = 4, 5
"""Offsets in HEARTBEAT's payload (common.xml; fields are ordered by size)."""
_NUMBERS: Final = 256
_IN_ONE_SEQUENCE: Final = 0.75
"""Share of frames that follow the one before in number from which a station counts them all in one sequence."""


class Head(NamedTuple):
    """Fields of a frame that say where it belongs."""

    system: int
    component: int
    sequence: int
    message: int
    target: int
    """The system that it is for; 0 for all, and where the message names none."""


@cache
def _target_offset(message: int) -> int:
    """Where a message has its `target_system` in its payload; -1 if it has none."""
    fields = payload_dtype(message).fields
    return int(fields["target_system"][1]) if fields is not None and "target_system" in fields else -1


def read_head(frame: bytes) -> Head:
    """The head of a good frame."""
    if frame[0] == MAGIC_V2:
        start, message = HEADER_V2, frame[7] | frame[8] << 8 | frame[9] << 16
        sequence, system, component = frame[4], frame[5], frame[6]
    else:
        start, message = HEADER_V1, frame[5]
        sequence, system, component = frame[2], frame[3], frame[4]
    at = _target_offset(message)
    return Head(system, component, sequence, message, frame[start + at] if 0 <= at < frame[1] else 0)


@dataclass(slots=True)
class SystemCounts:
    """Frames by system, and what their heartbeats say."""

    frames: Counter[int] = field(default_factory=Counter)
    vehicles: set[int] = field(default_factory=set)
    """Systems with a component that has an autopilot."""
    stations: set[int] = field(default_factory=set)
    """Systems that say that they are ground stations, and those with a station's ids."""
    _next: dict[tuple[int, int], int] = field(default_factory=dict)
    _station_frames: int = 0
    _in_sequence: int = 0

    def add(self, head: Head, frame: bytes) -> None:
        """Count a frame."""
        system, component = head.system, head.component
        self.frames[system] += 1
        if head.message == HEARTBEAT:
            start = HEADER_V2 if frame[0] == MAGIC_V2 else HEADER_V1
            # MAVLink 2 cuts zeros at the end
            kind, autopilot = (frame[start + at] if at < frame[1] else 0 for at in (_TYPE, _AUTOPILOT))
            if kind == _GCS:
                self.stations.add(system)
            elif autopilot != _NO_AUTOPILOT:
                self.vehicles.add(system)
        if component == _STATION_COMPONENT or system == STATION_SYSTEM:
            self.stations.add(system)
            source = system, component
            self._in_sequence += self._next.get(source) == head.sequence
            self._next[source] = (head.sequence + 1) % _NUMBERS
            self._station_frames += 1

    @property
    def numbers_each_link(self) -> bool:
        """Whether the station numbers the frames of each link on their own, as far as can be told."""
        return self._in_sequence < _IN_ONE_SEQUENCE * max(self._station_frames - 1, 1)

    def list_vehicles(self) -> list[int]:
        """The vehicles: systems with an autopilot; if none says so, all that are no ground station."""
        found = sorted(self.vehicles - self.stations) or sorted(self.vehicles)
        return found or sorted(self.frames.keys() - self.stations)


class LinkFinder:
    """The links of frames, by the numbers of `vehicles` in their order."""

    def __init__(
        self, vehicles: Sequence[int], stations: Iterable[int], home: int = 0, *, numbers_each_link: bool
    ) -> None:
        """`home` is the link of systems that are neither vehicles nor stations, such as a radio of the station.

        `numbers_each_link` as of `SystemCounts`.
        """
        self._home = (home,)
        self._place = {system: place for place, system in enumerate(vehicles)}
        self._every = tuple(range(len(vehicles)))
        self._stations = set(stations) - set(vehicles)
        self._each = numbers_each_link and len(vehicles) > 1
        self._next: dict[tuple[int, int, int], int] = {}
        self.others: Counter[int] = Counter()
        """Frames of systems that are neither vehicles nor stations."""
        self.shared = 0
        """Frames of a station to no vehicle in particular, which are taken as seen on every link."""

    def is_from_station(self, head: Head) -> bool:
        """Whether a ground station sent a frame."""
        return head.system in self._stations

    def find(self, head: Head) -> Sequence[int]:
        """The links on which a frame was seen."""
        if not self.is_from_station(head):
            place = self._place.get(head.system)
            if place is None:
                self.others[head.system] += 1
                return self._home
            return (place,)
        place = self._place.get(head.target)
        if place is None and self._each:
            place = self._find_expecting(head)
        if place is None:
            self.shared += len(self._every) > 1
            return self._every
        if self._each:
            self._next[head.system, head.component, place] = (head.sequence + 1) % _NUMBERS
        return (place,)

    def _find_expecting(self, head: Head) -> int:
        """The link whose next number is that of a frame, or the one whose next number is least behind it."""
        behind = [
            (head.sequence - self._next.get((head.system, head.component, place), head.sequence)) % _NUMBERS
            for place in self._every
        ]
        return behind.index(min(behind))
