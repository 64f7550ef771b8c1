"""Is a budget of processor time scaled by the speed of the machine, and are the dearest tests named?"""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from tests.processor_time import REFERENCE_US
from tools import budget
from tools.budget import COLD_MINUTES, Step, Times, judge

STEPS = [Step("check", 0, 30.0), Step("test-fast", 0, 600.0)]
TESTS = {f"tests/test_x.py::test_{number}": float(number) for number in range(20)}


def times(yardstick_us: float) -> Times:
    return Times(TESTS, 0.0, [yardstick_us, 100.0, yardstick_us])


@pytest.mark.parametrize(
    ("minutes", "yardstick_us", "cold", "kept"),
    [
        (10.5, REFERENCE_US, False, True),
        (10.4, REFERENCE_US, False, False),
        (5.25, 2 * REFERENCE_US, False, True),
        (20.9, 0.5 * REFERENCE_US, False, False),
        (10.5 - COLD_MINUTES, REFERENCE_US, True, True),
    ],
)
def test_the_budget_is_scaled(minutes: float, yardstick_us: float, cold: bool, kept: bool) -> None:
    lines, held = judge(STEPS, times(yardstick_us), minutes, cold=cold)
    assert held is kept
    assert lines[:2] == ["check: 0.5 CPU-minutes", "test-fast: 10.0 CPU-minutes"]
    assert f"yardstick of {yardstick_us:.1f} µs" in lines[2]
    named = [line.split()[-1] for line in lines[4:]]
    assert named == ([] if kept else [f"tests/test_x.py::test_{number}" for number in range(19, 9, -1)])


def test_only_files_of_this_time_are_read(tmp_path: Path) -> None:
    phases = {"setup": {"total": 1.0, "compiled": 0.5}, "call": {"total": 2.0, "compiled": 0.25}, "teardown": {}}
    for name, at_s in (("old", 1_000.0), ("fast", 2_000.0), ("realtime", 3_000.0)):
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps({"yardsticks_us": [8.0], "tests": {f"test_{name}": phases}}))
        os.utime(path, (at_s, at_s))
    assert Times.read(tmp_path, 2_000.0) == Times({"test_fast": 3.0, "test_realtime": 3.0}, 1.5, [8.0, 8.0])
    assert Times.read(tmp_path / "none", 0.0) == Times({}, 0.0, [])


@pytest.mark.parametrize(
    ("targets", "options", "code", "made"),
    [
        (["good", "good"], [], 0, 2),
        (["bad", "good"], [], 2, 1),
        (["bad", "good"], ["--keep-going"], 2, 2),
        (["good", "dear"], [], 1, 2),
    ],
)
def test_targets_are_made_in_order(
    targets: list[str], options: list[str], code: int, made: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spin = "import time\\nwhile time.process_time() < 0.3: pass"
    (tmp_path / "Makefile").write_text(
        "good:\n\t@echo made >> made\nbad:\n\t@echo made >> made; false\n"
        f"dear:\n\t@echo made >> made; printf '{spin}' | python3 -\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(budget, "COLD_MINUTES", 0.0)
    app = typer.Typer()
    app.command()(budget.main)
    done = CliRunner().invoke(app, ["--minutes", "0.004", *options, *targets])
    assert done.exit_code == code, done.output
    assert (tmp_path / "made").read_text().split() == ["made"] * made
    assert ("over budget" in done.output) is (code == 1)
