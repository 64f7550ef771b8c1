"""Frames of a file as a log: tables of rows in order of time, from what a reader of its format finds."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.log_detection.observed_log import ROWS, LogLink, ObservedLog, Remark

MAX_LOG_NS: Final = 30 * 86_400 * NS_PER_S
_TABLE_ROWS: Final = 8192
_MOST_AT_ONCE: Final = 16 * _TABLE_ROWS
"""Frames of one time that are put in order among each other."""


_Row = tuple[Time, int, bool, str, str, bytes]


class SeenFrame(NamedTuple):
    """A frame at a link end."""

    at: Time
    place: int
    """The place of the end in `ends`."""
    received: bool
    payload: bytes


class FrameLog(ObservedLog):
    """A file of frames at the ends of some links, one end of each."""

    def __init__(self, path: Path, links: Sequence[LogLink], ends: Sequence[Port], epoch: Epoch, last_ns: Time) -> None:
        """`ends` are in order of link; `last_ns` is the time of the last frame. Raises `InputError` for a log that is
        longer than `MAX_LOG_NS`, over which monitors would be served for hours.
        """
        if last_ns > MAX_LOG_NS:
            hint = "Choose a part with --from and --to; the times of a damaged log may be wrong."
            days = f"{last_ns / MAX_LOG_NS * 30.0:,.1f} days"
            raise InputError.one(str(path), "times", days, "a log of at most 30 days", hint)
        self.path, self.links, self.ends, self.epoch = path, list(links), list(ends), epoch
        self.until_ns = last_ns
        self.vehicles = sorted({link.name.partition(":")[2] for link in links if link.name.startswith("gcs:")})
        self.origin = Origin(0.0, 0.0)
        self.seed = 0
        self._remarks: list[Remark] = []
        by_name = {link.name: link for link in links}
        self._claims = [
            (end.endpoint, by_name[end.link].b if by_name[end.link].a == end.endpoint else by_name[end.link].a)
            for end in ends
        ]

    @property
    def remarks(self) -> Sequence[Remark]:
        """See `ObservedLog`."""
        return self._remarks

    def add_remark(self, remark: Remark) -> None:
        """Add what a user has to know, before all else."""
        self._remarks.insert(0, remark)

    @abstractmethod
    def read(self) -> Iterator[SeenFrame]:
        """One pass over the frames, in order of time."""

    def rows(self, ends: Sequence[Port]) -> Iterator[pa.Table]:
        """See `ObservedLog`. Memory is bounded."""
        places = {end: place for place, end in enumerate(ends)}
        moved = [places.get(end, -1) for end in self.ends]
        held: list[_Row] = []
        for at, place, received, payload in self.read():
            if moved[place] < 0:
                continue
            if len(held) >= _TABLE_ROWS and (at > held[-1][0] or len(held) >= _MOST_AT_ONCE):
                yield _table(held)
                held = []
            own, other = self._claims[place]
            src, dst = (other, own) if received else (own, other)
            held.append((at, moved[place], received, src, dst, payload))
        yield _table(held)


def _order(row: _Row) -> tuple[Time, int, bool]:
    """As a kernel hands frames to monitors: by time, end, and what was sent before what arrived."""
    return row[:3]


def _table(held: list[_Row]) -> pa.Table:
    held.sort(key=_order)
    columns = list(zip(*held, strict=True)) or [()] * len(ROWS)
    at, place, received, src, dst, payload = columns
    arrays = (
        np.array(at, dtype=np.int64),
        np.array(place, dtype=np.int64),
        np.array(received, dtype=np.int8),
        src,
        dst,
        payload,
    )
    return pa.table([pa.array(column, field.type) for column, field in zip(arrays, ROWS, strict=True)], schema=ROWS)
