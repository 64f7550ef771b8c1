"""Reading of a run in progress as it grows: the rows that were recorded since they were last asked for.

A run's recorders are those of its shards, and of the nodes of a live range. Each table is read where it is: in the
closed parts of the spool, then in its segments, of which an open file stays readable when it is deleted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.record.folder import PARTS
from skyrange.record.spool import SPOOL, SpoolFile, shard_folders, spool_files

_READ_FIRST: Final = ("truth", "receptions", "frames")
"""Rows of a table may name those of later ones, which were recorded before: so these are looked at later."""
_HANDED_FIRST: Final = ("payloads", "frames", "receptions")
_OTHERS: Final = ("events", "decisions", "labels", "alerts")
TABLES: Final = (*dict.fromkeys((*_READ_FIRST, *_HANDED_FIRST, *_OTHERS)),)
"""The tables that are read, in the order in which they are looked at."""


class _Window:
    """A file for Arrow's reader, with the bytes that it may read."""

    closed = False

    def __init__(self) -> None:
        self._data = memoryview(b"")

    def put(self, data: bytes) -> None:
        self._data = memoryview(bytes(self._data) + data)

    def read(self, size: int = -1) -> bytes:
        size = len(self._data) if size < 0 else size
        taken, self._data = self._data[:size], self._data[size:]
        return bytes(taken)

    def close(self) -> None:
        """Do nothing."""


class GrowingSegment:
    """An Arrow IPC stream that is being written, read as far as its batches are complete."""

    def __init__(self, path: Path) -> None:
        """Raises `FileNotFoundError` for a segment that has become a closed part."""
        self._file: BinaryIO = path.open("rb")
        self._tail = b""
        self._window = _Window()
        self._reader: Any = None
        self.ended = False
        """Whether the stream's end was read."""

    def read(self) -> list[pa.RecordBatch]:
        """The batches that were completed since the last call; what is damaged ends the stream."""
        self._tail += self._file.read()
        source = pa.BufferReader(self._tail)
        whole, batches = 0, 0
        while not self.ended:
            try:
                message = pa.ipc.read_message(source)
            except EOFError:  # the marker of a stream's end, or no more bytes
                self.ended = source.tell() > whole
                break
            except (pa.ArrowException, OSError):  # is not whole yet
                break
            whole = source.tell()
            batches += message.type == "record batch"
        self._window.put(self._tail[:whole])
        self._tail = self._tail[whole:]
        found: list[pa.RecordBatch] = []
        try:
            if self._reader is None and whole:
                self._reader = pa.ipc.open_stream(pa.PythonFile(self._window, mode="r"))
                _ = self._reader.schema.names  # which may be no text
            for _ in range(batches):
                batch = self._reader.read_next_batch()
                batch.validate(full=True)
                found.append(batch)
        except (pa.ArrowException, OSError, StopIteration, UnicodeDecodeError):
            self.ended = True
        return found

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class GrowingTable:
    """One table of one recorder."""

    def __init__(self, root: Path, table: str) -> None:
        self._root, self._table = root, table
        self._segment: GrowingSegment | None = None
        self._number = -1
        """Of the file that is read, or was read last."""
        self._rows: list[tuple[int, int]] = []
        """Number and rows of the segments that were read."""

    def read(self) -> Iterator[pa.RecordBatch]:
        """The rows that were recorded since the last call."""
        while True:
            if self._segment is not None:
                for batch in self._segment.read():
                    self._rows[-1] = (self._number, self._rows[-1][1] + batch.num_rows)
                    yield batch
                if not self._segment.ended:
                    return
                self._segment.close()
                self._segment = None
            file = next((file for file in self._files() if file.number > self._number), None)
            if file is None:
                return
            if file.closed:
                yield from self._read_part(file)
                continue
            try:
                self._segment = GrowingSegment(file.path)
            except FileNotFoundError:
                continue  # it is a closed part now
            self._number = file.number
            self._rows.append((file.number, 0))

    def _files(self) -> Sequence[SpoolFile]:
        return spool_files(self._root, self._table)

    def _read_part(self, part: SpoolFile) -> Iterator[pa.RecordBatch]:
        """The rows of a part but for those that were read of the segments that it replaces."""
        before = max((file.number for file in self._files() if file.closed and file.number < part.number), default=-1)
        read = sum(rows for number, rows in self._rows if before < number <= part.number)
        self._number = part.number
        with pq.ParquetFile(part.path) as file:
            for batch in file.iter_batches():
                skipped = min(read, batch.num_rows)
                read -= skipped
                if skipped < batch.num_rows:
                    yield batch.slice(skipped)


class GrowingRun:
    """All recorders of a run in progress."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.absolute()
        self._recorders: dict[Path, tuple[int, dict[str, GrowingTable]]] = {}
        """Number and tables by folder."""
        self._is_live = False

    def read(self, add: Callable[[str, pa.RecordBatch, int], None]) -> int:
        """Hand over the rows that were recorded since the last call, with their table and the number of their recorder,
        as `RowReader.add` has them; returns how many.
        """
        count = 0
        for root in self._find_roots():
            tables = {table: GrowingTable(root, table) for table in TABLES}
            self._recorders.setdefault(root, (len(self._recorders), tables))
        for number, tables in self._recorders.values():  # also those whose folder is gone: their files are open
            found = {table: list(tables[table].read()) for table in TABLES}
            for table in dict.fromkeys((*_HANDED_FIRST, *TABLES)):
                for batch in found[table]:
                    add(table, batch, number)
                    count += batch.num_rows
        return count

    def _find_roots(self) -> list[Path]:
        """The folders of the recorders. Those of a live range's nodes are merged into the run's own at its end."""
        nodes = sorted(path.parent for path in (self._folder / PARTS).glob(f"*/{SPOOL}"))
        if nodes and not self._is_live:
            self._is_live = True
            self._recorders.clear()
        return nodes if self._is_live else shard_folders(self._folder)
