"""Parquet files of tables, telemetry and features, written by row groups, under temporary names until whole."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.record.dictionaries import unify_dictionaries
from skyrange.record.folder import describe_file
from skyrange.record.read.features import merge_features
from skyrange.record.read.station_frames import StationFrames
from skyrange.record.read.tables import Tables, combine_batches, decode_spooled, encoded_schema
from skyrange.record.read.telemetry import message_schema, received_messages
from skyrange.record.schema import arrow_schema, truth_columns
from skyrange.record.spool import OPEN, SPOOL, closed_part_path, spool_files
from skyrange.record.write.files.parquet import open_parquet

GROUP_ROWS: Final = 131_072
"""Rows of a Parquet row group, the smallest unit that a reader must hold in memory."""

WIDE_GROUP_ROWS: Final = 32_768
"""The same for observations, which have a column for each field of Remote ID."""


class TableFiles:
    """The open part of each table of a run, and the closed ones, beside its spool."""

    def __init__(self, folder: Path) -> None:
        """`folder` is the run's."""
        self._folder = folder.absolute()  # Arrow reads a relative name with a colon or a tilde as a URI
        self._open: dict[str, tuple[pa.Schema, pq.ParquetWriter]] = {}
        self.described: dict[Path, dict[str, Any]] = {}
        """Size and hash of each closed part."""

    def write(self, table: str, rows: pa.Table) -> None:
        """Append a row group of `table` to its open part; rows are as in the spool."""
        if table not in self._open:
            names = rows.column_names
            schema = arrow_schema(table, truth_columns(names[3:]) if table == "truth" else None)
            self._open[table] = (encoded_schema(schema), self._open_file(table, schema))
        schema, writer = self._open[table]
        # one dictionary for all rows first: of batches with many dictionaries Arrow writes each separately
        for batch in unify_dictionaries(rows).to_batches():
            writer.write_batch(_sort_names(decode_spooled(batch, schema)), row_group_size=GROUP_ROWS)

    def _open_file(self, table: str, schema: pa.Schema) -> pq.ParquetWriter:
        path = self._folder / SPOOL / f"{table}.parquet{OPEN}"
        return open_parquet(path, schema)

    def close_part(self, table: str, segment: int) -> None:
        """Close the open part of `table`, which is made without rows if there is none, and delete the segments of the
        spool up to `segment`, which it replaces.
        """
        _, writer = self._open.pop(table, None) or (None, self._open_file(table, arrow_schema(table)))
        writer.close()
        path, made = closed_part_path(self._folder, table, segment), self._folder / SPOOL / f"{table}.parquet{OPEN}"
        self.described[path] = describe_file(made, str(self._folder), made.name)
        made.replace(path)
        for replaced in (self._folder / SPOOL).glob(f"{table}-*.arrows"):
            if int(replaced.stem.rpartition("-")[2]) <= segment:
                replaced.unlink()

    def has_part(self, table: str) -> bool:
        """Whether a part of `table` was closed."""
        return any(file.closed for file in spool_files(self._folder, table))

    def abandon(self) -> None:
        """Close and delete all open parts; their rows are in the spool."""
        for table, (_, writer) in self._open.items():
            with suppress(OSError, pa.ArrowException):
                writer.close()
            (self._folder / SPOOL / f"{table}.parquet{OPEN}").unlink(missing_ok=True)
        self._open.clear()


def _sort_names(batch: pa.RecordBatch) -> pa.RecordBatch:
    """The batch with the names of each dictionary in order, and only those that occur.

    The order in which names were first seen depends on when the recorder wrote.
    """
    columns = []
    for column in batch.columns:
        if pa.types.is_dictionary(column.type):
            codes = column.indices.fill_null(0).to_numpy(zero_copy_only=False)
            indices = column.indices.drop_null().to_numpy(zero_copy_only=False)
            used = np.flatnonzero(np.bincount(indices, minlength=len(column.dictionary))) if len(indices) else indices
            names = column.dictionary.take(pa.array(used))
            order = pa.compute.array_sort_indices(names).to_numpy()
            place = np.zeros(max(len(column.dictionary), 1), dtype=np.int32)
            place[used[order]] = np.arange(len(order), dtype=np.int32)
            mask = column.is_null().to_numpy(zero_copy_only=False) if column.null_count else None
            column = pa.DictionaryArray.from_arrays(pa.array(place[codes], mask=mask), names.take(pa.array(order)))
        columns.append(column)
    return pa.RecordBatch.from_arrays(columns, schema=batch.schema)


HELD_ROWS: Final = 262_144
"""Rows of all messages that are held in memory; of what has most, a group is written then."""


class TelemetryFiles:
    """The files, opened when their first rows are written. `close` writes what is held; a context manager does."""

    def __init__(self, folder: Path) -> None:
        """`folder` is made with the first file."""
        self.counts: dict[str, int] = {}
        """Rows by message."""
        self._folder = folder
        self._open_files = ExitStack()
        self._writers: dict[str, pq.ParquetWriter] = {}
        self._held: dict[str, list[pa.RecordBatch]] = {}
        self._rows: dict[str, int] = {}

    def write(self, block: StationFrames) -> None:
        """Write the messages that were received."""
        for message, batch in received_messages(block):
            self._held.setdefault(message, []).append(batch)
            self.counts[message] = self.counts.get(message, 0) + batch.num_rows
            self._rows[message] = self._rows.get(message, 0) + batch.num_rows
            if self._rows[message] >= GROUP_ROWS:
                self._write_group(message)
        while sum(self._rows.values()) > HELD_ROWS:
            self._write_group(max(self._rows, key=self._rows.__getitem__))

    def _write_group(self, message: str) -> None:
        writer = self._writers.get(message)
        if writer is None:
            self._folder.mkdir(exist_ok=True)
            path = self._folder / f"{message}.parquet"
            writer = self._open_files.enter_context(open_parquet(path, message_schema(message)))
            self._writers[message] = writer
        writer.write_table(
            unify_dictionaries(pa.Table.from_batches(self._held.pop(message))), row_group_size=GROUP_ROWS
        )
        self._rows[message] = 0

    def close(self) -> None:
        """Write what is held and close the files. Raises `OSError` and `ArrowException`."""
        try:
            for message in sorted(self._held):
                self._write_group(message)
        finally:
            self._open_files.close()

    def abandon(self) -> None:
        """Close the files without what is held."""
        self._held.clear()
        with suppress(OSError, pa.ArrowException):
            self._open_files.close()

    def __enter__(self) -> TelemetryFiles:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if error is None:
            self.close()
        else:
            self.abandon()


def write_features(tables: Tables) -> dict[str, int]:
    """Write the file beside the spool of `tables`, of one shard; returns the name of the table with its rows, or
    nothing if it has none. Raises `OSError` and `ArrowException`. Memory stays bounded.
    """
    schema = arrow_schema("features")
    merged = (batch for table in merge_features(tables) for batch in table.to_batches())
    rows = 0
    writer: pq.ParquetWriter | None = None
    try:
        for group in combine_batches(merged, GROUP_ROWS):
            if writer is None:
                path = tables.folder.absolute() / SPOOL / f"features.parquet{OPEN}"
                path.unlink(missing_ok=True)
                writer = open_parquet(path, schema)
            rows += group.num_rows
            writer.write_table(group.combine_chunks().cast(writer.schema), row_group_size=GROUP_ROWS)
    finally:
        if writer is not None:
            writer.close()
    return {"features": rows} if rows else {}
