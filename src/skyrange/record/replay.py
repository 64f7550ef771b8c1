"""Replay of a monitor over a finished record: the same frames at the same link ends, service time by service time.

A monitor that ran with the run raises the same alerts again. Frames of a live range were recorded under the times of
several machines, so there the alerts agree only as far as these do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate, Ints, Payloads
from skyrange.contracts.monitors import (
    Monitor,
    MonitorPlacement,
    ObservedFrames,
    find_ends,
    make_monitor,
    serve_monitor,
)
from skyrange.core.ids import Port, originator_id
from skyrange.core.time import Time, from_seconds
from skyrange.record.read.run import RunRecord
from skyrange.record.read.station_frames import payload_column
from skyrange.record.read.time_order import sort_by_time
from skyrange.record.write.memory_observer import RaisedAlert

_COLUMNS = ("link", "direction", "sender", "serial", "src", "dst", "sent_ns", "arrived_ns", "fate")
TIES = ("place", "received", "sender", "serial")


def replay_monitor(record: RunRecord, placement: MonitorPlacement) -> Iterator[RaisedAlert]:
    """The alerts that a monitor raises over the run of `record`, in the order in which it raises them.

    The monitor, a new one, is served as during a run: at every multiple of its service time from 0 to the end. Memory
    is bounded: frames are read in batches, twice. Raises `InputError` for a placement that matches no end of a link,
    `ComponentError` for a monitor that breaks its contract.
    """
    record.tables.require("frames")
    rows = record.manifest.get("links") or []
    ports = find_ends(placement, [(row["name"], row["a"], row["b"]) for row in rows])
    ends = LinkEnds(ports, {row["name"]: (row["a"], row["b"]) for row in rows})
    service = MonitorService([placement], ports, from_seconds(record.duration))
    for table in sort_by_time(lambda: read_observed(record, ends), "at_ns", TIES):
        yield from service.take(table)
    yield from service.finish()


class MonitorService:
    """New monitors at the same link ends, served as during a run with what is seen there.

    Rows have the columns `at_ns`, `place` (in `ports`), `received`, `src`, `dst` and `payload`, and are in order of
    time, then `TIES`.
    """

    def __init__(
        self, placements: Sequence[MonitorPlacement], ports: Sequence[Port], until: Time, *, past_end: bool = False
    ) -> None:
        """Make the monitors, which are served up to and with `until`; with `past_end` once more if something of the
        time before it was not shown by then. `InputError` as `make_monitor`.
        """
        made = [(placement.id, make_monitor(placement)) for placement in sorted(placements, key=_id_of)]
        steps = sorted({monitor.service_ns for _, monitor in made})
        self._turns = [
            _Turns(
                ports,
                [(id_, monitor) for id_, monitor in made if monitor.service_ns == step],
                step,
                -(-until // step) * step if past_end else until,
            )
            for step in steps
        ]

    def take(self, table: pa.Table) -> Iterator[RaisedAlert]:
        """Take in rows; the alerts of all services that later rows no longer concern. Raises `ComponentError`."""
        for turns in self._turns:
            yield from turns.take(table)

    def finish(self) -> Iterator[RaisedAlert]:
        """The alerts of all services that are left, up to the end. Raises `ComponentError`."""
        for turns in self._turns:
            yield from turns.finish()


class _Turns:
    """Monitors that are served together, every `step` ns."""

    def __init__(self, ports: Sequence[Port], monitors: Sequence[tuple[str, Monitor]], step: Time, until: Time) -> None:
        self._ports, self._monitors, self._step, self._until = ports, monitors, step, until
        self._now: Time = 0
        self._waiting: list[pa.Table] = []

    def take(self, table: pa.Table) -> Iterator[RaisedAlert]:
        at: NDArray[np.int64] = table.column("at_ns").to_numpy()
        begin = 0
        while len(at) and self._now < at[-1] and self._now <= self._until:  # later tables have nothing of this service
            end = int(np.searchsorted(at, self._now, side="right"))
            yield from self._serve([*self._waiting, table.slice(begin, end - begin)])
            self._waiting, begin = [], end
        self._waiting.append(table.slice(begin))

    def finish(self) -> Iterator[RaisedAlert]:
        rest = pa.concat_tables(self._waiting) if self._waiting else None
        while self._now <= self._until:
            count = 0 if rest is None else int(np.searchsorted(rest.column("at_ns").to_numpy(), self._now, "right"))
            yield from self._serve([rest.slice(0, count)] if rest is not None else [])
            rest = rest.slice(count) if rest is not None else None

    def _serve(self, tables: Sequence[pa.Table]) -> Iterator[RaisedAlert]:
        now, self._now = self._now, self._now + self._step
        frames = _frames(self._ports, tables)
        for id_, monitor in self._monitors:
            for alert in serve_monitor(id_, monitor, now, frames):
                yield RaisedAlert(now, id_, alert)


def _id_of(placement: MonitorPlacement) -> str:
    return placement.id


class LinkEnds(NamedTuple):
    """The ends that are observed, and both ends of every link by its name."""

    ports: Sequence[Port]
    links: dict[str, tuple[str, str]]


def read_observed(record: RunRecord, ends: LinkEnds) -> Iterator[pa.Table]:
    """What was seen at the ends, a row each time, in batches as recorded."""
    number = {port: place for place, port in enumerate(ends.ports)}
    for batch in record.tables.frames_with_payloads(_COLUMNS):
        flows, codes = _flows(batch)
        places = np.full((2, len(flows)), -1, dtype=np.int64)
        for code, (link, direction, sender) in enumerate(flows):
            a, b = ends.links.get(link, ("", ""))
            src, dst = (a, b) if direction == "fwd" else (b, a)
            if sender in (src, originator_id(src)):
                places[0, code] = number.get(Port(src, link), -1)
            places[1, code] = number.get(Port(dst, link), -1)
        delivered = np.asarray(pc.equal(batch.column("fate"), str(Fate.DELIVERED)))
        for received, (time, is_seen) in enumerate((("sent_ns", True), ("arrived_ns", delivered))):
            place = places[received][codes]
            chosen = pa.array((place >= 0) & is_seen)
            yield pa.table(
                {
                    "at_ns": batch.column(time),
                    "place": pa.array(place),
                    "received": pa.array(np.full(len(place), received, dtype=np.int8)),
                    "sender": batch.column("sender"),
                    "serial": batch.column("serial"),
                    "src": batch.column("src"),
                    "dst": batch.column("dst"),
                    "payload": batch.column("payload"),
                }
            ).filter(chosen)


def _flows(batch: pa.Table) -> tuple[list[tuple[str, str, str]], Ints]:
    """The different (link, direction, sender) of a batch, and which of them each row has."""
    codes = np.zeros(batch.num_rows, dtype=np.int64)
    names: list[list[str]] = []
    for name in ("link", "direction", "sender"):
        column = batch.column(name).combine_chunks().dictionary_encode()
        column = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
        names.append(column.dictionary.to_pylist())
        codes = codes * max(1, len(names[-1])) + column.indices.to_numpy(zero_copy_only=False)
    distinct, rows = np.unique(codes, return_inverse=True)
    flows = []
    for code in distinct.tolist():
        rest, sender = divmod(code, len(names[2]))
        link, direction = divmod(rest, len(names[1]))
        flows.append((names[0][link], names[1][direction], names[2][sender]))
    return flows, rows


def _frames(ports: Sequence[Port], tables: Sequence[pa.Table]) -> ObservedFrames:
    """Rows in order as a monitor gets them."""
    none = np.zeros(0, dtype=np.int64)
    if not tables:
        return ObservedFrames(ports, none, none > 0, none, payloads=Payloads.of([]), names=[], src=none, dst=none)
    table = pa.concat_tables(tables).combine_chunks()
    src, dst = (table.column(name).to_pylist() for name in ("src", "dst"))
    numbers = {name: number for number, name in enumerate(sorted({*src, *dst}))}
    return ObservedFrames(
        ports,
        table.column("place").to_numpy(),
        table.column("received").to_numpy() > 0,
        table.column("at_ns").to_numpy(),
        payloads=payload_column(table.column("payload")),
        names=list(numbers),
        src=np.array([numbers[name] for name in src], dtype=np.int64),
        dst=np.array([numbers[name] for name in dst], dtype=np.int64),
    )
