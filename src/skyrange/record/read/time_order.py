"""Sorting of recorded rows by time with bounded memory, and rows of several shards as one stream.

Rows are recorded when frames are finished, which is nearly in order of time. A first pass determines how far back
each batch reaches, and sets apart the few stragglers, such as a frame that was delayed for a minute. A second pass
yields rows as soon as no later batch can contain earlier ones.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.time import NEVER
from skyrange.record.dictionaries import unify_dictionaries

Ints = NDArray[np.int64]

STRAGGLER_ROWS = 131_072
"""A row is a straggler if a row with a later key was recorded at least this many rows before it."""


def sort_by_time(
    tables: Callable[[], Iterator[pa.Table]],
    key: str,
    ties: Sequence[str],
    keys_of: Callable[[], Iterator[Ints]] | None = None,
) -> Iterator[pa.Table]:
    """The rows of all tables in ascending order of `key` (int64, not null), then of the columns `ties`.

    `tables` starts one pass over the rows; a first pass is over `keys_of`, the keys of each table, if they can be read
    sooner. Memory: at most about `STRAGGLER_ROWS` rows, one batch, and the stragglers.
    """
    sorting = [(name, "ascending") for name in (key, *ties)]
    bounds = _Bounds()
    for keys in keys_of() if keys_of is not None else (_keys(table, key) for table in tables()):
        bounds.add(keys)
    late: list[pa.Table] = []
    if bounds.are_late:
        for table, mark in zip(tables(), bounds.marks, strict=False):
            late.append(table.filter(pa.array(_keys(table, key) < mark)))
    stragglers = pa.concat_tables(late).sort_by(sorting) if late else None
    pool: pa.Table | None = None
    for table, mark, bound in zip(tables(), bounds.marks, bounds.bounds(), strict=False):
        keys = _keys(table, key)
        prompt_rows = table if (keys >= mark).all() else table.filter(pa.array(keys >= mark))
        parts = [part for part in (pool, prompt_rows) if part is not None]
        if stragglers is not None:
            due = int(np.searchsorted(_keys(stragglers, key), bound))
            parts.append(stragglers.slice(0, due))
            stragglers = stragglers.slice(due)
        pool = pa.concat_tables(parts).sort_by(sorting)
        # after the last batch every row is ready, those with the key NEVER included
        ready = pool.num_rows if bound == NEVER else int(np.searchsorted(_keys(pool, key), bound))
        if ready:
            yield pool.slice(0, ready)
            pool = pool.slice(ready)
    rest = [part for part in (pool, stragglers) if part is not None and part.num_rows]
    if rest:
        yield pa.concat_tables(rest).sort_by(sorting)


class _Bounds:
    """What a pass over the keys of all batches finds."""

    def __init__(self) -> None:
        self.marks: list[int] = []
        """Of each batch, the key below which its rows are stragglers."""
        self.are_late = False
        """Whether there are any."""
        self._floors: list[int] = []
        self._recent: deque[tuple[int, int]] = deque()  # (rows, highest key so far) of the last batches
        self._recent_rows, self._highest, self._mark = 0, -NEVER, -NEVER

    def add(self, keys: Ints) -> None:
        """Look at the keys of the next batch."""
        straggling = keys < self._mark
        self.are_late = self.are_late or bool(straggling.any())
        prompt = keys[~straggling]
        self._floors.append(int(prompt.min()) if len(prompt) else NEVER)
        self.marks.append(self._mark)
        self._highest = max(self._highest, int(keys.max()) if len(keys) else -NEVER)
        self._recent.append((len(keys), self._highest))
        self._recent_rows += len(keys)
        while self._recent_rows - self._recent[0][0] >= STRAGGLER_ROWS:
            rows, self._mark = self._recent.popleft()
            self._recent_rows -= rows

    def bounds(self) -> list[int]:
        """Of each batch, the least key of all later ones, stragglers aside."""
        later = np.array([*self._floors[1:], NEVER], dtype=np.int64)
        bounds: list[int] = np.minimum.accumulate(later[::-1])[::-1].tolist()
        return bounds


def _keys(table: pa.Table, key: str) -> NDArray[np.int64]:
    keys: NDArray[np.int64] = table.column(key).to_numpy()
    return keys


def merge_sorted(streams: Sequence[Iterator[pa.Table]], key: str, ties: Sequence[str]) -> Iterator[pa.Table]:
    """Merge several streams, each sorted by `key` and `ties`, into one stream sorted likewise.

    Memory: about two tables of each stream. All streams must have the same columns.
    """
    sorting = [(name, "ascending") for name in (key, *ties)]
    heads = [head for head in map(_Head, streams) if head.fill(key)]
    while heads:
        # ties of a head's last row may still follow, so that row waits, except at the end of its stream
        bound = min(head.bound for head in heads)
        parts = [head.take(key, bound) for head in heads]
        yield pa.concat_tables(parts).sort_by(sorting)
        heads = [head for head in heads if head.fill(key)]


def align_sorted(streams: Mapping[str, Iterator[pa.Table]], key: str) -> Iterator[dict[str, pa.Table]]:
    """The rows of several streams, each sorted by `key`, with columns of their own, in spans of time: a table of each
    stream that has rows in the span, by its name. Every row of a span is before all rows of the next one.

    Memory: about two tables of each stream.
    """
    heads = {name: head for name, head in ((name, _Head(stream)) for name, stream in streams.items()) if head.fill(key)}
    while heads:
        bound = min(head.bound for head in heads.values())
        yield {name: part for name, head in heads.items() if (part := head.take(key, bound)).num_rows}
        heads = {name: head for name, head in heads.items() if head.fill(key)}


class _Head:
    """The rows of a stream that were read but not yet merged."""

    def __init__(self, stream: Iterator[pa.Table]) -> None:
        self._stream = stream
        self._rows: pa.Table | None = None
        self.bound = -NEVER
        """All rows with a smaller key have been read."""

    def fill(self, key: str) -> bool:
        """Read until some row can be merged; returns False at the end of the stream."""
        while True:
            keys = _keys(self._rows, key) if self._rows is not None else np.zeros(0, dtype=np.int64)
            if len(keys) and (self.bound == NEVER or keys[0] < keys[-1]):
                self.bound = self.bound if self.bound == NEVER else int(keys[-1])
                return True
            following = next(self._stream, None)
            if following is None:
                self.bound = NEVER
                if not len(keys):
                    return False
            elif following.num_rows:
                self._rows = following if not len(keys) else pa.concat_tables([self._rows, following])

    def take(self, key: str, bound: int) -> pa.Table:
        assert self._rows is not None
        keys = _keys(self._rows, key)
        count = len(keys) if bound == NEVER else int(np.searchsorted(keys, bound))
        rows, self._rows = self._rows.slice(0, count), self._rows.slice(count)
        return rows


_KEYS: Final = ("sent_ns", "time_ns")
"""Columns that tell when a row was: frames have the first, all other tables but payloads the second."""


def time_key(schema: pa.Schema) -> str | None:
    """The column of a table by which the rows of its shards are put in order; `None` for payloads, which have ids."""
    return next((key for key in _KEYS if key in schema.names), None)


def interleave(streams: Sequence[Iterator[pa.Table]], key: str) -> Iterator[pa.Table]:
    """Merge streams of tables by the int64 column `key`, each of which is nearly in its order.

    Each table that it yields is sorted, and no row of a later one is much earlier than its rows: as little as in the
    streams themselves. Memory: about one table of each stream.
    """
    heads = [head for head in map(_ShardHead, streams) if head.fill(key)]
    while heads:
        bound = min(head.bound for head in heads)
        parts = [part for head in heads if (part := head.take(key, bound)).num_rows]
        if parts:
            merged = unify_dictionaries(pa.concat_tables(parts))
            yield merged.sort_by([(key, "ascending")])
        heads = [head for head in heads if head.fill(key)]


class _ShardHead:
    """The rows of a stream that were read but not yet merged."""

    def __init__(self, stream: Iterator[pa.Table]) -> None:
        self._stream = stream
        self._rows: pa.Table | None = None
        self.bound: int = -NEVER
        """Rows up to this key may be taken; greater ones may have to wait for other streams."""

    def fill(self, key: str) -> bool:
        """Read a table if none is held; returns False at the end of the stream."""
        while self._rows is None or not self._rows.num_rows:
            self._rows = next(self._stream, None)
            if self._rows is None:
                return False
        self.bound = int(pc.max(self._rows.column(key)).as_py())
        return True

    def take(self, key: str, bound: int) -> pa.Table:
        """The rows before the first that is later than `bound`."""
        assert self._rows is not None
        later = np.flatnonzero(self._rows.column(key).to_numpy() > bound)
        count = int(later[0]) if len(later) else self._rows.num_rows
        rows, self._rows = self._rows.slice(0, count), self._rows.slice(count)
        return rows
