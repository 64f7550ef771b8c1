"""View `flows`: the frames of each direction at each end of a link in windows of one second, as statistics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.contracts.frames import Ints
from skyrange.core.ids import Port
from skyrange.core.time import from_seconds
from skyrange.dataset.views.window_labels import WindowLabeller, dropped_at
from skyrange.dataset.windows import WINDOW_NS, number_keys
from skyrange.record.message_groups import GROUPS, group_messages
from skyrange.record.read.run import RunRecord
from skyrange.record.read.station_frames import payload_column

Floats = np.ndarray[Any, np.dtype[np.float64]]


class FlowCounter:
    """Statistics of the frames of a run, added table by table; each table holds whole windows."""

    def __init__(self, record: RunRecord, ports: Sequence[Port]) -> None:
        self._windows = max(1, -(-from_seconds(record.duration) // WINDOW_NS))
        self._flows = [(port, received) for port in ports for received in (True, False)]
        self._place = {(port.endpoint, port.link, received): k for k, (port, received) in enumerate(self._flows)}
        size = len(self._flows) * self._windows
        self._sums = {name: np.zeros(size, dtype=np.int64) for name in _SUMS}
        self._stats = {name: np.full(size, np.nan) for name in _STATS}
        self._senders: dict[tuple[int, int], int] = {}
        self._firsts = {(row["name"]): row["a"] for row in record.manifest.get("links") or ()}

    def add(self, frames: pa.Table) -> None:
        """Add rows of the view `mavlink`."""
        flow = self._flow_of(frames)
        window = np.minimum(frames.column("window").to_numpy(), self._windows - 1)
        key = flow * self._windows + window
        order = np.argsort(key, kind="stable")
        key = key[order]
        begin = np.flatnonzero(np.diff(key, prepend=-1))
        cell = key[begin]
        if not len(cell):
            return
        size = frames.column("size").to_numpy()[order].astype(np.int64)
        self._sums["frames"][cell] = np.diff([*begin, len(key)])
        self._sums["bytes"][cell] = np.add.reduceat(size, begin)
        self._spread("size", size.astype(np.float64), begin, cell)
        self._intervals(frames.column("time_ns").to_numpy()[order], begin, cell)
        group = group_messages(payload_column(frames.column("raw")))[order]
        marks = {name: group == place for place, name in enumerate(GROUPS, 1)}
        for name, column in (("invalid", pc.invert(frames.column("valid"))), ("signed", frames.column("signed")),
                             ("hostile", frames.column("hostile")), ("derived", frames.column("derived"))):  # fmt: skip
            marks[name] = np.asarray(column)[order]
        for name, mark in marks.items():
            self._sums[name][cell] = np.add.reduceat(mark.astype(np.int64), begin)
        sender = _joined(frames, "system", "component")[order]
        message = frames.column("message_id").fill_null(-1).to_numpy()[order]
        self._sums["senders"][cell] = _distinct(key, sender, begin)
        self._sums["message_kinds"][cell] = _distinct(key, message.astype(np.int64), begin)
        self._gaps(flow[order], sender, frames.column("sequence").fill_null(-1).to_numpy()[order], begin, cell)

    def _flow_of(self, frames: pa.Table) -> Ints:
        key = ("place", "link", "received")
        codes = number_keys(frames, key)
        _, first, rows = np.unique(codes, return_index=True, return_inverse=True)
        found = frames.select(key).take(pa.array(first)).to_pylist()
        numbers = np.array([self._place[one["place"], one["link"], one["received"]] for one in found], dtype=np.int64)
        return numbers[rows]

    def _spread(self, name: str, values: Floats, begin: Ints, cell: Ints) -> None:
        count = np.diff([*begin, len(values)])
        mean = np.add.reduceat(values, begin) / count
        deviation = np.add.reduceat((values - np.repeat(mean, count)) ** 2, begin) / count
        self._stats[f"{name}_mean"][cell] = mean
        self._stats[f"{name}_std"][cell] = np.sqrt(deviation)
        self._stats[f"{name}_min"][cell] = np.minimum.reduceat(values, begin)
        self._stats[f"{name}_max"][cell] = np.maximum.reduceat(values, begin)

    def _intervals(self, time_ns: Ints, begin: Ints, cell: Ints) -> None:
        inside = np.ones(len(time_ns), dtype=np.bool_)
        inside[begin] = False
        owner = np.repeat(cell, np.diff([*begin, len(time_ns)]))[inside]
        if not len(owner):
            return
        between = np.diff(time_ns, prepend=time_ns[:1])[inside] / 1e6
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        self._spread("iat", between, first, owner[first])

    def _gaps(self, flow: Ints, sender: Ints, sequence: Ints, begin: Ints, cell: Ints) -> None:
        """Count the frames that do not follow the previous one of their flow and claimed sender."""
        gap = np.zeros(len(flow), dtype=np.int64)
        order = np.lexsort((np.arange(len(flow)), sender, flow))
        heads = np.flatnonzero((np.diff(flow[order], prepend=-1) != 0) | (np.diff(sender[order], prepend=-2) != 0))
        for at, end in zip(heads.tolist(), [*heads[1:].tolist(), len(order)], strict=True):
            rows = order[at:end]
            numbers = sequence[rows]
            if sender[rows[0]] < 0:
                continue
            key = (int(flow[rows[0]]), int(sender[rows[0]]))
            before = self._senders.get(key, int(numbers[0]) - 1)
            previous = np.append(before, numbers[:-1]).astype(np.int64)
            gap[rows] = (numbers - previous) & 0xFF != 1
            self._senders[key] = int(numbers[-1])
        self._sums["sequence_gaps"][cell] = np.add.reduceat(gap, begin)

    def tables(self, labeller: WindowLabeller, seen: dict[Port, Ints]) -> Iterator[pa.Table]:
        """The rows of the view for each flow, without its first and last columns; also windows without a frame."""
        window = np.arange(self._windows, dtype=np.int64)
        begin_ns = window * WINDOW_NS
        for place, (port, received) in enumerate(self._flows):
            cells = slice(place * self._windows, (place + 1) * self._windows)
            sums = {name: column[cells] for name, column in self._sums.items()}
            stats = {name: column[cells] for name, column in self._stats.items()}
            frames = sums["frames"]
            times = seen.get(port, np.zeros(0, dtype=np.int64))
            if received:
                direction = "rev" if self._firsts[port.link] == port.endpoint else "fwd"
                times = np.sort(np.concatenate([times, dropped_at(labeller.acts, port.link, direction)]))
            shares = {name: pa.array(sums[name] / np.maximum(frames, 1), mask=frames == 0) for name in _SHARES}
            yield pa.table(
                {
                    "place": [port.endpoint] * self._windows,
                    "link": [port.link] * self._windows,
                    "time_ns": begin_ns,
                    "received": np.full(self._windows, received),
                    "frames": frames.astype(np.int32),
                    "bytes": sums["bytes"],
                    **{name if name.startswith("size") else f"{name}_ms": pa.array(column, mask=np.isnan(column))
                       for name, column in stats.items()},
                    **shares,
                    **{name: sums[name].astype(np.int32) for name in ("message_kinds", "senders", "sequence_gaps")},
                    "window": window,
                    **labeller.columns(port.link.partition(":")[2], begin_ns, begin_ns + WINDOW_NS, times),
                    "hostile_frames": sums["hostile"].astype(np.int32),
                    "derived_frames": sums["derived"].astype(np.int32),
                }
            )  # fmt: skip


_SHARES = (*GROUPS, "invalid", "signed")
_SUMS = (*_SHARES, "frames", "bytes", "hostile", "derived", "senders", "message_kinds", "sequence_gaps")
_STATS = tuple(f"{what}_{how}" for what in ("size", "iat") for how in ("mean", "std", "min", "max"))


def _joined(frames: pa.Table, one: str, other: str) -> Ints:
    """(n,) a number for each pair of two columns; -1 where they are null."""
    first, second = (frames.column(name).fill_null(-1).to_numpy().astype(np.int64) for name in (one, other))
    joined: Ints = np.where(first < 0, -1, first * 256 + second)
    return joined


def _distinct(key: Ints, values: Ints, begin: Ints) -> Ints:
    """The number of different values in each run of equal keys."""
    order = np.lexsort((values, key))
    fresh = (np.diff(key[order], prepend=-1) != 0) | (np.diff(values[order], prepend=-(2**62)) != 0)
    found: Ints = np.add.reduceat(fresh.astype(np.int64), begin)
    return found
