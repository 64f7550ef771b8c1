"""Sorting of recorded rows by time with bounded memory.

Rows are recorded when frames are finished, which is nearly in order of time. A first pass determines how far back
each batch reaches, and sets apart the few stragglers, such as a frame that was delayed for a minute. A second pass
yields rows as soon as no later batch can contain earlier ones.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.time import NEVER

STRAGGLER_ROWS = 131_072
"""A row is a straggler if a row with a later key was recorded at least this many rows before it."""


def sort_by_time(tables: Callable[[], Iterator[pa.Table]], key: str, ties: Sequence[str]) -> Iterator[pa.Table]:
    """The rows of all tables in ascending order of `key` (int64, not null), then of the columns `ties`.

    `tables` starts one pass over the rows and is called twice. Memory: at most about `STRAGGLER_ROWS` rows, one batch,
    and the stragglers.
    """
    sorting = [(name, "ascending") for name in (key, *ties)]
    floors: list[int] = []
    marks: list[int] = []
    late: list[pa.Table] = []
    recent: deque[tuple[int, int]] = deque()  # (rows, highest key so far) of the last batches
    recent_rows, highest, mark = 0, -NEVER, -NEVER
    for table in tables():
        keys = _keys(table, key)
        straggling = keys < mark
        if straggling.any():
            late.append(table.filter(pa.array(straggling)))
        prompt = keys[~straggling]
        floors.append(int(prompt.min()) if len(prompt) else NEVER)
        marks.append(mark)
        highest = max(highest, int(keys.max()) if len(keys) else -NEVER)
        recent.append((len(keys), highest))
        recent_rows += len(keys)
        while recent_rows - recent[0][0] >= STRAGGLER_ROWS:
            rows, mark = recent.popleft()
            recent_rows -= rows
    later = np.array([*floors[1:], NEVER], dtype=np.int64)
    bounds = np.minimum.accumulate(later[::-1])[::-1].tolist()
    stragglers = pa.concat_tables(late).sort_by(sorting) if late else None
    pool: pa.Table | None = None
    for table, mark, bound in zip(tables(), marks, bounds, strict=False):
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
        taken, self._rows = self._rows.slice(0, count), self._rows.slice(count)
        return taken
