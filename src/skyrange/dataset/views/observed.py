"""Frames as they are seen at places: ends of links, in order of time, each with its labels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import is_side
from skyrange.core.ids import Port
from skyrange.dataset.labels import FrameLabels
from skyrange.dataset.windows import WINDOW_NS, by_whole_windows
from skyrange.record.read.run import RunRecord
from skyrange.record.read.time_order import STRAGGLER_ROWS, sort_by_time
from skyrange.record.replay import TIES, LinkEnds, read_observed


@dataclass(frozen=True, slots=True)
class Place:
    """Where a sensor listens: the `side` end of every link that matches `links`, as of a detector."""

    links: str = "gcs:*"
    side: str = "gcs"


@dataclass(slots=True)
class SeenActs:
    """When hostile or derived frames were seen at each end of a link."""

    times: dict[Port, list[Ints]] = field(default_factory=dict)
    authors: dict[tuple[str, str], int] = field(default_factory=dict)
    """By (link, author), when the first was seen at an end of that link."""

    def at(self, port: Port) -> Ints:
        """The times at one end, in order."""
        return np.concatenate([np.zeros(0, dtype=np.int64), *self.times.get(port, ())])


def ports_of(record: RunRecord, places: Sequence[Place]) -> list[Port]:
    """The ends of links at these places, in order of link and endpoint; a place may match none."""
    found: set[Port] = set()
    for row in record.manifest.get("links") or ():
        for place in places:
            if fnmatchcase(row["name"], place.links):
                found.update(Port(end, row["name"]) for end in (row["a"], row["b"]) if is_side(end, place.side))
    return sorted(found, key=lambda port: (port.link, port.endpoint))


def seen_frames(
    record: RunRecord, ports: Sequence[Port], labels: FrameLabels, seen: SeenActs
) -> Iterator[tuple[Ints, pa.Table]]:
    """What is seen at `ports`, in tables of whole windows: times, claims, payload, labels and `window`; and the number
    of the port of each row.

    Fills `seen`. Memory is bounded as in `record.read.time_order`. Raises `InputError` for a record without frames.
    """
    rows = {row["name"]: (row["a"], row["b"]) for row in record.manifest.get("links") or ()}
    ends = LinkEnds(ports, rows)
    names = pa.array([port.link for port in ports], pa.string())
    endpoints = pa.array([port.endpoint for port in ports], pa.string())
    first = np.array([rows[port.link][0] == port.endpoint for port in ports], dtype=np.bool_)
    if not ports:
        return
    record.tables.require("frames")
    ordered = sort_by_time(_Passes(lambda: read_observed(record, ends)), "at_ns", TIES)
    for table in by_whole_windows(ordered, "at_ns", WINDOW_NS):
        place = table.column("place").to_numpy()
        received = table.column("received").to_numpy() > 0
        link = names.take(pa.array(place))
        ids = None
        if len(labels.ids):
            direction = pa.array(np.where(first[place] ^ received, "fwd", "rev"))
            serial = table.column("serial").cast(pa.string())
            ids = pc.binary_join_element_wise(link, direction, table.column("sender"), serial, "|")
        found = labels.columns(ids, table.num_rows)
        _collect(seen, ports, place, table.column("at_ns").to_numpy(), found)
        at_ns = table.column("at_ns")
        yield (
            place,
            pa.table(
                {
                    "place": endpoints.take(pa.array(place)),
                    "link": link,
                    "time_ns": at_ns,
                    "received": pa.array(received),
                    "src": table.column("src"),
                    "dst": table.column("dst"),
                    "size": pc.binary_length(table.column("payload")).cast(pa.int32()),
                    "raw": table.column("payload"),
                    "window": pa.array(at_ns.to_numpy() // WINDOW_NS),
                    **found,
                }
            ),
        )


class _Passes:
    """Passes over tables, of which each reads them anew if they are more than `STRAGGLER_ROWS` rows together; fewer
    are kept from the first pass.
    """

    def __init__(self, read: Callable[[], Iterator[pa.Table]]) -> None:
        self._read = read
        self._kept: list[pa.Table] | None = None

    def __call__(self) -> Iterator[pa.Table]:
        return iter(self._kept) if self._kept is not None else self._pass()

    def _pass(self) -> Iterator[pa.Table]:
        kept, rows = [], 0
        for table in self._read():
            rows += table.num_rows
            if rows <= STRAGGLER_ROWS:
                kept.append(table)
            else:
                kept.clear()
            yield table
        if rows <= STRAGGLER_ROWS:
            self._kept = kept


def _collect(seen: SeenActs, ports: Sequence[Port], place: Ints, at_ns: Ints, found: dict[str, pa.Array]) -> None:
    shown = np.asarray(pc.or_(found["hostile"], found["derived"]))
    for port in np.unique(place[shown]).tolist():
        rows = shown & (place == port)
        seen.times.setdefault(ports[port], []).append(at_ns[rows])
        authors = found["author"].filter(pa.array(rows)).to_pylist()
        for author, time_ns in zip(authors, at_ns[rows].tolist(), strict=True):
            seen.authors.setdefault((ports[port].link, str(author)), time_ns)
