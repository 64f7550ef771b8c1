"""Views of the data set: passes over what was observed, of which few rows are read once."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow as pa
import pytest

from skyrange.dataset import frame_views


@pytest.mark.parametrize(("most_rows", "reads"), [(6, 3), (7, 1), (8, 1)])
def test_every_pass_has_all_rows_and_few_are_read_once(
    monkeypatch: pytest.MonkeyPatch, most_rows: int, reads: int
) -> None:
    monkeypatch.setattr(frame_views, "STRAGGLER_ROWS", most_rows)
    tables = [pa.table({"at_ns": range(start, start + rows)}) for start, rows in ((0, 3), (3, 0), (3, 4))]
    begun = 0

    def read() -> Iterator[pa.Table]:
        nonlocal begun
        begun += 1
        yield from tables

    passes = frame_views._Passes(read)
    assert [list(passes()) for _ in range(3)] == [tables] * 3
    assert begun == reads
