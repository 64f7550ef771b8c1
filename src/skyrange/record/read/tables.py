"""Reading of a run's tables, from its spool or from its Parquet files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.record.schema import NAME, PAYLOAD_WINDOW, TEXT, Column, arrow_schema, columns_of, truth_columns
from skyrange.record.spool import read_spool

_DICTIONARY = pa.dictionary(pa.int32(), pa.string())
BATCH_ROWS = 65_536
"""Number of rows read at once from a Parquet file."""


def decode_spooled(batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """A spooled batch in the form for readers: names as plain strings, parents' ids joined, metadata of the schema."""
    spooled = batch.schema.names
    arrays = [
        _cast(batch.column(field.name), field.type) if field.name in spooled else _JOINED[field.name](batch)
        for field in schema
    ]
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def _cast(column: pa.Array, type_: pa.DataType) -> pa.Array:
    return column if column.type == type_ else column.cast(type_)


def _join_parent_ids(batch: pa.RecordBatch) -> pa.Array:
    """Ids in the text form of `FrameId`, which ends with the serial; null without a parent."""
    before = batch.column("parent_before").cast(pa.string())
    return pc.binary_join_element_wise(before, batch.column("parent_serial").cast(pa.string()), "")


_JOINED = {"parent": _join_parent_ids}
"""Columns that the spool stores in parts, because building a string per frame would cost more than the flight."""


@dataclass(frozen=True, slots=True)
class Tables:
    """The recorded tables of one run, read from its spool if `spooled`, else from its Parquet files.

    Telemetry and `observations` are not recorded but derived from other tables (`record.read.telemetry`,
    `record.read.observations`) and stored as Parquet.
    """

    folder: Path
    spooled: bool
    trusted: bool = False
    """Whether this process has written the spool itself, which is then not searched for damage."""

    def schema(self, name: str) -> pa.Schema:
        """The schema of a table in this run."""
        if not self.spooled:
            path = self._parquet(name)
            with self._name_damaged_file(path):
                return _plain(pq.read_schema(path)) if path.exists() else arrow_schema(name)
        if name == "truth":
            for batch in read_spool(self.folder, name, trusted=self.trusted):
                return arrow_schema(name, truth_columns(batch.schema.names[3:]))
        return arrow_schema(name)

    def batches(
        self, name: str, columns: Sequence[str] | None = None, *, encoded: bool = False
    ) -> Iterator[pa.RecordBatch]:
        """The rows in the order recorded, with all columns or with `columns` in that order; names are plain strings, or
        with `encoded` dictionaries.
        """
        schema = self.schema(name)
        if columns is not None:
            schema = pa.schema([schema.field(column) for column in columns], metadata=schema.metadata)
        names = names_of(schema) if encoded else []
        schema = encoded_schema(schema) if encoded else schema
        if self.spooled:
            for batch in read_spool(self.folder, name, trusted=self.trusted):
                yield decode_spooled(batch, schema)
            return
        path = self._parquet(name)
        if not path.exists():
            return
        with self._name_damaged_file(path), pq.ParquetFile(path, read_dictionary=names) as file:
            for batch in file.iter_batches(batch_size=BATCH_ROWS, columns=schema.names):
                yield decode_spooled(batch, schema)

    def table(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """The whole table, in memory."""
        schema = self.schema(name)
        if columns is not None:
            schema = pa.schema([schema.field(column) for column in columns], metadata=schema.metadata)
        return pa.Table.from_batches(self.batches(name, columns), schema=schema)

    def file(self, name: str, schema: pa.Schema) -> pa.Table:
        """A whole Parquet file of the folder, with its own columns and names as plain strings; without rows and of
        `schema` if there is none.
        """
        path = (self.folder / name).absolute()
        with self._name_damaged_file(path):
            if not path.exists():
                return schema.empty_table()
            table = pq.read_table(path)
            return table.cast(_plain(table.schema))

    def file_rows(self, name: str) -> int:
        """Number of rows of a Parquet file of the folder; 0 if it is not there."""
        path = (self.folder / name).absolute()
        with self._name_damaged_file(path):
            return int(pq.read_metadata(path).num_rows) if path.exists() else 0

    def rows(self, name: str) -> int:
        """Number of rows of the table."""
        if not self.spooled:
            return self.file_rows(f"{name}.parquet")
        return sum(batch.num_rows for batch in read_spool(self.folder, name, trusted=self.trusted))

    def frames_with_payloads(
        self, columns: Sequence[str] | None = None, *, encoded: bool = False
    ) -> Iterator[pa.Table]:
        """Batches of frames in the order recorded, with the additional column `payload`; `encoded` as in `batches`.

        Memory holds at most two windows of payloads. If payloads are missing, because the file system lost data, the
        frames end with the last one before the gap.
        """
        wanted = None if columns is None else list(dict.fromkeys([*columns, "payload_id"]))
        window = _PayloadWindow(self.batches("payloads"))
        for batch in self.batches("frames", wanted, encoded=encoded):
            payloads = window.take(batch.column("payload_id").to_numpy())
            whole = len(payloads)
            table = pa.Table.from_batches([batch]).slice(0, whole)
            if columns is not None:
                table = table.select(list(columns))
            yield table.append_column(pa.field("payload", pa.binary()), payloads)
            if whole < batch.num_rows:
                return

    @contextmanager
    def _name_damaged_file(self, path: Path) -> Iterator[None]:
        """Turn an error in reading a Parquet file into an `InputError` that names the file."""
        try:
            yield
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:  # the last: names of columns
            reason = str(error).splitlines()[0]
            raise InputError.one(str(self.folder), path.name, reason, "a complete Parquet file") from error

    def _parquet(self, name: str) -> Path:
        return (self.folder / f"{name}.parquet").absolute()  # Arrow reads a relative name with a colon as a URI


class _PayloadWindow:
    """The payloads that the frames being read may refer to; the window moves forward with the frames."""

    def __init__(self, batches: Iterator[pa.RecordBatch]) -> None:
        self._batches = batches
        self._held: list[pa.RecordBatch] = []
        self._table: pa.Table | None = None
        """What is held, in one piece; None when it has changed."""
        self._last = -1

    def take(self, ids: NDArray[np.int64]) -> pa.Array:
        """The payloads of `ids` up to the first that is missing."""
        if not len(ids):
            return pa.array([], pa.binary())
        newest = int(ids.max())
        while self._last < newest:
            batch = next(self._batches, None)
            if batch is None:
                break
            if batch.num_rows:
                self._held.append(batch)
                self._table = None
                self._last = int(batch.column("payload_id")[-1].as_py())
        if not self._held:
            return pa.array([], pa.binary())
        if self._table is None:
            self._table = pa.Table.from_batches(self._held).combine_chunks()
        held = self._table
        known = held.column("payload_id").to_numpy()
        places = np.minimum(np.searchsorted(known, ids), len(known) - 1)
        missing = np.flatnonzero(known[places] != ids)
        places = places[: missing[0]] if len(missing) else places
        start = newest - newest % PAYLOAD_WINDOW  # later frames do not refer to earlier windows
        if self._held[0].column("payload_id")[-1].as_py() < start:
            self._held = [batch for batch in self._held if batch.column("payload_id")[-1].as_py() >= start]
            self._table = None
        column = held.column("payload").take(pa.array(places))
        return column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column


def combine_batches(batches: Iterator[pa.RecordBatch], rows: int) -> Iterator[pa.Table]:
    """Batches combined into tables of at least `rows` rows; the last may have fewer."""
    held: list[pa.RecordBatch] = []
    count = 0
    for batch in batches:
        held.append(batch)
        count += batch.num_rows
        if count >= rows:
            yield pa.Table.from_batches(held)
            held, count = [], 0
    if held:
        yield pa.Table.from_batches(held)


def parquet_options(schema: pa.Schema) -> dict[str, object]:
    """Parquet options for a table: names dictionary-encoded, integers delta-encoded, floats split by byte position.

    Numbers have statistics, by which readers skip groups of rows; those of names would take longer than the names.
    """
    names = names_of(schema)
    layout: dict[str, str] = {}
    for field in schema:
        if pa.types.is_integer(field.type):
            layout[field.name] = "DELTA_BINARY_PACKED"
        elif pa.types.is_floating(field.type):
            layout[field.name] = "BYTE_STREAM_SPLIT"
        elif pa.types.is_binary(field.type):
            layout[field.name] = "DELTA_LENGTH_BYTE_ARRAY"
    return {
        "compression": "zstd",
        "compression_level": 3,
        "use_dictionary": names or False,
        "column_encoding": layout or None,
        "write_statistics": [name for name, kind in layout.items() if kind != "DELTA_LENGTH_BYTE_ARRAY"] or False,
    }


def names_of(schema: pa.Schema) -> list[str]:
    """The columns of a table that are names."""
    return [field.name for field in schema if _column(schema, field.name).type == NAME]


def _plain(schema: pa.Schema) -> pa.Schema:
    """A schema with plain strings instead of dictionaries."""
    fields = [field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field for field in schema]
    return pa.schema(fields, metadata=schema.metadata)


def encoded_schema(schema: pa.Schema) -> pa.Schema:
    """A schema with names as dictionaries."""
    names = names_of(schema)
    fields = [field.with_type(_DICTIONARY) if field.name in names else field for field in schema]
    return pa.schema(fields, metadata=schema.metadata)


def _column(schema: pa.Schema, name: str) -> Column:
    """The declaration of a column; a string column that is not declared counts as free text."""
    table = (schema.metadata or {}).get(b"skyrange.table", b"").decode()
    found = {column.name: column for column in columns_of(table)}
    return found.get(name, Column(name, TEXT, "", ""))
