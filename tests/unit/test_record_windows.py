"""Payloads once per window, rows in order of time, and memory that does not grow with the run."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from skyrange.core.time import NEVER
from skyrange.record import Recorder, load
from skyrange.record.read import time_order as order_module
from skyrange.record.read.time_order import sort_by_time
from skyrange.record.schema import PAYLOAD_WINDOW
from tests.unit.record_sample import make_frame


def _record(folder: Path, payloads: list[bytes], spool_bytes: int, flush_at: int = 10**9) -> Recorder:
    recorder = Recorder.open(folder, {}, spool_bytes=spool_bytes)
    for serial, payload in enumerate(payloads):
        recorder.on_frame(make_frame("gcs:blue/b1", "rev", "s", serial, serial, payload))
        if serial % flush_at == flush_at - 1:
            recorder.flush()
    return recorder


@pytest.mark.parametrize("spool_bytes", [1, 10, 100, 1 << 20])
@pytest.mark.parametrize("close", [True, False])
def test_every_frame_finds_its_payload_across_windows(tmp_path: Path, spool_bytes: int, close: bool) -> None:
    payloads = [bytes([k % 7, k % 5]) * (k % 3) for k in range(500)]
    recorder = _record(tmp_path / "run", payloads, spool_bytes, 90)
    if close:
        recorder.close()
    else:
        recorder.flush()
    run = load(tmp_path / "run")
    assert [frame.payload for frame in run.frames_with_payloads()] == payloads
    ids = run.table("payloads").column("payload_id").to_pylist()
    assert ids == sorted(set(ids))
    for window in {number // PAYLOAD_WINDOW for number in ids}:
        rows = [r["payload"] for r in run.table("payloads").to_pylist() if r["payload_id"] // PAYLOAD_WINDOW == window]
        assert len(rows) == len(set(rows))
        # a window takes payloads until it holds spool_bytes: without the last it held fewer
        assert sum(map(len, rows[:-1])) < spool_bytes
    assert (len(ids) == len(set(payloads))) == (spool_bytes == 1 << 20)


def test_payload_ids_do_not_depend_on_flushing(tmp_path: Path) -> None:
    payloads = [bytes([k % 11, k % 3]) for k in range(300)]
    for flush_at in (1, 7, 1000):
        _record(tmp_path / str(flush_at), payloads, 40, flush_at).close()
    tables = [load(tmp_path / str(flush_at)).table("frames") for flush_at in (1, 7, 1000)]
    assert tables[0].equals(tables[1])
    assert tables[0].equals(tables[2])


def _tables(keys: list[list[int]]) -> list[pa.Table]:
    return [
        pa.table({"t": pa.array(part, pa.int64()), "n": pa.array([str(k) for k in part], pa.string())}) for part in keys
    ]


@pytest.mark.parametrize("reach", [1, 3, 10**6])
@pytest.mark.parametrize(
    "keys",
    [
        [],
        [[]],
        [[3, 1, 2]],
        [[1, 2], [3, 4], [5]],
        [[5, 9], [1, 2], [3], [], [0], [4, -7]],
        [[10], [20], [30], [40], [50], [5], [60], [NEVER], [7]],
        [[NEVER], [1], [-NEVER]],
    ],
)
def test_rows_come_in_order(keys: list[list[int]], reach: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order_module, "STRAGGLER_ROWS", reach)

    def read_keys() -> Iterator[Any]:
        return (np.array(part, dtype=np.int64) for part in keys)

    for keys_of in (None, read_keys):
        tables = sort_by_time(lambda: iter(_tables(keys)), "t", ("n",), keys_of)
        found = [key for table in tables for key in table.column("t").to_pylist()]
        assert found == sorted(key for part in keys for key in part)


def test_ordering_holds_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """One row that comes last though it belongs first must not make everything wait for it."""
    monkeypatch.setattr(order_module, "STRAGGLER_ROWS", 20)
    keys = [list(range(k * 10, k * 10 + 10)) for k in range(50)]
    keys.append([3])
    sizes = [table.num_rows for table in sort_by_time(lambda: iter(_tables(keys)), "t", ("n",))]
    assert sum(sizes) == 501
    assert max(sizes) <= 40


GROWTH = """
import sys
from collections.abc import Iterator
from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.codec.mavlink import Packer, dialect
from skyrange.record import Recorder
from skyrange.runtime.memory import peak_memory_mb as peak_mb

recorder = Recorder.open(sys.argv[1], {"operators": [{"id": "blue"}]})
names = [f"blue/b{k}" for k in range(100)]
packers = [Packer(k + 1, 1) for k in range(100)]
ends = [[(f"{hop}:{name}", f"{name}.{role}") for hop, role in
         (("autopilot", "autopilot"), ("log", "proxy"), ("gcs", "companion"))] for name in names]
rows, marks = 0, []
while rows < 600_000:
    count = rows // 300
    for k in range(100):
        payload = packers[k].pack(dialect.MAVLink_attitude_message(count, 0.01 * count, k, 1.0, 0.0, 0.0, 0.0))
        parent = None
        for link, sender in ends[k]:
            sent_ns = count * 125_000_000
            frame = Frame(link, "rev", sender, count, sender, "x", sent_ns=sent_ns, payload=payload, parent=parent)
            end_journey(frame, Fate.DELIVERED, frame.sent_ns + 1000)
            parent = frame.id
            recorder.on_frame(frame)
    rows += 300
    if rows in (300_000, 600_000):
        marks.append(peak_mb())
recorder.close()
marks.append(peak_mb())
print(*marks)
"""


@pytest.mark.slow
def test_memory_is_bounded(tmp_path: Path) -> None:
    """600,000 frames: memory holds one window of payloads, a few row groups and a block of messages.

    The same rows as Python objects would take over 300 MB (a frame, its id and its numbers are about 500 bytes).
    """
    done = subprocess.run(
        [sys.executable, "-c", GROWTH, str(tmp_path / "run")], capture_output=True, text=True, check=True, timeout=300
    )
    early, late, closed = map(float, done.stdout.split())
    assert late - early < 60
    assert closed - late < 60
    assert load(tmp_path / "run").rows("frames") == 600_000
