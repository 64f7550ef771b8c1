"""Conversion of recorded rows to Parquet while the run flies: row groups for a thread, and parts of a fixed length.

Rows are cut by their number alone, so files do not depend on the wall clock or on the thread. What is not yet in a
closed part is in the spool.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from skyrange.record.manifest import origin_of, start_unix_ns_of
from skyrange.record.read.tables import Tables
from skyrange.record.schema import FULL, OPTIONAL, RECORDED, TABLES, level_of
from skyrange.record.spool import OPEN, Spool, read_stream, spool_files, write_error
from skyrange.record.write.files.derivation import Derivation
from skyrange.record.write.files.row_groups import GROUP_BYTES, PART_BYTES, count_bytes, cut_groups, split_batch
from skyrange.record.write.files.table_files import GROUP_ROWS, WIDE_GROUP_ROWS, TableFiles, write_features

PENDING: Final = 2
"""Calls that may wait or be under way; a further one waits for the first."""

_NICENESS: Final = 10


def _yield_to_simulation() -> None:
    """Let this thread run while the simulation waits, for another core or for this thread, rather than in its place."""
    if sys.platform == "linux":  # elsewhere a priority is the whole process's (setpriority(2), "C library differences")
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)


class Background:
    """Calls functions one after the other in a thread of its own, which starts with the first one.

    After an exception, later calls are dropped, and `submit` and `wait` raise it.
    """

    def __init__(self) -> None:
        self._executor: ThreadPoolExecutor | None = None
        self._pending: deque[Future[None]] = deque()
        self._error: BaseException | None = None

    @property
    def is_used(self) -> bool:
        """Whether anything was submitted."""
        return self._executor is not None

    def submit(self, call: Callable[[], object]) -> None:
        """Call a function later, after all earlier ones."""
        if self._executor is None:
            self._executor = ThreadPoolExecutor(1, "recorder", initializer=_yield_to_simulation)
        while len(self._pending) >= PENDING or (self._pending and self._pending[0].done()):
            self._pending.popleft().result()
        self._raise()
        self._pending.append(self._executor.submit(self._do, call))

    def _do(self, call: Callable[[], object]) -> None:
        if self._error is None:
            try:
                call()
            except BaseException as error:  # pa.ArrowException is no OSError; the simulation's thread raises it
                self._error = error

    def wait(self) -> None:
        """Wait until everything is done."""
        while self._pending:
            self._pending.popleft().result()
        self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """Drop what has not begun, wait for the rest, and end the thread."""
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)
            self._pending.clear()


PART_ROWS: Final = 1 << 21
"""Rows of a part, of every table; a multiple of the rows of a group."""


class PartWriter:
    """Writes the rows of a run to its spool, and from memory to Parquet, a row group at a time.

    Memory holds up to a row group of each table and those that wait for the thread. Methods raise `ComponentError` if
    writing fails, then or earlier in the thread; all rows that were added before are then in the spool and in closed
    parts.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, Any], spool: Spool, part_rows: int = PART_ROWS) -> None:
        """`folder` is the run's, with its `spool`; `manifest` says where its origin is, when it starts, and which
        tables it keeps.
        """
        self._folder = folder
        self._level = level_of(manifest)
        self._manifest = manifest
        self._spool = spool
        self._part_rows = part_rows
        self._files = TableFiles(folder)
        self._derivation = Derivation(folder, origin_of(manifest), start_unix_ns_of(manifest))
        """Derived tables; the thread uses it, except for its flags."""
        self._background = Background()
        self._rows: dict[str, int] = {}  # of the open part
        self._part_bytes: dict[str, int] = {}  # of the open part, of tables with large rows
        self._held: dict[str, list[pa.RecordBatch]] = {}  # less than a group
        self._held_rows: dict[str, int] = {}
        self._held_bytes: dict[str, int] = {}
        self._new_payloads: list[pa.RecordBatch] = []  # since the last group of frames
        self._new_receptions: list[pa.RecordBatch] = []
        self._foreign: list[pa.Table] = []

    def append(self, table: str, batch: pa.RecordBatch) -> None:
        """Append rows of a table."""
        while batch.num_rows:
            room, room_bytes = self._part_rows - self._rows.get(table, 0), PART_BYTES - self._part_bytes.get(table, 0)
            piece, used, is_full = split_batch(table, batch, room, room_bytes)
            batch = batch.slice(piece.num_rows)
            self._spool.append(table, piece)
            self._hold(table, piece, used)
            if is_full:
                self._end_part(table)

    def _group_rows(self, table: str) -> int:
        return min(WIDE_GROUP_ROWS if table == "observations" else GROUP_ROWS, self._part_rows)

    def _hold(self, table: str, batch: pa.RecordBatch, used: int) -> None:
        self._rows[table] = self._rows.get(table, 0) + batch.num_rows
        self._part_bytes[table] = self._part_bytes.get(table, 0) + used
        if table == "payloads":
            self._new_payloads.append(batch)
        elif table == "receptions":
            self._new_receptions.append(batch)
        self._held.setdefault(table, []).append(batch)
        self._held_rows[table] = self._held_rows.get(table, 0) + batch.num_rows
        self._held_bytes[table] = self._held_bytes.get(table, 0) + used
        if self._held_rows[table] >= self._group_rows(table) or self._held_bytes[table] >= GROUP_BYTES:
            self._write_groups(table, last=False)

    def _write_groups(self, table: str, *, last: bool) -> None:
        groups = list(cut_groups(table, self._held.pop(table, []), self._group_rows(table)))
        self._held_rows[table] = self._held_bytes[table] = 0
        for group, used, is_whole in groups:
            if is_whole or last:
                self._write_group(table, group)
            else:
                self._held[table], self._held_rows[table] = group.to_batches(), group.num_rows
                self._held_bytes[table] = used

    def _write_group(self, table: str, group: pa.Table) -> None:
        self._submit(partial(self._files.write, table, group))
        if table == "frames":
            self._derive(group)

    def _derive(self, frames: pa.Table | None) -> None:
        payloads, self._new_payloads = self._new_payloads, []
        receptions, self._new_receptions = self._new_receptions, []
        foreign, self._foreign = self._foreign, []
        self._submit(partial(self._derivation.add, frames, payloads, receptions, foreign))

    def add_foreign(self, frames: pa.Table) -> None:
        """Add transmissions that another shard records, with their payloads: receptions of this one may name them."""
        self._foreign.append(frames)

    def _end_part(self, table: str) -> None:
        self._write_groups(table, last=True)
        self._submit(partial(self._files.close_part, table, self._spool.end_stream(table)))
        self._rows[table] = self._part_bytes[table] = 0

    def _submit(self, call: Callable[[], None]) -> None:
        try:
            self._background.submit(call)
        except (OSError, pa.ArrowException) as error:
            raise write_error(self._folder, error) from error

    # ---------------------------------------------------------------- the end

    @property
    def described(self) -> Mapping[Path, dict[str, Any]]:
        """Size and hash of each closed part that this writer wrote, after `finish`."""
        return self._files.described

    def finish(self) -> tuple[dict[str, int] | None, dict[str, int]]:
        """Close all parts, also of tables without rows, and the derived tables; returns how many rows each message and
        each derived table have. There are no messages if no frames are kept.
        """
        for table in list(self._held):
            self._write_groups(table, last=True)
        if self._level == FULL:
            self._derive(None)
        for table in TABLES:
            if table in RECORDED[self._level] and self._is_due(table):
                self._submit(partial(self._files.close_part, table, self._spool.end_stream(table)))
        try:
            self._background.wait()
            self._background.stop()
            tables = Tables(self._folder, spooled=True, trusted=True, alone=True)
            if self._level != FULL:
                return None, write_features(tables)
            messages, observed = self._derivation.finish(tables)
            return messages, {"observations": observed} if observed else {}
        except (OSError, pa.ArrowException) as error:
            raise write_error(self._folder, error) from error

    def _is_due(self, table: str) -> bool:
        """Whether a part of a table is to be closed at the end; a table has one, but alerts without detectors none."""
        if self._rows.get(table):
            return True
        has_rows = table in self._rows or self._files.has_part(table)
        return not has_rows and is_expected(table, self._manifest)

    def abandon(self) -> None:
        """Delete everything that is not whole; the rows stay in the spool and in closed parts."""
        self._background.stop()
        self._files.abandon()
        self._derivation.abandon()

    # ---------------------------------------------------------------- forks

    def wait(self) -> None:
        """Wait until the thread is idle."""
        try:
            self._background.wait()
        except (OSError, pa.ArrowException) as error:
            raise write_error(self._folder, error) from error

    def fork(self, folder: Path, manifest: Mapping[str, Any], spool: Spool) -> PartWriter:
        """A writer that continues in a copy of the folder, made while the thread was idle."""
        twin = PartWriter(folder, manifest, spool, self._part_rows)
        if not self._background.is_used:
            twin._rows, twin._part_bytes = dict(self._rows), dict(self._part_bytes)
            twin._held = {table: list(batches) for table, batches in self._held.items()}
            twin._held_rows, twin._held_bytes = dict(self._held_rows), dict(self._held_bytes)
            twin._new_payloads, twin._new_receptions = list(self._new_payloads), list(self._new_receptions)
        else:
            twin.read_spool()
        return twin

    def observe_at_end(self) -> None:
        """Derive observations at the end, because receptions are not recorded near their frames."""
        self._derivation.observes = False

    def read_spool(self) -> None:
        """Take the rows of the spool that are in no closed part; derived tables are then derived at the end."""
        self._derivation.is_whole = False
        for table in TABLES:
            for batch in _open_rows(self._folder, table):
                sizes = count_bytes(table, batch)
                self._hold(table, batch, 0 if sizes is None else int(sizes.sum()))
        self._new_payloads, self._new_receptions = [], []


def is_expected(table: str, manifest: Mapping[str, Any]) -> bool:
    """Whether a run that keeps a table has it even without rows; of alerts only where there are detectors."""
    return table not in OPTIONAL or (table == "alerts" and bool(manifest.get("detectors")))


def _open_rows(folder: Path, table: str) -> Iterator[pa.RecordBatch]:
    for file in spool_files(folder, table):
        if not file.closed:
            yield from read_stream(file.path, trusted=True)


def ignore_unfinished(_: str, names: Iterable[str]) -> list[str]:
    """The files of a run's spool that only this process can continue, for `shutil.copytree`."""
    return [name for name in names if name.endswith(OPEN)]
