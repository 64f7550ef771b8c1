"""Reading of a run's tables: from its Parquet files, or from the closed parts and the spool of a run in progress."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from skyrange.core.errors import InputError
from skyrange.record.part_files import SpoolFile, spool_files, table_files
from skyrange.record.read.payload_window import PayloadWindow
from skyrange.record.schema import NAME, TEXT, Column, arrow_schema, columns_of, truth_columns
from skyrange.record.spool import read_stream

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
    """The recorded tables of one run, read from its closed parts and its spool if `spooled`, else from its Parquet
    files.

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
            for path in self._parquet(name):
                return self._parquet_schema(path)
        elif name == "truth":
            for file in spool_files(self.folder.absolute(), name):
                if file.closed:
                    return self._parquet_schema(file.path)
                try:
                    first = next(read_stream(file.path, trusted=self.trusted), None)
                except FileNotFoundError:
                    return self._parquet_schema(self._part_of(name, file).path)
                if first is not None:
                    return arrow_schema(name, truth_columns(first.schema.names[3:]))
        return arrow_schema(name)

    def _parquet_schema(self, path: Path) -> pa.Schema:
        with self._name_damaged_file(path):
            return _plain(pq.read_schema(path))

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
        found = self._recorded(name, schema, names) if self.spooled else self._written(name, schema, names)
        for batch in found:
            yield decode_spooled(batch, schema)

    def _written(self, name: str, schema: pa.Schema, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
        for path in self._parquet(name):
            yield from self._part(path, schema, names)

    def _part(self, path: Path, schema: pa.Schema, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
        with self._name_damaged_file(path), pq.ParquetFile(path, read_dictionary=list(names)) as file:
            yield from file.iter_batches(batch_size=BATCH_ROWS, columns=schema.names)

    def _recorded(self, name: str, schema: pa.Schema, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
        """The rows of a run in progress: those that were there when reading began, and what the last segment got since.

        A segment whose part is closed while it is waited for is read from that part.
        """
        read = 0  # rows of segments, which follow the closed parts
        last = -1
        for file in spool_files(self.folder.absolute(), name):
            if file.closed:
                yield from self._part(file.path, schema, names)
            elif file.number > last:
                try:
                    for batch in read_stream(file.path, trusted=self.trusted):
                        read += batch.num_rows
                        yield batch
                except FileNotFoundError:
                    part = self._part_of(name, file)
                    yield from _skip(self._part(part.path, schema, names), read)
                    read, last = 0, part.number

    def _part_of(self, name: str, segment: SpoolFile) -> SpoolFile:
        """The closed part that has replaced a segment of the spool."""
        for part in spool_files(self.folder.absolute(), name):
            if part.closed and part.number >= segment.number:
                return part
        hint = "The run has ended meanwhile: read it again."
        raise InputError.one(str(self.folder), segment.path.name, "missing", "the stream of a run in progress", hint)

    def table(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """The whole table, in memory."""
        schema = self.schema(name)
        if columns is not None:
            schema = pa.schema([schema.field(column) for column in columns], metadata=schema.metadata)
        return pa.Table.from_batches(self.batches(name, columns), schema=schema)

    def file(self, name: str, schema: pa.Schema) -> pa.Table:
        """A whole Parquet file of the folder, in one piece or in parts, with its own columns and names as plain
        strings; without rows and of `schema` if there is none.
        """
        paths = table_files((self.folder / name).absolute())
        if not paths:
            return schema.empty_table()
        tables = []
        for path in paths:
            with self._name_damaged_file(path), pq.ParquetFile(path) as file:
                table = file.read()
                tables.append(table.cast(_plain(table.schema)))
        return pa.concat_tables(tables)

    def file_rows(self, name: str) -> int:
        """Number of rows of a Parquet file of the folder; 0 if it is not there."""
        return sum(map(self._part_rows, table_files((self.folder / name).absolute())))

    def _part_rows(self, path: Path) -> int:
        with self._name_damaged_file(path):
            return int(pq.read_metadata(path).num_rows)

    def rows(self, name: str) -> int:
        """Number of rows of the table."""
        if not self.spooled:
            return self.file_rows(f"{name}.parquet")
        first = [field.name for field in arrow_schema(name)][:1]
        return sum(batch.num_rows for batch in self.batches(name, first))

    def frames_with_payloads(
        self, columns: Sequence[str] | None = None, *, encoded: bool = False
    ) -> Iterator[pa.Table]:
        """Batches of frames in the order recorded, with the additional column `payload`; `encoded` as in `batches`.

        Memory holds at most two windows of payloads. If payloads are missing, because the file system lost data, the
        frames end with the last one before the gap.
        """
        wanted = None if columns is None else list(dict.fromkeys([*columns, "payload_id"]))
        stored, window = self.batches("payloads"), PayloadWindow()
        for batch in self.batches("frames", wanted, encoded=encoded):
            ids = batch.column("payload_id").to_numpy()
            newest = int(ids.max(initial=-1))
            while window.newest < newest and (more := next(stored, None)) is not None:
                window.add(more)
            payloads = window.take(ids)
            window.drop_before_window(newest)
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
            where = str(path.relative_to(self.folder.absolute()))
            raise InputError.one(str(self.folder), where, reason, "a complete Parquet file") from error

    def _parquet(self, name: str) -> list[Path]:
        # absolute, because Arrow reads a relative name with a colon as a URI
        return table_files((self.folder / f"{name}.parquet").absolute())


def _skip(batches: Iterator[pa.RecordBatch], rows: int) -> Iterator[pa.RecordBatch]:
    """The batches without the first `rows` rows."""
    for batch in batches:
        if batch.num_rows > rows:
            yield batch.slice(rows)
        rows = max(rows - batch.num_rows, 0)


def combine_batches(batches: Iterable[pa.RecordBatch], rows: int) -> Iterator[pa.Table]:
    """Batches combined into tables of exactly `rows` rows; the last may have fewer."""
    held: list[pa.RecordBatch] = []
    count = 0
    for batch in batches:
        while count + batch.num_rows >= rows:
            yield pa.Table.from_batches([*held, batch.slice(0, rows - count)])
            batch, held, count = batch.slice(rows - count), [], 0
        if batch.num_rows:
            held.append(batch)
            count += batch.num_rows
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
