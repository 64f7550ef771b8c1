"""Is the processor time of tests measured by part, and are those that take too much named?"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.processor_time import DEAR_TESTS, PARTS, Clock, read_dear_tests

ROOT = Path(__file__).parents[2]
SPIN = """
import time
def spin(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
"""
SAMPLE = """
import subprocess, sys
from tests.processor_time import CLOCK
from spin import spin

def test_dear():
    spin(0.25)

often = []

def test_disturbed(tmp_path):
    often.append(list(tmp_path.iterdir()))
    (tmp_path / "mine").touch()
    spin(0.25 if len(often) == 1 else 0.05)
    assert often[-1] == []

def test_near():
    spin(0.17)

def test_cheap():
    spin(0.05)

def test_shared():
    with CLOCK.timed("shared"):
        spin(0.25)

def test_child():
    subprocess.run([sys.executable, "-c", "from spin import spin; spin(0.25)"], check=True, cwd=%r)
"""


def test_a_part_within_itself_counts_once() -> None:
    clock = Clock()
    names: dict[str, float] = {}
    exec(SPIN, names)  # as the sample does
    spin = names["spin"]
    assert callable(spin)
    with clock.timed("shared"):
        spin(0.05)
        with clock.timed("shared"):
            spin(0.05)
    assert 0.1 <= clock.read()["shared"] < 0.15


def test_tests_over_the_limit_fail_with_their_name_and_all_are_written(tmp_path: Path) -> None:
    (tmp_path / "spin.py").write_text(SPIN)
    (tmp_path / "test_sample.py").write_text(SAMPLE % str(tmp_path))
    (tmp_path / "conftest.py").write_text(
        "import sys\n"
        f"sys.path[:0] = [{str(ROOT)!r}, {str(tmp_path)!r}]\n"
        "import tests.processor_time as times\n"
        "times.LIMIT_S = 0.15\n"
        "times.Limit._scale = lambda self: 1.0\n"
        "times.Speed.measure = lambda self: 7.5\n"
        'pytest_plugins = ["tests.processor_time"]\n'
    )
    file = tmp_path / "times.json"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--limit-processor-time"]
    done = subprocess.run(
        [*command, "--processor-times", str(file), str(tmp_path)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    failed = {line.split()[1].partition("::")[2] for line in done.stdout.splitlines() if line.startswith("FAILED")}
    assert failed == {"test_dear", "test_child"}
    assert "test_sample.py::test_dear takes 0." in done.stdout
    assert "tests/dear_tests.toml" in done.stdout
    twice = re.findall(r"run twice: \S+::(\w+) 0\.\d s, then 0\.\d s", done.stdout)
    assert twice == ["test_dear", "test_disturbed", "test_near", "test_child"]
    found = json.loads(file.read_text())
    assert found["yardsticks_us"][0] == 7.5
    rows = {name.partition("::")[2]: phases for name, phases in found["tests"].items()}
    assert set(rows) == {"test_dear", "test_disturbed", "test_near", "test_cheap", "test_shared", "test_child"}
    assert rows["test_disturbed"]["call"]["total"] < 0.15, "it was over the limit once, and not again"
    assert all(set(phases) == {"setup", "call", "teardown"} for phases in rows.values())
    assert all(set(phase) == set(PARTS) for phases in rows.values() for phase in phases.values())
    assert rows["test_shared"]["call"]["shared"] == pytest.approx(0.25, abs=0.1)
    assert rows["test_child"]["call"]["children"] >= 0.25


def test_dear_tests_are_few_exist_and_have_reasons() -> None:
    tables = tomllib.loads(DEAR_TESTS.read_text(encoding="utf-8"))
    assert len(tables) <= 30
    for name, table in tables.items():
        file, _, test = name.partition("::")
        there = rf"^(def {test}\(|{test.removesuffix('::runTest')} = )"
        assert re.search(there, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE), name
        assert set(table) == {"limit_s", "reason"}
        assert table["reason"].endswith(".")
        assert 2.0 < read_dear_tests()[name] <= 40.0
