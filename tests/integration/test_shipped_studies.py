"""Shipped studies with a page: their smallest blocks fly, are measured, and say what the page says of such flights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skyrange.study.design.model import read_study
from skyrange.study.execution.executors import InThisProcess
from skyrange.study.study_run import run_study
from tools.docs import measure_studies
from tools.docs.accelerometer_failsafe import first_end
from tools.docs.signing_time import is_locked_out

pytestmark = pytest.mark.slow


def fly(name: str, folder: Path, changes: list[str]) -> list[dict[str, Any]]:
    run_study(read_study(name, ["seeds=1", *changes]), folder, executor=InThisProcess())
    return measure_studies.measure(name, folder)


def test_an_attacked_accelerometer_crashes_an_aircraft_before_its_failsafe_acts(tmp_path: Path) -> None:
    rows = fly("accelerometer-failsafe", tmp_path / "s", ["factors.signal.values=['none', 'up 20']"])
    assert len(rows) == 2 * 3
    assert {row["signal"]: first_end(row) for row in rows if row["arm"] == "off"}["none"] == "nothing"
    assert all(row["crashed_s"] < 5.0 for row in rows if row["signal"] == "up 20")


def test_time_ahead_locks_a_station_out_and_time_behind_lets_a_replay_pass(tmp_path: Path) -> None:
    values = ["true", "ahead 1 h", "behind 1 h, since boot, replay"]
    rows = fly("signing-time", tmp_path / "s", [f"factors.time.values={values}"])
    assert len(rows) == 3 * 7
    cells = {(row["time"], row["arm"]): row for row in rows}
    assert not is_locked_out(cells["true", "computer"])
    assert is_locked_out(cells["ahead 1 h", "computer"])
    assert not is_locked_out(cells["ahead 1 h", "received"])
    assert cells["behind 1 h, since boot, replay", "received"]["obeyed"]
    assert not cells["behind 1 h, since boot, replay", "bounded"]["obeyed"]
