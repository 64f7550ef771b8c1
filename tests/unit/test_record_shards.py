"""Rows of several shards of a record, as one stream in order of time."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow as pa
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.record.read.time_order import interleave

times = st.lists(st.integers(0, 60), max_size=40)


def _stream(shard: int, keys: list[int], cuts: list[int]) -> Iterator[pa.Table]:
    """The rows of a shard in tables of some lengths, with names as dictionaries of their own."""
    start = 0
    for length in [*cuts, len(keys)]:
        part = keys[start : start + length]
        names = pa.array([f"{shard}:{key % 5}" for key in part], pa.string()).dictionary_encode()
        yield pa.table({"time_ns": pa.array(part, pa.int64()), "row": range(start, start + len(part)), "name": names})
        start += length


def _rows(tables: Iterator[pa.Table]) -> list[tuple[int, int, str]]:
    return [(row["time_ns"], row["row"], row["name"]) for table in tables for row in table.to_pylist()]


@given(st.lists(st.tuples(times, st.lists(st.integers(0, 9), max_size=6)), min_size=1, max_size=4))
@settings(deadline=None)
def test_sorted_shards_become_one_sorted_stream_with_all_rows(shards: list[tuple[list[int], list[int]]]) -> None:
    parts = [(number, sorted(keys), cuts) for number, (keys, cuts) in enumerate(shards)]
    merged = _rows(interleave([_stream(*part) for part in parts], "time_ns"))
    assert [row[0] for row in merged] == sorted(row[0] for row in merged)
    assert sorted(merged) == sorted(row for part in parts for row in _rows(_stream(*part)))


@given(st.lists(st.tuples(times, st.lists(st.integers(0, 9), max_size=6)), min_size=1, max_size=4))
@settings(deadline=None)
def test_no_row_of_unsorted_shards_is_lost(shards: list[tuple[list[int], list[int]]]) -> None:
    parts = [(number, *shard) for number, shard in enumerate(shards)]
    merged = _rows(interleave([_stream(*part) for part in parts], "time_ns"))
    assert sorted(merged) == sorted(row for part in parts for row in _rows(_stream(*part)))
