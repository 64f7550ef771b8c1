"""Spool of a run in progress, and the names of the files that hold a table.

In the spool each table is an Arrow IPC stream in `.spool/`. Whole batches are appended without buffering in the
process, so a killed process loses only rows that it had not written yet. The reader ignores an incomplete last batch.
When a run is forked, or a part of a table is complete, the stream continues in a new segment: `frames-0000.arrows`,
`frames-0001.arrows`, …. Segments whose rows are in a closed part are deleted.

A table that is complete is one Parquet file or a folder of part files.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import pyarrow as pa

from skyrange.core.errors import ComponentError

SPOOL = ".spool"
"""The folder for the streams within a run's folder."""

_OPTIONS = {"compression": "lz4", "emit_dictionary_deltas": True}


def write_error(path: Path, error: OSError | pa.ArrowException) -> ComponentError:
    """The error for a record that cannot be continued; it names the file and the reason."""
    name = errno.errorcode.get(getattr(error, "errno", None) or 0, "")
    reason = (getattr(error, "strerror", None) or str(error)).splitlines()[0]
    return ComponentError(
        "recorder",
        f"cannot write {path}: {reason}" + (f" ({name})" if name else ""),
        "Everything recorded before is kept and can be loaded; free some space or record elsewhere",
    )


class _Bytes:
    """A sink for the IPC writer that collects its output until it is taken."""

    closed = False

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._position = 0

    def write(self, data: bytes) -> int:
        part = bytes(data)
        self._parts.append(part)
        self._position += len(part)
        return len(part)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Do nothing; `take` returns the data."""

    def close(self) -> None:
        """Do nothing."""

    def take(self) -> bytes:
        whole = b"".join(self._parts)
        self._parts.clear()
        return whole


class _Stream:
    """One table's segment, open for appending."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self.path = path
        self._sink = _Bytes()
        self._file = path.open("xb", buffering=0)
        self._writer = pa.ipc.new_stream(pa.PythonFile(self._sink, mode="w"), schema, options=_options())

    def append(self, batch: pa.RecordBatch) -> int:
        """Write a whole batch to the operating system; returns its size in bytes."""
        self._writer.write_batch(batch)
        return self._write_out()

    def close(self) -> None:
        """Write the end-of-stream marker and close the file."""
        try:
            self._writer.close()
            self._write_out()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file without an end-of-stream marker."""
        self._file.close()

    def _write_out(self) -> int:
        data = self._sink.take()
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
        return len(data)


def _close(stream: _Stream) -> None:
    try:
        stream.close()
    except OSError as error:
        raise write_error(stream.path, error) from error


def _options() -> pa.ipc.IpcWriteOptions:
    return pa.ipc.IpcWriteOptions(**_OPTIONS)


class Spool:
    """The streams of one run; each is opened with its first rows."""

    def __init__(self, folder: Path, segment: int = 0) -> None:
        """`folder` is the run's, created by `folder.make_folder`; `segment` numbers the files written."""
        self.folder = folder
        self.segment = segment
        self.size_bytes = 0
        self._streams: dict[str, _Stream] = {}

    def append(self, table: str, batch: pa.RecordBatch) -> None:
        """Append rows to `table`; raises `ComponentError` and closes the spool if writing fails."""
        path = self.folder / SPOOL / f"{table}-{self.segment:04d}.arrows"
        try:
            stream = self._streams.get(table)
            if stream is None:
                stream = self._streams[table] = _Stream(path, batch.schema)
            self.size_bytes += stream.append(batch)
        except OSError as error:
            for stream in self._streams.values():
                stream.abandon()
            self._streams.clear()
            raise write_error(path, error) from error

    def end_segment(self) -> None:
        """Close all streams; later rows go to new files. Raises `ComponentError` if writing fails."""
        streams, self._streams = self._streams, {}
        self.segment += 1
        for stream in streams.values():
            _close(stream)

    def end_stream(self, table: str) -> int:
        """Close the stream of one table; its later rows go to a new file. Returns the number of the closed segment,
        which is greater than those of all earlier ones. Raises `ComponentError` if writing fails.
        """
        stream = self._streams.pop(table, None)
        self.segment += 1
        if stream is not None:
            _close(stream)
        return self.segment - 1


def read_stream(path: Path, *, trusted: bool = False) -> Iterator[pa.RecordBatch]:
    """The complete batches of a stream; ends silently at an incomplete one, left by a crash or still being written.

    Unless it is `trusted`, damage that leaves a batch complete is looked for too, nearly as long as reading takes.
    """
    with pa.OSFile(str(path)) as source:
        try:
            reader = pa.ipc.open_stream(source)
        except (pa.ArrowException, OSError):
            return
        while True:
            try:
                batch = reader.read_next_batch()
                if not trusted:
                    batch.validate(full=True)
            except (StopIteration, pa.ArrowException, OSError):
                return
            yield batch


def read_spool(folder: Path, table: str, *, trusted: bool = False) -> Iterator[pa.RecordBatch]:
    """All batches of a table in a run's spool, in the order recorded; `trusted` as in `read_stream`."""
    for path in sorted((folder / SPOOL).glob(f"{table}-*.arrows")):
        yield from read_stream(path, trusted=trusted)


OPEN: Final = ".new"
"""Suffix of a Parquet file that is still being written, in the spool's folder."""

_NUMBERED: Final = re.compile(r"-(\d{4,})\.(arrows|parquet)$")
_SHARD: Final = "core-{}"
"""Folder, in the spool's folder, of the shard that a process other than the first records, and prefix of its parts."""


def table_files(path: Path) -> list[Path]:
    """The Parquet files of the table `path`, such as `frames.parquet`: the file itself, or if it is a folder, its parts
    in order; none if it does not exist.
    """
    return [part for shard in table_shards(path) for part in shard]


def table_shards(path: Path) -> list[list[Path]]:
    """The files of a table, as `table_files` has them, for each process that recorded some."""
    if not os.path.isdir(path):  # false, as below, for a name that no file can have
        return [[path]] if os.path.exists(path) else []
    prefixes = {part.name.rpartition("-")[0] for part in path.glob("*.parquet")}
    shards = (_numbered(path, f"{prefix}-*.parquet") for prefix in sorted(prefixes, key=_shard_number))
    return [[part for _, part in sorted(parts.items())] for parts in shards if parts]


def part_path(path: Path, number: int, count: int, shard: int = 0) -> Path:
    """Where part `number` of a shard of the table `path` belongs; a table of `count` 1 part is one file."""
    prefix = _SHARD.format(shard) if shard else "part"
    return path if count == 1 else path / f"{prefix}-{number:04d}.parquet"


def shard_folder(folder: Path, shard: int) -> Path:
    """The folder of a shard of the run in `folder`, with a spool of its own; that of the first is the run's."""
    return folder / SPOOL / _SHARD.format(shard) if shard else folder


def shard_folders(folder: Path) -> list[Path]:
    """The folders of all shards of a run in progress, in the order of their numbers."""
    others = (folder / SPOOL).glob(_SHARD.format("*"))
    return [
        folder,
        *sorted(
            (candidate for candidate in others if candidate.is_dir()),
            key=lambda candidate: _shard_number(candidate.name),
        ),
    ]


def _shard_number(name: str) -> int:
    number = name.rpartition("-")[2]
    return int(number) if number.isdecimal() else 0


def closed_part_path(folder: Path, table: str, segment: int) -> Path:
    """The closed part that replaces the segments of a table's spool up to `segment`."""
    return folder / SPOOL / f"{table}-{segment:04d}.parquet"


class SpoolFile(NamedTuple):
    """A closed part, or a segment of the spool."""

    number: int
    """Of a segment its number, of a part that of the last segment that it replaces."""
    path: Path
    closed: bool


def spool_files(folder: Path, table: str) -> list[SpoolFile]:
    """The files of a table of a run in progress in `folder`, in the order of their rows.

    Segments that a closed part replaces are left out, if they have not been deleted yet.
    """
    # segments first: one that is replaced meanwhile is then found as a part
    segments = _numbered(folder / SPOOL, f"{table}-*.arrows")
    parts = _numbered(folder / SPOOL, f"{table}-*.parquet")
    last = max(parts, default=-1)
    return [SpoolFile(number, path, closed=True) for number, path in sorted(parts.items())] + [
        SpoolFile(number, path, closed=False) for number, path in sorted(segments.items()) if number > last
    ]


def _numbered(folder: Path, pattern: str) -> dict[int, Path]:
    matches = ((path, _NUMBERED.search(path.name)) for path in folder.glob(pattern))
    return {int(match[1]): path for path, match in matches if match}
