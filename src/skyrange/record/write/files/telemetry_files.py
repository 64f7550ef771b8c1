"""Parquet files of telemetry: one for each MAVLink message that a ground station received."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.record.dictionaries import unify_dictionaries
from skyrange.record.read.station_frames import StationFrames
from skyrange.record.read.tables import parquet_options
from skyrange.record.read.telemetry import encoded_message_schema, received_messages
from skyrange.record.write.files.table_files import GROUP_ROWS

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
            schema, path = encoded_message_schema(message), self._folder / f"{message}.parquet"
            writer = self._open_files.enter_context(pq.ParquetWriter(path, schema, **parquet_options(schema)))
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
