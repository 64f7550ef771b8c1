"""Record of one node of a live run, converted to the range's clock; it may be incomplete or damaged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate
from skyrange.core.errors import InputError
from skyrange.core.files import DRAFT
from skyrange.core.time import NEVER, Time
from skyrange.record.folder import PARTS
from skyrange.record.live_merge.frame_matching import TOLERANCE_NS, FrameIdMap, LinkDirection
from skyrange.record.manifest import MANIFEST
from skyrange.record.read.run import load
from skyrange.record.read.tables import Tables
from skyrange.record.read.time_order import sort_by_time
from skyrange.record.schema import DERIVED, OPTIONAL, TABLES
from skyrange.record.spool import SPOOL

FRAME_COLUMNS = (
    "link", "direction", "sender", "serial", "src", "dst", "sent_ns", "arrived_ns", "fate", "parent", "causes",
)  # fmt: skip
"""The columns that are read of a frame, besides its payload."""

LOCAL, OUTGOING, INCOMING = 0, 1, 2
"""A frame within its node; a frame sent to another node; a frame received from another node."""

_TIMES = {name: ["time_ns"] for name in TABLES} | {
    "alerts": ["time_ns", "at_ns"],
    "labels": ["at_ns", "until_ns"],
    "frames": ["sent_ns", "arrived_ns"],
}
_OWN = {MANIFEST, f"{MANIFEST}{DRAFT}", SPOOL, PARTS, "operators", "telemetry"}

Flow = tuple[str, str, str]
"""Link, direction and sender: each flow numbers its frames separately."""


@dataclass(slots=True)
class NodeRecord:
    """One node's record; `status` is complete, interrupted, failed, killed or missing."""

    number: int
    folder: Path
    name: str
    status: str
    offset_ns: Time = 0
    endpoints: frozenset[str] = frozenset()
    until_ns: Time | None = None
    """The time until which the node states that it recorded."""
    tables: Tables | None = None
    rows: dict[str, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    first_ns: Time = NEVER
    last_ns: Time = -NEVER
    directions: dict[LinkDirection, tuple[int, str]] = field(default_factory=dict)
    """The link directions between this node and others: `OUTGOING` or `INCOMING`, and the source endpoint."""
    next_serials: dict[Flow, int] = field(default_factory=dict)
    """Per flow that the node numbered, one more than the greatest serial."""
    serial_offsets: dict[Flow, int] = field(default_factory=dict)
    """Per flow, the number to add to serials if an earlier part of the node has the same flow."""
    id_map: FrameIdMap = field(default_factory=lambda: FrameIdMap({}, {}))

    @classmethod
    def open(cls, number: int, folder: Path) -> NodeRecord:
        """The part in `folder`; if it cannot be read, its status is `missing` and it has no rows."""
        try:
            record = load(folder)
        except InputError as error:
            return cls(number, folder, folder.name, "missing", problems=[str(error)])
        node = record.manifest.get("node")
        if not _is_node_entry(node):
            problem = f"{MANIFEST}: node: {node!r:.80}, expected a table of name, endpoints and offset_ns"
            return cls(number, folder, folder.name, "missing", problems=[problem])
        offset, until = node["offset_ns"], node.get("until_ns")
        return cls(
            number,
            folder,
            node["name"],
            record.status if record.ended else "killed",
            offset,
            frozenset(node["endpoints"]),
            until + offset if isinstance(until, int) else None,
            record.tables,
        )

    def scan(self, sources: Mapping[LinkDirection, tuple[str, str]]) -> None:
        """Scan the part for row counts, times, border and serials; `sources` has both ends of each direction."""
        for direction_key, (src, dst) in sources.items():
            if (src in self.endpoints) != (dst in self.endpoints):
                self.directions[direction_key] = (OUTGOING if src in self.endpoints else INCOMING, src)
        for name in TABLES:
            if name == "payloads" or name in DERIVED or self.tables is None:
                continue
            try:
                self.rows[name] = sum(map(self._scan_batch, self._raw(name, _TIMES[name])))
                if name in OPTIONAL and not self.rows[name]:
                    del self.rows[name]
            except InputError as error:
                self.rows[name] = 0
                self.problems.append(str(error))

    def _scan_batch(self, batch: pa.Table) -> int:
        for name in batch.column_names:
            if name in ("time_ns", "at_ns", "sent_ns", "arrived_ns") and batch.num_rows:
                bounds = pc.min_max(batch.column(name)).as_py()
                if bounds["min"] is not None:
                    self.first_ns = min(self.first_ns, bounds["min"] + self.offset_ns)
                    self.last_ns = max(self.last_ns, bounds["max"] + self.offset_ns)
        if "serial" in batch.column_names:
            for flow, serials in _flows(batch):
                if self.directions.get(flow[:2]) != (INCOMING, flow[2]):
                    self.next_serials[flow] = max(self.next_serials.get(flow, 0), int(serials.max()) + 1)
        return int(batch.num_rows)

    def _raw(self, name: str, columns: Sequence[str] | None) -> Iterator[pa.Table]:
        """A table as recorded; frames always have their payloads, link, direction, sender and serial."""
        if self.tables is None:
            return
        if name != "frames":
            for batch in self.tables.batches(name, columns):
                yield pa.Table.from_batches([batch])
            return
        wanted = FRAME_COLUMNS if columns is None else ("link", "direction", "sender", "serial", *columns)
        for table in self.tables.frames_with_payloads(wanted):
            yield table if columns is None else table.drop_columns(["payload"])

    # ---------------------------------------------------------------- rows in order of time, on the range clock

    def read(self, name: str) -> Iterator[pa.Table]:
        """A table other than frames in order of time, with the columns `part` and `row` (its number in the part)."""
        key = _TIMES[name][0]
        if self.rows.get(name):
            yield from sort_by_time(lambda: self._numbered(name), key, ("row",))

    def frames(self, *, crossing: bool) -> Iterator[pa.Table]:
        """The frames that crossed the node's border, or those that did not.

        Serials continue those of earlier parts. Columns are `FRAME_COLUMNS`, `payload`, `part`, `row`. Frames that
        stayed within the node are in order of sending. Frames that crossed are in the order in which they are matched:
        by `key_ns`, which for a received frame is late enough that everything sent by then is known, then by `how`
        (`OUTGOING` or `INCOMING`) and `order` (of leaving or of arrival). `left_ns` is approximately when a frame left.
        """
        if self.rows.get("frames"):
            key = ("key_ns", ("how", "order")) if crossing else ("sent_ns", ("link", "direction", "sender", "serial"))
            yield from sort_by_time(lambda: self._classify_frames(crossing=crossing), *key)

    def _classify_frames(self, *, crossing: bool) -> Iterator[pa.Table]:
        left = -NEVER
        for table in self._numbered("frames"):
            how = np.zeros(table.num_rows, dtype=np.int8)
            serial = table.column("serial").to_numpy().copy()
            handed = np.asarray(pc.equal(table.column("fate"), str(Fate.IN_FLIGHT)))
            for (link, direction, sender), rows in _flows(table, which="rows"):
                crossing_kind, source = self.directions.get((link, direction), (LOCAL, ""))
                if crossing_kind == OUTGOING:
                    how[rows[handed[rows]]] = OUTGOING
                elif crossing_kind == INCOMING and sender == source:
                    how[rows] = INCOMING
                    continue
                serial[rows] += self.serial_offsets.get((link, direction, sender), 0)
            table = table.set_column(table.column_names.index("serial"), "serial", pa.array(serial))
            # rows are written as frames leave, so a frame left no earlier than any frame written before it was sent
            lefts = np.maximum.accumulate(np.append(left, table.column("sent_ns").to_numpy()))
            left = int(lefts[-1])
            if crossing:
                incoming = how == INCOMING
                table = (
                    table.append_column("how", pa.array(how))
                    .append_column("left_ns", pa.array(lefts[1:]))
                    .append_column("order", pa.array(np.where(incoming, serial, table.column("row").to_numpy())))
                    .append_column("key_ns", pc.add(table.column("sent_ns"), pa.array(incoming * TOLERANCE_NS)))
                )
            yield table.filter(pa.array((how != LOCAL) == crossing))

    def _numbered(self, name: str) -> Iterator[pa.Table]:
        rows = 0
        for table in self._raw(name, None):
            for column in _TIMES[name]:
                moved = _shift_times(table.column(column), self.offset_ns)
                table = table.set_column(table.column_names.index(column), column, moved)
            table = table.append_column("part", pa.array(np.full(table.num_rows, self.number, dtype=np.int64)))
            yield table.append_column("row", pa.array(np.arange(rows, rows + table.num_rows, dtype=np.int64)))
            rows += table.num_rows

    # ---------------------------------------------------------------- files and summary

    def files(self) -> Iterator[tuple[str, Path]]:
        """The files besides the tables, with their names in the folder."""
        if self.tables is not None:
            yield from attached_files(self.folder)

    def manifest_entry(self) -> dict[str, Any]:
        """The part's entry in the manifest of the merged run."""
        entry = {"name": self.name, "status": self.status, "offset_ns": self.offset_ns, "rows": self.rows}
        return entry | ({"problems": self.problems} if self.problems else {})


def attached_files(folder: Path) -> Iterator[tuple[str, Path]]:
    """The files of a run or a part that are not the record's own, with their names in the folder."""
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        tabular = name.parts[0].endswith(".parquet")
        if path.is_file() and not path.is_symlink() and name.parts[0] not in _OWN and not tabular:
            yield str(name), path


def _flows(table: pa.Table, which: str = "serials") -> Iterator[tuple[Flow, NDArray[np.int64]]]:
    """For each flow in a table, the serials of its frames or their row numbers."""
    if not table.num_rows:
        return
    numbers, names = [], []
    for name in ("link", "direction", "sender"):
        column = table.column(name).combine_chunks().dictionary_encode()
        column = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
        numbers.append(column.indices.to_numpy(zero_copy_only=False).astype(np.int64))
        names.append(column.dictionary.to_pylist())
    link, direction, sender = names
    flow = (numbers[0] * len(direction) + numbers[1]) * len(sender) + numbers[2]
    order = np.argsort(flow, kind="stable").astype(np.int64)
    codes, starts = np.unique(flow[order], return_index=True)
    serials: NDArray[np.int64] = table.column("serial").to_numpy()
    for code, rows in zip(codes.tolist(), np.split(order, starts[1:]), strict=True):
        rest, last = divmod(code, len(sender))
        key = (link[rest // len(direction)], direction[rest % len(direction)], sender[last])
        yield key, rows if which == "rows" else serials[rows]


def _shift_times(column: pa.ChunkedArray, offset_ns: Time) -> pa.ChunkedArray:
    """Times plus the offset; null and `NEVER` are unchanged."""
    return pc.if_else(pc.equal(column, NEVER), column, pc.add(column, pa.scalar(offset_ns, pa.int64())))


def _is_node_entry(node: object) -> TypeGuard[Mapping[str, Any]]:
    if not isinstance(node, Mapping):
        return False
    endpoints = node.get("endpoints")
    if not isinstance(endpoints, list) or not all(isinstance(endpoint, str) for endpoint in endpoints):
        return False
    return isinstance(node.get("name"), str) and isinstance(node.get("offset_ns"), int)
