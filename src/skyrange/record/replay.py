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
from skyrange.contracts.monitors import MonitorPlacement, ObservedFrames, find_ends, make_monitor, serve_monitor
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
    monitor = make_monitor(placement)
    step, until = monitor.service_ns, from_seconds(record.duration)
    now: Time = 0
    waiting: list[pa.Table] = []
    for table in sort_by_time(lambda: read_observed(record, ends), "at_ns", TIES):
        at: NDArray[np.int64] = table.column("at_ns").to_numpy()
        begin = 0
        while len(at) and now < at[-1] and now <= until:  # later tables have nothing of this service any more
            end = int(np.searchsorted(at, now, side="right"))
            frames = _frames(ports, [*waiting, table.slice(begin, end - begin)])
            for alert in serve_monitor(placement.id, monitor, now, frames):
                yield RaisedAlert(now, placement.id, alert)
            waiting, begin, now = [], end, now + step
        waiting.append(table.slice(begin))
    while now <= until:
        rest = pa.concat_tables(waiting) if waiting else None
        count = int(np.searchsorted(rest.column("at_ns").to_numpy(), now, side="right")) if rest is not None else 0
        frames = _frames(ports, [rest.slice(0, count)] if rest is not None else [])
        for alert in serve_monitor(placement.id, monitor, now, frames):
            yield RaisedAlert(now, placement.id, alert)
        waiting, now = [rest.slice(count)] if rest is not None else [], now + step


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
