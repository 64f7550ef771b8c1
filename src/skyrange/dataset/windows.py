"""Windows of a view: their numbers, a hash of what is observed in each, and which of them have been there already."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from hashlib import blake2b
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames import Ints
from skyrange.core.parquet_files import read_table
from skyrange.core.time import NS_PER_S, Time
from skyrange.dataset.columns import RUN_COLUMNS, WINDOW_KEYS, observable_columns, view_schema

WINDOW_NS: Final[Time] = NS_PER_S
"""The length of a window."""

HASH_BYTES: Final = 8
_NULL: Final = np.uint64(0x9E3779B97F4A7C15)


class SplitHashes:
    """The windows of a data set that were written, and the split in which each was first: about 100 bytes a window."""

    def __init__(self) -> None:
        self._first: dict[str, dict[int, int]] = {}
        self._homes: list[tuple[str, str]] = []
        """Splits and runs, by the numbers above."""
        self._numbers: dict[tuple[str, str], int] = {}

    def find_elsewhere(self, view: str, digest: str, split: str, run: str) -> str | None:
        """The first run of another split with this window; `None` if there is none, and then this one may be it."""
        number = self._numbers.setdefault((split, run), len(self._homes))
        if number == len(self._homes):
            self._homes.append((split, run))
        first_split, first_run = self._homes[self._first.setdefault(view, {}).setdefault(int(digest, 16), number)]
        return None if first_split == split else first_run

    def add_file(self, view: str, split: str, path: Path) -> None:
        """Take the windows of a file that was written before."""
        columns = ["run", "content_hash", "duplicate_of"]
        table = read_table(path, "dataset", str(path), view_schema(view), columns=columns)
        originals = (
            table.filter(pc.is_null(table.column("duplicate_of"))).group_by(["content_hash", "run"]).aggregate([])
        )
        for digest, run in zip(
            originals.column("content_hash").to_pylist(), originals.column("run").to_pylist(), strict=True
        ):
            self.find_elsewhere(view, digest, split, run)


class WindowHashes:
    """The windows of one block that were written, by view and place; those of other splits are in `elsewhere`."""

    def __init__(self, split: str, elsewhere: SplitHashes) -> None:
        self._split, self._elsewhere = split, elsewhere
        self._seen: dict[tuple[str, ...], str] = {}

    def mark(self, view: str, run: str, table: pa.Table) -> pa.Table:
        """The table, which has whole windows and the column `window`, with `content_hash` and `duplicate_of`."""
        count = table.num_rows
        codes = number_keys(table, (*WINDOW_KEYS[view], "window"))
        order = np.argsort(codes, kind="stable")
        bounds = np.flatnonzero(np.diff(codes[order], prepend=-1))
        ends = np.append(bounds[1:], count)[: len(bounds)]
        rows = pa.array(order)
        words = _words(table, observable_columns(view))[order]
        blobs = [_bytes(table.column(name).take(rows)) for name in observable_columns(view)
                 if pa.types.is_binary(table.schema.field(name).type)]  # fmt: skip
        firsts = table.select([*WINDOW_KEYS[view], "window"]).take(rows.take(pa.array(bounds))).to_pylist()
        hashes, origins = [], []
        for first, begin, end in zip(firsts, bounds.tolist(), ends.tolist(), strict=True):
            hashed = blake2b(words[begin:end].tobytes(), digest_size=HASH_BYTES)
            for offsets, data in blobs:
                hashed.update(data[offsets[begin] : offsets[end]])
            digest = hashed.hexdigest()
            origin = self._seen.setdefault((view, *map(str, first.values()), digest), run)
            hashes.append(digest)
            duplicate_of = self._elsewhere.find_elsewhere(view, digest, self._split, run) if origin == run else origin
            origins.append(duplicate_of)
        place = np.empty(count, dtype=np.int64)
        place[order] = np.repeat(np.arange(len(bounds)), ends - bounds)
        table = table.append_column("content_hash", pa.array(hashes, pa.string()).take(pa.array(place)))
        return table.append_column("duplicate_of", pa.array(origins, pa.string()).take(pa.array(place)))


def by_whole_windows(
    tables: Iterator[pa.Table], column: str, period_ns: Time, rows: int = 131_072
) -> Iterator[pa.Table]:
    """The rows of tables in order of time, in tables of about `rows` rows that end where a window ends."""
    pending: list[pa.Table] = []
    count = 0
    for table in tables:
        if not table.num_rows:
            continue
        pending.append(table)
        count += table.num_rows
        if count < rows:
            continue
        joined = pa.concat_tables(pending)
        windows = joined.column(column).to_numpy() // period_ns
        ready = int(np.searchsorted(windows, windows[-1]))
        if ready:
            yield joined.slice(0, ready)
        pending, count = [joined.slice(ready)], count - ready
    if count:
        yield pa.concat_tables(pending)


def number_keys(table: pa.Table, keys: Sequence[str]) -> Ints:
    """(n,) the same number, at least 0, for rows with equal values in the columns `keys`."""
    codes = np.zeros(table.num_rows, dtype=np.int64)
    code_bound = 1
    for key in keys:
        column = table.column(key).combine_chunks()
        names = column.dictionary_encode()
        names = names.combine_chunks() if isinstance(names, pa.ChunkedArray) else names
        if code_bound * (len(names.dictionary) + 1) >= 2**62:
            codes = np.unique(codes, return_inverse=True)[1].astype(np.int64)
            code_bound = int(codes.max()) + 1
        codes = codes * (len(names.dictionary) + 1) + names.indices.to_numpy(zero_copy_only=False)
        code_bound *= len(names.dictionary) + 1
    return codes


def _words(table: pa.Table, columns: Sequence[str]) -> NDArray[np.uint64]:
    """(n, k) the columns as 64-bit words, equal where the values are equal; bytes by their lengths."""
    words = np.empty((table.num_rows, len(columns)), dtype=np.uint64)
    for place, name in enumerate(columns):
        column = table.column(name).combine_chunks()
        column = column.chunk(0) if isinstance(column, pa.ChunkedArray) and column.num_chunks == 1 else column
        if pa.types.is_boolean(column.type):
            column = column.cast(pa.int8())
        if pa.types.is_integer(column.type):
            words[:, place] = column.cast(pa.int64()).fill_null(-(2**62)).to_numpy(zero_copy_only=False).view(np.uint64)
        elif pa.types.is_floating(column.type):
            nulls = np.asarray(pc.is_null(column))
            values = column.cast(pa.float64()).fill_null(0.0).to_numpy(zero_copy_only=False)
            words[:, place] = np.where(nulls, _NULL, np.ascontiguousarray(values).view(np.uint64))
        elif pa.types.is_binary(column.type):
            words[:, place] = pc.binary_length(column).cast(pa.int64()).to_numpy(zero_copy_only=False).view(np.uint64)
        else:
            encoded = column.dictionary_encode()
            encoded = encoded.combine_chunks() if isinstance(encoded, pa.ChunkedArray) else encoded
            known = np.append(_hashes(encoded.dictionary.cast(pa.binary()).to_pylist()), _NULL)
            words[:, place] = known[encoded.indices.fill_null(len(known) - 1).to_numpy(zero_copy_only=False)]
    return words


def _bytes(column: pa.ChunkedArray) -> tuple[list[int], memoryview]:
    """(n + 1,) where the values begin and end in the bytes of all, and these."""
    joined = column.combine_chunks()
    joined = joined.chunk(0) if isinstance(joined, pa.ChunkedArray) else joined
    _, offsets, data = joined.buffers()
    places = np.frombuffer(offsets, dtype=np.int32)[joined.offset : joined.offset + len(joined) + 1]
    return places.tolist(), memoryview(data or b"")


def _hashes(values: Sequence[bytes]) -> NDArray[np.uint64]:
    joined = b"".join([blake2b(value, digest_size=HASH_BYTES).digest() for value in values])
    return np.frombuffer(joined, dtype="<u8").astype(np.uint64)


def begin_rows(table: pa.Table, run: str, block: str, arm: str) -> pa.Table:
    """The table with the columns of its run in front."""
    names = {"run": run, "block": block, "arm": arm}
    for place, column in enumerate(RUN_COLUMNS):
        values = pa.repeat(pa.scalar(names[column.name]), table.num_rows)
        table = table.add_column(place, column.name, values)
    return table
