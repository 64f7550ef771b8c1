"""Fuzzing finds a planted fault, stops trying its test, reports it, and leaves it for the fast tier."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

PROPERTIES = """
from pathlib import Path

from hypothesis import example, given
from hypothesis import strategies as st


@given(st.integers(0, 1_000_000))
def test_planted(number):
    with Path("tried").open("a") as file:
        print(number, file=file)
    assert number * 7919 % 97 != 5


@given(st.booleans())
def test_right(boolean):
    with Path("passes").open("a") as file:
        print(boolean, file=file)


def test_without_examples():
    raise AssertionError("not a property")
"""


def pytest_in(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.tiers", *arguments, "test_properties.py"]
    return subprocess.run(
        command, cwd=folder, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False, timeout=300
    )


@pytest.mark.slow
def test_planted_fault_is_found_reported_and_replayed(tmp_path: Path) -> None:
    (tmp_path / "test_properties.py").write_text(PROPERTIES)
    fuzzed = pytest_in(tmp_path, "-p", "tests.fuzzing", "--fuzz-minutes", "0.1", "--hypothesis-profile", "fuzz")
    assert fuzzed.returncode == 1, fuzzed.stdout
    assert "1 deselected" in fuzzed.stdout
    number = re.search(r"number=(\d+)", fuzzed.stdout)
    assert number is not None
    assert int(number[1]) * 7919 % 97 == 5

    (report,) = (tmp_path / ".hypothesis" / "findings").iterdir()
    assert report.name == "test_properties-py-test_planted.txt"
    assert f"number={number[1]}" in report.read_text()
    assert "@reproduce_failure(" in report.read_text()

    (tmp_path / "tried").unlink()
    passes = len((tmp_path / "passes").read_text().splitlines())
    replayed = pytest_in(tmp_path, "-k", "planted", "--hypothesis-profile", "quick")
    assert replayed.returncode == 1
    assert (tmp_path / "tried").read_text().splitlines()[0] == number[1]
    assert passes > 4, "the other test is repeated"

    (patch,) = (tmp_path / ".hypothesis" / "patches").iterdir()
    assert re.search(rf"^\+@example\(\s*\+    number={number[1]},$", patch.read_text(), re.MULTILINE)
