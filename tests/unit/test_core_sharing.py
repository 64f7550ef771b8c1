"""A program that takes turns with us runs on our core, and goes free where somebody else wants that one too."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from skyrange.io.processes.core_sharing import CoreSharing
from skyrange.io.processes.program import Program

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="cores are kept on Linux alone")


@pytest.fixture
def sleeper(tmp_path: Path) -> Iterator[Program]:
    program = Program("sleeper", [sys.executable, "-c", "import time; time.sleep(60)"], tmp_path)
    yield program
    program.kill()


def quiet(monkeypatch: pytest.MonkeyPatch, yields: float = 0.0) -> None:
    """The machine's clock stands still, but for so many seconds whenever the core is given away."""
    clock = [100.0]

    def give() -> None:
        clock[0] += yields

    monkeypatch.setattr("skyrange.io.processes.core_sharing.monotonic", lambda: clock[0])
    monkeypatch.setattr(os, "sched_yield", give)


def test_it_is_kept_to_the_core_that_we_are_on_and_follows(sleeper: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    quiet(monkeypatch)
    ours = os.sched_getaffinity(0)
    pair = CoreSharing(sleeper)
    try:
        for core in sorted(ours):
            os.sched_setaffinity(0, {core})
            pair.yield_core()
            assert os.sched_getaffinity(sleeper.pid) == {core}
    finally:
        os.sched_setaffinity(0, ours)
    assert os.sched_getaffinity(0) == ours


def test_where_the_core_comes_back_late_it_goes_free_for_a_while(
    sleeper: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = os.sched_getaffinity(0)
    quiet(monkeypatch, yields=0.003)
    pair = CoreSharing(sleeper)
    pair.yield_core()
    assert os.sched_getaffinity(sleeper.pid) == ours
    quiet(monkeypatch)
    pair.yield_core()
    assert os.sched_getaffinity(sleeper.pid) == ours
    monkeypatch.setattr("skyrange.io.processes.core_sharing.monotonic", lambda: 102.0)
    pair.yield_core()
    assert len(os.sched_getaffinity(sleeper.pid)) == 1


def test_one_that_has_ended_is_left_alone(tmp_path: Path) -> None:
    program = Program("brief", [sys.executable, "-c", ""], tmp_path)
    deadline = time.monotonic() + 20.0
    while program.running and time.monotonic() < deadline:
        time.sleep(0.01)
    CoreSharing(program).yield_core()
    assert program.ended == "exit 0"
