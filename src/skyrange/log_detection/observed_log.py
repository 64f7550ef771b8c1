"""A log as frames at link ends in order of time, whatever its file's format, and what is in it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.codec.mavlink.message_columns import message_ids
from skyrange.contracts.frames import Ints
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port
from skyrange.core.time import Epoch, Time
from skyrange.detect.messages import name_message
from skyrange.record.read.station_frames import payload_column

ROWS: Final = pa.schema(
    [
        pa.field("at_ns", pa.int64(), nullable=False),
        pa.field("place", pa.int64(), nullable=False),
        pa.field("received", pa.int8(), nullable=False),
        pa.field("src", pa.string(), nullable=False),
        pa.field("dst", pa.string(), nullable=False),
        pa.field("payload", pa.binary(), nullable=False),
    ]
)
"""Rows of a log: time since its time 0, link end, whether the frame arrived there, its ends as claimed, its bytes."""


class Remark(NamedTuple):
    """Something about a log that a user has to know before he believes its alerts."""

    subject: str
    """What it is about: the clock, bytes, systems."""
    text: str


class LogLink(NamedTuple):
    """A link of a log: its name, such as `gcs:station/sys1`, and its two ends."""

    name: str
    a: str
    b: str


class ObservedLog(ABC):
    """Frames at link ends, in order of time."""

    path: Path
    format: str
    """`run`, `tlog`, or `capture`."""
    links: Sequence[LogLink]
    ends: Sequence[Port]
    """Every end at which frames were seen, in order of link and endpoint."""
    vehicles: Sequence[str]
    origin: Origin
    epoch: Epoch
    """UTC of time 0."""
    until_ns: Time
    """When monitors are served last, at the latest."""
    seed: int
    side: str
    """The role of the end at which the log was made; "" for a run, which has all ends."""

    declared: Sequence[Mapping[str, Any]] = ()
    """The detectors of a run, as its manifest has them."""

    @property
    @abstractmethod
    def remarks(self) -> Sequence[Remark]:
        """What was repaired, guessed or left out; complete once the rows were read."""

    @abstractmethod
    def rows(self, ends: Sequence[Port]) -> Iterator[pa.Table]:
        """Tables with the columns of `ROWS` of what was seen at some ends; `place` is in `ends`."""


def select_places(table: pa.Table, places: Ints) -> pa.Table:
    """The rows of places p with places[p] >= 0, which become that number."""
    moved = places[table.column("place").to_numpy()]
    kept = table.set_column(table.schema.get_field_index("place"), "place", pa.array(moved))
    return kept if (moved >= 0).all() else kept.filter(pa.array(moved >= 0))


@dataclass(slots=True)
class EndContents:
    """What was seen at one link end."""

    frames: int = 0
    sent: int = 0
    """Of these, how many left from there."""
    first_ns: Time | None = None
    last_ns: Time = 0
    received_messages: Counter[int] = field(default_factory=Counter)
    """MAVLink message ids of what arrived."""

    @property
    def observed_ns(self) -> Time:
        """From the first frame to the last one."""
        return 0 if self.first_ns is None else self.last_ns - self.first_ns


class Contents:
    """Counts of what was seen at each end of a log."""

    def __init__(self, ends: Sequence[Port]) -> None:
        self.ends = ends
        self.by_end = {end: EndContents() for end in ends}

    def add(self, table: pa.Table) -> None:
        """Count rows."""
        places: NDArray[np.int64] = table.column("place").to_numpy()
        if not len(places):
            return
        at, received = table.column("at_ns").to_numpy(), table.column("received").to_numpy() > 0
        ids = message_ids(payload_column(table.column("payload")))
        for place in np.unique(places).tolist():
            here, end = places == place, self.by_end[self.ends[place]]
            times = at[here]
            end.frames += len(times)
            end.sent += int((here & ~received).sum())
            end.first_ns = int(times[0]) if end.first_ns is None else end.first_ns
            end.last_ns = int(times[-1])
            numbers, counts = np.unique(ids[here & received], return_counts=True)
            end.received_messages.update(dict(zip(numbers.tolist(), counts.tolist(), strict=True)))

    def at(self, ends: Sequence[Port]) -> list[EndContents]:
        """The contents of some ends."""
        return [self.by_end[end] for end in ends if end in self.by_end]

    def messages(self, ends: Sequence[Port]) -> set[str]:
        """Names of the MAVLink messages that arrived at some ends."""
        numbers = set().union(*(contents.received_messages for contents in self.at(ends)))
        return {name for number in numbers if number >= 0 and (name := _name(number))}


def _name(number: int) -> str:
    try:
        return name_message(number)
    except KeyError:
        return ""
