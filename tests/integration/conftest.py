"""Fixtures of the tests of flights."""

from __future__ import annotations

import fcntl
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from skyrange.cli import main
from skyrange.runtime.warm_up import warm_up
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.execution import plan_run
from tests.ardupilot import programs
from tests.processor_time import CLOCK


@pytest.fixture(scope="session", autouse=True)
def studies_warm_up_once() -> Iterator[None]:
    """Let the first study of this process alone load the compiled functions before it forks its workers."""
    warm = False

    def warm_up_once(scenario: Scenario) -> None:
        nonlocal warm
        if not warm:
            with CLOCK.timed("shared"):
                warm_up(scenario)
        warm = True

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(plan_run, "warm_up", warm_up_once)
        yield


@pytest.fixture
def before() -> Iterator[set[int]]:
    """The ArduPilots of others; at the end none of ours is left."""
    others = programs()
    yield others
    assert programs() - others == set()


@pytest.fixture
def networks() -> Iterator[None]:
    """No other test process makes networks meanwhile, for a test that sees all networks of the machine."""
    with (Path(tempfile.gettempdir()) / "skyrange-test-networks").open("ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """The entry point of the command in this process; returns the exit code."""
    monkeypatch.setattr("skyrange.runtime.memory.collect_less", lambda: None)  # it is for a process's life

    def run_command(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", ["skyrange", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        assert isinstance(ended.value.code, int)
        return ended.value.code

    return run_command
