"""Rows of the shards of a run, which several processes recorded side by side, as one stream in order of time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.time import NEVER
from skyrange.record.dictionaries import unify_dictionaries

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
    heads = [head for head in map(_Head, streams) if head.fill(key)]
    while heads:
        bound = min(head.bound for head in heads)
        parts = [part for head in heads if (part := head.take(key, bound)).num_rows]
        if parts:
            merged = unify_dictionaries(pa.concat_tables(parts))
            yield merged.sort_by([(key, "ascending")])
        heads = [head for head in heads if head.fill(key)]


class _Head:
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
        taken, self._rows = self._rows.slice(0, count), self._rows.slice(count)
        return taken
