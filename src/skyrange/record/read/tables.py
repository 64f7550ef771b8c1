"""Reading of a run's tables: from its Parquet files, or from the closed parts and the spool of a run in progress."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.parquet_files import check_columns, check_values, plain_schema, read_table
from skyrange.record.read.time_order import interleave, time_key
from skyrange.record.schema import (
    FULL,
    NAME,
    PAYLOAD_WINDOW,
    TEXT,
    Column,
    arrow_schema,
    columns_of,
    require_table,
    truth_columns,
)
from skyrange.record.spool import SPOOL, SpoolFile, read_stream, shard_folders, spool_files, table_files, table_shards


class PayloadWindow:
    """Payloads by id. Rows are added in ascending order of their ids, and dropped when no frame can refer to them."""

    def __init__(self) -> None:
        self.newest = -1
        """The greatest id so far."""
        self._held: list[pa.RecordBatch] = []
        self._table: pa.Table | None = None
        """What is held, in one piece; None when it has changed."""

    def add(self, batch: pa.RecordBatch) -> None:
        """Add rows of `payloads`."""
        if batch.num_rows:
            self._held.append(batch)
            self._table = None
            self.newest = int(batch.column("payload_id")[-1].as_py())

    def take(self, ids: NDArray[np.int64]) -> pa.Array:
        """The payloads of `ids` up to the first that is missing."""
        if not len(ids) or not self._held:
            return pa.array([], pa.binary())
        if self._table is None:
            self._table = pa.Table.from_batches(self._held).combine_chunks()
        known = self._table.column("payload_id").to_numpy()
        places = np.minimum(np.searchsorted(known, ids), len(known) - 1)
        missing = np.flatnonzero(known[places] != ids)
        places = places[: missing[0]] if len(missing) else places
        column = self._table.column("payload").take(pa.array(places))
        return column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column

    def drop_before_window(self, newest: int) -> None:
        """Drop the payloads of earlier windows than that of id `newest`, to which a frame has referred."""
        start = newest - newest % PAYLOAD_WINDOW  # later frames do not refer to earlier windows
        if self._held and self._held[0].column("payload_id")[-1].as_py() < start:
            self._held = [batch for batch in self._held if batch.column("payload_id")[-1].as_py() >= start]
            self._table = None


_SENT = "sent_ns"
_Shard = Path | list[Path]
"""What one process has recorded of a table: the folder of its shard, of a run in progress, or its files."""
_DICTIONARY = pa.dictionary(pa.int32(), pa.string())
BATCH_ROWS = 65_536
"""Number of rows read at once from a Parquet file."""


def decode_spooled(batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """A spooled batch in the form for readers: names as plain strings, parents' ids joined, metadata of the schema.

    Raises `KeyError` or an error of Arrow for a batch with other columns.
    """
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
    alone: bool = False
    """Whether to read the rows of one shard only, whose folder this is, of a run in progress."""
    level: str = FULL
    """The level at which the run was recorded; a table that it leaves out raises `InputError` when it is read."""

    def require(self, name: str) -> None:
        """Raise `InputError` if the run's level leaves out a table, or "telemetry"."""
        require_table(self.folder, self.level, name)

    def schema(self, name: str) -> pa.Schema:
        """The schema of a table in this run."""
        if not self.spooled:
            for path in self._parquet(name):
                return self._parquet_schema(name, path)
        elif name == "truth":
            for root, file in ((folder, file) for folder in self._roots() for file in spool_files(folder, name)):
                if file.closed:
                    return self._parquet_schema(name, file.path)
                try:
                    first = next(read_stream(file.path, trusted=self.trusted), None)
                except FileNotFoundError:
                    return self._parquet_schema(name, self._part_of(root, name, file).path)
                if first is not None:
                    return arrow_schema(name, truth_columns(first.schema.names[3:]))
        return arrow_schema(name)

    def _parquet_schema(self, name: str, path: Path) -> pa.Schema:
        """The schema of a file of a table, if it is as declared; truth may have more columns."""
        with self._name_damaged_file(path):
            schema = plain_schema(pq.read_schema(path))
        declared = arrow_schema(name, truth_columns(schema.names[3:]) if name == "truth" else None)
        check_columns(schema, declared, str(self.folder), self._name(path))
        return schema.remove_metadata().with_metadata(declared.metadata) if schema == declared else declared

    def batches(
        self, name: str, columns: Sequence[str] | None = None, *, encoded: bool = False
    ) -> Iterator[pa.RecordBatch]:
        """The rows in the order recorded, with all columns or with `columns` in that order; names are plain strings, or
        with `encoded` dictionaries. The rows of several shards are in order of time. Raises `InputError` for a column
        that the table does not have: what truth has is up to the world.
        """
        self.require(name)
        full_schema = self.schema(name)
        schema = self._select(name, full_schema, columns)
        shards, key = self._shards(name), time_key(full_schema)
        if len(shards) < 2 or key is None:
            for shard in shards:
                yield from self._decoded(shard, name, schema, encoded=encoded)
            return
        keyed = schema if key in schema.names else schema.append(full_schema.field(key))
        streams = [_tabled(self._decoded(shard, name, keyed, encoded=encoded)) for shard in shards]
        for table in interleave(streams, key):
            yield from table.select(schema.names).combine_chunks().to_batches()

    def _select(self, name: str, schema: pa.Schema, columns: Sequence[str] | None) -> pa.Schema:
        """The fields of some columns, in their order, or of all. Raises `InputError` for one that is not there."""
        if columns is None:
            return schema
        missing = next((column for column in columns if column not in schema.names), None)
        if missing is not None:
            expected = f"one of {', '.join(schema.names)}"
            raise InputError.one(str(self.folder), f"{name}: column", missing, expected)
        return pa.schema([schema.field(column) for column in columns], metadata=schema.metadata)

    def _roots(self) -> list[Path]:
        """The folders of the shards of a run in progress."""
        folder = self.folder.absolute()  # Arrow reads a relative name with a colon as a URI
        return [folder] if self.alone else shard_folders(folder)

    def _shards(self, name: str) -> Sequence[_Shard]:
        """What each process has recorded of a table."""
        return self._roots() if self.spooled else table_shards((self.folder / f"{name}.parquet").absolute())

    def _decoded(self, shard: _Shard, name: str, schema: pa.Schema, *, encoded: bool) -> Iterator[pa.RecordBatch]:
        names = names_of(schema) if encoded else []
        schema = encoded_schema(schema) if encoded else schema
        if isinstance(shard, Path):
            batches = self._recorded(shard, name, schema, names)
        else:
            batches = (batch for path in shard for batch in self._part(path, schema, names))
        where = f"{SPOOL}/{name}" if isinstance(shard, Path) and not self.trusted else None
        for batch in batches:
            yield decode_spooled(batch, schema) if where is None else self._decode_checked(batch, schema, where)

    def _decode_checked(self, batch: pa.RecordBatch, schema: pa.Schema, where: str) -> pa.RecordBatch:
        """The batch of another process, which may have damaged it. Raises `InputError` if it is not as declared."""
        try:
            decoded = decode_spooled(batch, schema)
        except (KeyError, pa.ArrowException, UnicodeDecodeError) as error:
            reason = f"no column {error}" if isinstance(error, KeyError) else str(error).splitlines()[0]
            hint = "The file was changed by hand or is damaged."
            raise InputError.one(str(self.folder), where, reason, "the columns of a run in progress", hint) from error
        check_values(decoded, schema, str(self.folder), where)
        return decoded

    def _part(self, path: Path, schema: pa.Schema, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
        who, where = str(self.folder), self._name(path)
        with self._name_damaged_file(path), pq.ParquetFile(path, read_dictionary=list(names)) as file:
            check_columns(file.schema_arrow, schema, who, where)
            groups = (file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups))
            rows = max(min(BATCH_ROWS, max(groups, default=0)), 1)  # groups of large rows are short
            for batch in file.iter_batches(batch_size=rows, columns=schema.names):
                batch.validate(full=True)
                check_values(batch, schema, who, where)
                yield batch

    def _recorded(self, root: Path, name: str, schema: pa.Schema, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
        """The rows of a shard of a run in progress: those that were there when reading began, and what the last segment
        got since.

        A segment whose part is closed while it is waited for is read from that part.
        """
        read = 0  # rows of segments, which follow the closed parts
        last = -1
        for file in spool_files(root, name):
            if file.closed:
                yield from self._part(file.path, schema, names)
            elif file.number > last:
                try:
                    for batch in read_stream(file.path, trusted=self.trusted):
                        read += batch.num_rows
                        yield batch
                except FileNotFoundError:
                    part = self._part_of(root, name, file)
                    yield from _skip(self._part(part.path, schema, names), read)
                    read, last = 0, part.number

    def _part_of(self, root: Path, name: str, segment: SpoolFile) -> SpoolFile:
        """The closed part that has replaced a segment of the spool."""
        for part in spool_files(root, name):
            if part.closed and part.number >= segment.number:
                return part
        hint = "The run has ended meanwhile: read it again."
        raise InputError.one(str(self.folder), segment.path.name, "missing", "the stream of a run in progress", hint)

    def table(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """The whole table, in memory."""
        self.require(name)
        schema = self._select(name, self.schema(name), columns)
        return pa.Table.from_batches(self.batches(name, columns), schema=schema)

    def file(self, name: str, schema: pa.Schema) -> pa.Table:
        """A whole Parquet file of the folder, in one piece or in parts, with its own columns and names as plain
        strings; without rows and of `schema` if there is none. The rows of several shards are in order of time.
        """
        shards = table_shards((self.folder / name).absolute())
        if not shards:
            return schema.empty_table()
        paths = [path for shard in shards for path in shard]
        tables = [read_table(path, str(self.folder), self._name(path), schema) for path in paths]
        joined = pa.concat_tables(tables)
        key = time_key(joined.schema)
        return joined if len(shards) == 1 or key is None else joined.sort_by([(key, "ascending")])

    def file_batches(self, name: str, schema: pa.Schema) -> Iterator[pa.RecordBatch]:
        """The rows of `file` in batches, in the order of its parts."""
        for path in table_files((self.folder / name).absolute()):
            for batch in self._part(path, schema, ()):
                yield from pa.Table.from_batches([batch]).cast(plain_schema(batch.schema)).to_batches()

    def file_rows(self, name: str) -> int:
        """Number of rows of a Parquet file of the folder; 0 if it is not there."""
        return sum(map(self._part_rows, table_files((self.folder / name).absolute())))

    def _part_rows(self, path: Path) -> int:
        with self._name_damaged_file(path):
            return int(pq.read_metadata(path).num_rows)

    def rows(self, name: str) -> int:
        """Number of rows of the table."""
        self.require(name)
        if not self.spooled:
            return self.file_rows(f"{name}.parquet")
        full_schema = arrow_schema(name)
        first = pa.schema([full_schema.field(0)], metadata=full_schema.metadata)
        shards = self._shards(name)
        return sum(batch.num_rows for shard in shards for batch in self._decoded(shard, name, first, encoded=False))

    def frames_with_payloads(
        self, columns: Sequence[str] | None = None, *, encoded: bool = False
    ) -> Iterator[pa.Table]:
        """Batches of frames in the order recorded, with the additional column `payload`; `encoded` as in `batches`.

        Memory holds at most two windows of payloads. If payloads are missing, because the file system lost data, the
        frames end with the last one before the gap.
        """
        self.require("frames")
        shards, payload_shards = self._shards("frames"), self._shards("payloads")
        if len(shards) < 2:
            for shard, stored in zip(shards, payload_shards, strict=False):
                yield from self._frames_of(shard, stored, columns, encoded=encoded)
            return
        keyed = None if columns is None else list(dict.fromkeys([*columns, _SENT]))
        streams = [
            self._frames_of(shard, stored, keyed, encoded=encoded)
            for shard, stored in zip(shards, payload_shards, strict=True)
        ]
        for table in interleave(streams, _SENT):
            yield table if columns is None else table.select([*columns, "payload"])

    def _frames_of(
        self, shard: _Shard, payload_shard: _Shard, columns: Sequence[str] | None, *, encoded: bool
    ) -> Iterator[pa.Table]:
        """The frames of one shard, whose payloads are in `payload_shard`."""
        wanted = None if columns is None else list(dict.fromkeys([*columns, "payload_id"]))
        schema = self._select("frames", self.schema("frames"), wanted)
        stored = self._decoded(payload_shard, "payloads", arrow_schema("payloads"), encoded=False)
        window = PayloadWindow()
        for batch in self._decoded(shard, "frames", schema, encoded=encoded):
            ids = batch.column("payload_id").to_numpy()
            newest = int(ids.max(initial=-1))
            while window.newest < newest and (more := next(stored, None)) is not None:
                window.add(more)
            payloads = window.take(ids)
            window.drop_before_window(newest)
            complete_rows = len(payloads)
            table = pa.Table.from_batches([batch]).slice(0, complete_rows)
            if columns is not None:
                table = table.select(list(columns))
            yield table.append_column(pa.field("payload", pa.binary()), payloads)
            if complete_rows < batch.num_rows:
                return

    @contextmanager
    def _name_damaged_file(self, path: Path) -> Iterator[None]:
        """Turn an error in reading a Parquet file into an `InputError` that names the file."""
        try:
            yield
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:  # the last: names of columns
            reason = str(error).splitlines()[0]
            raise InputError.one(str(self.folder), self._name(path), reason, "a complete Parquet file") from error

    def _name(self, path: Path) -> str:
        return str(path.relative_to(self.folder.absolute()))

    def _parquet(self, name: str) -> list[Path]:
        # absolute, because Arrow reads a relative name with a colon as a URI
        return table_files((self.folder / f"{name}.parquet").absolute())


def _tabled(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.Table]:
    return (pa.Table.from_batches([batch]) for batch in batches)


def _skip(batches: Iterator[pa.RecordBatch], rows: int) -> Iterator[pa.RecordBatch]:
    """The batches without the first `rows` rows."""
    for batch in batches:
        if batch.num_rows > rows:
            yield batch.slice(rows)
        rows = max(rows - batch.num_rows, 0)


def combine_batches(batches: Iterable[pa.RecordBatch], rows: int) -> Iterator[pa.Table]:
    """Batches combined into tables of exactly `rows` rows; the last may have fewer."""
    pending: list[pa.RecordBatch] = []
    count = 0
    for batch in batches:
        while count + batch.num_rows >= rows:
            yield pa.Table.from_batches([*pending, batch.slice(0, rows - count)])
            batch, pending, count = batch.slice(rows - count), [], 0
        if batch.num_rows:
            pending.append(batch)
            count += batch.num_rows
    if pending:
        yield pa.Table.from_batches(pending)


def names_of(schema: pa.Schema) -> list[str]:
    """The columns of a table that are names."""
    return [field.name for field in schema if _column(schema, field.name).type == NAME]


def encoded_schema(schema: pa.Schema) -> pa.Schema:
    """A schema with names as dictionaries."""
    names = names_of(schema)
    fields = [field.with_type(_DICTIONARY) if field.name in names else field for field in schema]
    return pa.schema(fields, metadata=schema.metadata)


def _column(schema: pa.Schema, name: str) -> Column:
    """The declaration of a column; a string column that is not declared counts as free text."""
    table = (schema.metadata or {}).get(b"skyrange.table", b"").decode(errors="replace")
    declared = {column.name: column for column in columns_of(table)}
    return declared.get(name, Column(name, TEXT, "", ""))
