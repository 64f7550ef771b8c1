"""Scans of a run by vehicle and time, as the viewer asks for them: of a record, and of a run that flies."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from functools import lru_cache
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.parquet_files import check_columns, check_values, name_damaged_file
from skyrange.core.time import Time
from skyrange.metrics.scans import Scan, list_mounted_sensors, make_scan, plain_rows, read_rows
from skyrange.record import RunRecord
from skyrange.record.read.tables import decode_spooled
from skyrange.record.schema import arrow_schema
from skyrange.record.spool import table_files

_SCANS_HELD: Final = 40
"""Scans of a sensor that are kept while a run flies: those of some seconds."""


class ScanIndex:
    """The scans of a run by vehicle and time, of which few are in memory. Reading one that is far from those that were
    read before takes as long as a row group, or, of a run that did not end, as all rows up to it.
    """

    def __init__(self, record: RunRecord) -> None:
        """Raises `InputError` as `read_scans`."""
        record.tables.require("scans")
        self._record = record
        self._sensors = {(mounted.vehicle, mounted.id): mounted for mounted in list_mounted_sensors(record)}
        table = record.tables.table("scans", ["time_ns", "vehicle", "sensor"])
        self._sent_ns = table.column("time_ns").to_numpy()
        names = zip(table.column("vehicle").to_pylist(), table.column("sensor").to_pylist(), strict=True)
        rows: dict[tuple[str, str], list[int]] = {}
        for row, name in enumerate(names):
            rows.setdefault(name, []).append(row)
        self._rows = {name: np.array(own) for name, own in rows.items()}
        self._groups = list(_list_groups(record))
        self._group = lru_cache(maxsize=2)(self._read_group)

    def newest(self, vehicle: str, until_ns: Time) -> list[Scan]:
        """The last scan that each sensor of a vehicle had sent by a time, in the order of the sensors."""
        found = []
        for mounted in self._sensors.values():
            own = self._rows.get((mounted.vehicle, mounted.id))
            if mounted.vehicle != vehicle or own is None:
                continue
            count = int(np.searchsorted(self._sent_ns[own], until_ns, side="right"))
            if count:
                found.append(make_scan(self._record, self._read(int(own[count - 1])), self._sensors))
        return found

    def _read(self, row: int) -> dict[str, Any]:
        for number, (_, _, first, count) in enumerate(self._groups):
            if first <= row < first + count:
                return next(plain_rows(self._group(number).slice(row - first, 1)))
        return next(islice(read_rows(self._record), row, None))

    def _read_group(self, number: int) -> pa.RecordBatch:
        path, place, _, _ = self._groups[number]
        who, where = str(self._record.path), path.name
        with name_damaged_file(who, where), pq.ParquetFile(path) as file:
            table = file.read_row_group(place, columns=arrow_schema("scans").names)
        table.validate(full=True)
        check_columns(table.schema, arrow_schema("scans"), who, where)
        check_values(table, arrow_schema("scans"), who, where)
        return table.combine_chunks().to_batches()[0]


class NewestScans:
    """The newest scans of a run that is recorded, in memory, from rows as the recorder writes them. One thread may add
    rows while another one reads.
    """

    def __init__(self, record: RunRecord) -> None:
        """`record` is that of the run, of which no row is read. Raises `InputError` as `list_mounted_sensors`."""
        self._record = record
        self._sensors = {(mounted.vehicle, mounted.id): mounted for mounted in list_mounted_sensors(record)}
        self._held: dict[str, deque[tuple[Time, pa.RecordBatch]]] = {}
        self._lock = Lock()

    def add(self, batch: pa.RecordBatch) -> None:
        """Take rows of `scans`, in the form of the spool."""
        rows = decode_spooled(batch, arrow_schema("scans"))
        with self._lock:
            for place, vehicle in enumerate(rows.column("vehicle").to_pylist()):
                name = f"{vehicle}.{rows.column('sensor')[place].as_py()}"
                sent_ns = rows.column("time_ns")[place].as_py()
                held = self._held.setdefault(name, deque(maxlen=_SCANS_HELD))
                held.append((sent_ns, rows.slice(place, 1)))

    def newest(self, vehicle: str, until_ns: Time) -> list[Scan]:
        """As `ScanIndex.newest`, among the last scans of each sensor."""
        found = []
        with self._lock:
            held = {name: list(rows) for name, rows in self._held.items()}
        for mounted in self._sensors.values():
            rows = [row for sent_ns, row in held.get(mounted.name, ()) if sent_ns <= until_ns]
            if mounted.vehicle == vehicle and rows:
                found.append(make_scan(self._record, next(plain_rows(rows[-1])), self._sensors))
        return found


def _list_groups(record: RunRecord) -> Iterator[tuple[Path, int, int, int]]:
    """The row groups of a run that ended: file, number, first row and rows of each."""
    first = 0
    for path in [] if record.tables.spooled else table_files((record.path / "scans.parquet").absolute()):
        with name_damaged_file(str(record.path), path.name):
            metadata = pq.read_metadata(path)
        for number in range(metadata.num_row_groups):
            count = metadata.row_group(number).num_rows
            yield path, number, first, count
            first += count
