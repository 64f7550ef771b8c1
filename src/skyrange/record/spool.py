"""Where do rows go while a run flies, and how are they read back if it never ended?

Each table is an Arrow IPC stream in `.spool/`, appended to in whole batches and never buffered in the
process, so that a killed process loses only what it had not handed over. A torn last batch is ignored by
the reader. Streams are cut into segments where a run forks: `frames-0000.arrows`, `frames-0001.arrows`, ….
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa

from skyrange.core.errors import ComponentError

SPOOL = ".spool"
"""The folder of a run that holds its streams."""

_OPTIONS = {"compression": "lz4", "emit_dictionary_deltas": True}


def cannot_write(path: Path, error: OSError | pa.ArrowException) -> ComponentError:
    """The error of a run whose record cannot go on: names the file, the reason and what is left."""
    name = errno.errorcode.get(getattr(error, "errno", None) or 0, "")
    reason = (getattr(error, "strerror", None) or str(error)).splitlines()[0]
    return ComponentError(
        "recorder",
        f"cannot write {path}: {reason}" + (f" ({name})" if name else ""),
        "What was recorded before is kept and can be loaded; free some space or record elsewhere",
    )


class _Bytes:
    """A sink that keeps what the IPC writer says since it was last emptied."""

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
        """Nothing to do: `take` hands over."""

    def close(self) -> None:
        """Nothing to do."""

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
        """Hand a batch to the operating system whole; returns its size in bytes."""
        self._writer.write_batch(batch)
        return self._hand_over()

    def close(self) -> None:
        """Write the end-of-stream mark and close."""
        try:
            self._writer.close()
            self._hand_over()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._file.close()

    def _hand_over(self) -> int:
        data = self._sink.take()
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
        return len(data)


def _options() -> pa.ipc.IpcWriteOptions:
    return pa.ipc.IpcWriteOptions(**_OPTIONS)


class Spool:
    """The streams of one run, opened as their first rows come."""

    def __init__(self, folder: Path, segment: int = 0) -> None:
        """`folder` is the run's, made by `folder.make_folder`; `segment` numbers the files that this object writes."""
        self.folder = folder
        self.segment = segment
        self.size_bytes = 0
        self._streams: dict[str, _Stream] = {}

    def append(self, table: str, batch: pa.RecordBatch) -> None:
        """Append rows to `table`; `ComponentError` where the disk refuses, after which the spool is closed."""
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
            raise cannot_write(path, error) from error

    def end_segment(self) -> None:
        """Close all streams; rows to come go into new files. `ComponentError` where the disk refuses."""
        streams, self._streams = self._streams, {}
        self.segment += 1
        for stream in streams.values():
            try:
                stream.close()
            except OSError as error:
                raise cannot_write(stream.path, error) from error


def read_stream(path: Path) -> Iterator[pa.RecordBatch]:
    """The whole batches at the start of a stream; ends silently where it is torn or still being written."""
    with pa.OSFile(str(path)) as source:
        try:
            reader = pa.ipc.open_stream(source)
        except (pa.ArrowException, OSError):
            return
        while True:
            try:
                batch = reader.read_next_batch()
                batch.validate(full=True)
            except (StopIteration, pa.ArrowException, OSError):
                return
            yield batch


def read_spool(folder: Path, table: str) -> Iterator[pa.RecordBatch]:
    """All of a table's batches in a run's spool, in the order in which they were recorded."""
    for path in sorted((folder / SPOOL).glob(f"{table}-*.arrows")):
        yield from read_stream(path)
