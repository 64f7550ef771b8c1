"""Row groups with large rows: where they are cut depends on the rows alone, and each is bounded."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from skyrange.record.write.files import row_groups
from skyrange.record.write.files.row_groups import count_bytes, cut_groups


def payloads(sizes: list[int], first: int = 0) -> pa.RecordBatch:
    ids = pa.array(range(first, first + len(sizes)), pa.int64())
    return pa.RecordBatch.from_arrays([ids, pa.array([bytes(n) for n in sizes])], names=["payload_id", "payload"])


@pytest.fixture(autouse=True)
def small_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row_groups, "GROUP_BYTES", 1000)


@pytest.mark.parametrize("seed", range(8))
def test_cuts_do_not_depend_on_batches(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = rng.choice([0, 10, 300, 2500], 60).tolist()
    whole = payloads(sizes)
    cuts = sorted(rng.integers(0, 61, 9).tolist())
    parts = [whole.slice(a, b - a) for a, b in zip([0, *cuts], [*cuts, 60], strict=True)]
    once, often = list(cut_groups("payloads", [whole], 20)), list(cut_groups("payloads", parts, 20))
    assert [(t.column("payload_id").to_pylist(), used, full) for t, used, full in once] == [
        (t.column("payload_id").to_pylist(), used, full) for t, used, full in often
    ]
    assert [row for t, _, _ in often for row in t.column("payload_id").to_pylist()] == list(range(60))
    for group, used, full in often:
        own = [len(p) for p in group.column("payload").to_pylist()]
        counted = [count_bytes("payloads", batch) for batch in group.to_batches()]
        assert used == sum(own) == sum(int(part.sum()) for part in counted if part is not None)
        assert full == (len(own) == 20 or used >= 1000)
        assert sum(own[:-1]) < 1000
        assert len(own) <= 20
    assert all(full for _, _, full in often[:-1])


def test_rows_of_other_tables_are_cut_by_number() -> None:
    batch = pa.RecordBatch.from_arrays([pa.array(range(50))], names=["time_ns"])
    found = [(group.num_rows, full) for group, _, full in cut_groups("truth", [batch], 20)]
    assert found == [(20, True), (20, True), (10, False)]
