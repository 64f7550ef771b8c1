"""Parquet files of recorded tables, written row group by row group and under a temporary name until they are whole."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.record.dictionaries import unify_dictionaries
from skyrange.record.file_hashes import describe_file
from skyrange.record.part_files import OPEN, closed_part_path, spool_files
from skyrange.record.read.tables import decode_spooled, encoded_schema, parquet_options
from skyrange.record.schema import arrow_schema, truth_columns
from skyrange.record.spool import SPOOL

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
        return pq.ParquetWriter(path, encoded_schema(schema), **parquet_options(schema))

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
            seen = column.indices.drop_null().to_numpy(zero_copy_only=False)
            used = np.flatnonzero(np.bincount(seen, minlength=len(column.dictionary))) if len(seen) else seen
            names = column.dictionary.take(pa.array(used))
            order = pa.compute.array_sort_indices(names).to_numpy()
            place = np.zeros(max(len(column.dictionary), 1), dtype=np.int32)
            place[used[order]] = np.arange(len(order), dtype=np.int32)
            mask = column.is_null().to_numpy(zero_copy_only=False) if column.null_count else None
            column = pa.DictionaryArray.from_arrays(pa.array(place[codes], mask=mask), names.take(pa.array(order)))
        columns.append(column)
    return pa.RecordBatch.from_arrays(columns, schema=batch.schema)
