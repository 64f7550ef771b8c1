"""Row groups: rows of a table cut by their number, and by their bytes where rows can be large."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

GROUP_BYTES: Final = 64 << 20
"""Bytes of payloads or scans in a row group, about: it ends with the row that reaches them. 131,072 frames of MAVLink
have at most 37 MB."""
PART_BYTES: Final = 1 << 30
"""The same of a part of a table: so much stays in the spool until it is closed. No part of frames of MAVLink has as
much."""
_BYTES_PER_RAY: Final = 8
"""Of a row of `scans`, in memory."""


def count_bytes(table: str, batch: pa.RecordBatch) -> NDArray[np.int64] | None:
    """(n,) large bytes of each row: of its payload, or of the lists of a scan; None for a table without any.

    Frames count, because their payloads wait until they are written.
    """
    if table == "frames":
        sizes = batch.column("size").to_numpy(zero_copy_only=False)
    elif table == "payloads":
        sizes = pc.binary_length(batch.column("payload")).to_numpy(zero_copy_only=False)
    elif table == "scans":
        sizes = pc.list_value_length(batch.column("steps")).to_numpy(zero_copy_only=False) * _BYTES_PER_RAY
    else:
        return None
    found: NDArray[np.int64] = sizes.astype(np.int64)
    return found


def split_batch(table: str, batch: pa.RecordBatch, rows: int, room_bytes: int) -> tuple[pa.RecordBatch, int, bool]:
    """The first `rows` rows of a batch, or fewer if these reach `room_bytes`: with their bytes, and whether they are as
    many as fit.
    """
    sizes = count_bytes(table, batch)
    ends = None if sizes is None else np.cumsum(sizes)
    if ends is not None:
        rows = min(rows, int(np.searchsorted(ends, room_bytes)) + 1)
    piece = batch.slice(0, rows)
    used = 0 if ends is None or not piece.num_rows else int(ends[piece.num_rows - 1])
    return piece, used, piece.num_rows == rows


def cut_groups(table: str, batches: Iterable[pa.RecordBatch], rows: int) -> Iterator[tuple[pa.Table, int, bool]]:
    """Batches combined into groups of `rows` rows, or fewer with `GROUP_BYTES` bytes; with the bytes of each, and
    whether it is whole, as only the last may not be. Where the cuts are follows from the rows alone, however they were
    divided into batches.
    """
    pending: list[pa.RecordBatch] = []
    count = used = 0
    for batch in batches:
        while batch.num_rows:
            piece, more, is_full = split_batch(table, batch, rows - count, GROUP_BYTES - used)
            batch = batch.slice(piece.num_rows)
            pending.append(piece)
            count, used = count + piece.num_rows, used + more
            if is_full:
                yield pa.Table.from_batches(pending), used, True
                pending, count, used = [], 0, 0
    if pending:
        yield pa.Table.from_batches(pending), used, False
