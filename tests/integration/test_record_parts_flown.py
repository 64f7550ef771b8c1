"""A flown run whose tables have many parts: telemetry and observations that are derived in flight."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pyarrow as pa
import pytest

from skyrange.record import Recorder, RunRecord, load
from skyrange.record.schema import TABLES
from skyrange.record.verification import verify_run
from skyrange.runtime.run import Run
from skyrange.scenario.shipped import load as load_scenario
from tests.flights import shared_run


def _fly(folder: Path, part_rows: int, monkeypatch: pytest.MonkeyPatch) -> RunRecord:
    monkeypatch.setattr(Recorder, "open", partial(Recorder.open, part_rows=part_rows))
    run = Run.start(load_scenario("rid-spoofing", ["duration_s=25", "record.level=full"]), folder)
    run.execute()
    monkeypatch.undo()
    return load(folder)


def _text(table: pa.Table) -> list[str]:
    """The rows as text, in which not-a-number equals itself."""
    return [repr(row) for row in table.to_pylist()]


@pytest.mark.rotating
def test_derived_tables_are_the_same_in_flight_and_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = shared_run(load_scenario("rid-spoofing", ["duration_s=25", "record.level=full"]))
    parts = _fly(tmp_path / "parts", 150, monkeypatch)
    assert (parts.path / "frames.parquet").is_dir()
    assert whole.rows("observations") > 50
    for key in ("digests", "counts", "messages", "outcomes"):
        assert whole.manifest[key] == parts.manifest[key]
    for name in TABLES:
        assert _text(whole.table(name)) == _text(parts.table(name)), name
    for message in whole.messages:
        assert _text(whole.telemetry(message)) == _text(parts.telemetry(message)), message
    assert verify_run(parts).ok
