"""A plugin of pytest that runs tests within a budget of processor time.

It ends the process when the budget is used up or a test hangs, and writes what became of each test. What numba compiles
does not count.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.processor_time import CLOCK

PERIOD_S = 0.2
ENDED = 70
"""The exit status of a run that was ended."""


class Limits:
    """The seconds that each test is expected to take, and those that all may take together."""

    def __init__(self, plan: dict[str, Any], outcomes: Path) -> None:
        self._expected: dict[str, float] = plan["tests"]
        self._budget_s: float = plan["budget_s"]
        self._slack_s: float = plan["slack_s"]
        self._outcomes = outcomes
        self._test = ""
        self._began_s = 0.0
        self._spent_s = 0.0
        self._waited_s = 0.0
        self._failed = False

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Note a file that cannot be collected."""
        if report.failed:
            self._write(report.nodeid, "failed", 0.0)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Measure a test."""
        self._test, self._failed, self._waited_s = item.nodeid, False, 0.0
        self._began_s = _read(attach=True)
        try:
            return (yield)
        finally:
            seconds = _read(attach=True) - self._began_s
            self._spent_s += seconds
            self._test = ""
            self._write(item.nodeid, "failed" if self._failed else "passed", seconds)
            if self._spent_s >= self._budget_s:
                item.session.shouldstop = "the budget is used up"

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note whether a test failed."""
        self._failed = self._failed or report.failed

    def watch(self) -> None:
        """End the process when the limits are reached; runs in a thread of its own."""
        while True:
            time.sleep(PERIOD_S)
            test = self._test
            if not test or CLOCK._depth.get("compiled"):
                continue
            self._waited_s += PERIOD_S
            seconds = _read() - self._began_s
            allowed_s = self._slack_s + 10 * self._expected.get(test, 0.0)
            hangs = seconds > allowed_s or self._waited_s > 4 * allowed_s  # that waits for what never comes
            if hangs or self._spent_s + seconds >= self._budget_s:
                hangs = hangs or seconds > allowed_s / 2
                self._write(test, "hangs" if hangs else "unfinished", seconds)
                os._exit(ENDED)

    def _write(self, test: str, outcome: str, seconds: float) -> None:
        with self._outcomes.open("a") as file:
            file.write(json.dumps([test, outcome, round(seconds, 3)]) + "\n")


def _read(*, attach: bool = False) -> float:
    """The processor time so far without compilation; only the main thread may attach the clock to numba."""
    if attach:
        CLOCK.read()
    times = os.times()
    compiled: float = CLOCK.spent["compiled"]
    return time.process_time() + times.children_user + times.children_system - compiled


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    parser.addoption("--test-plan", metavar="FILE", help="the budget, and the seconds of each test: a JSON file")
    parser.addoption("--test-outcomes", metavar="FILE", help="write what became of each test to FILE, line by line")


def pytest_configure(config: pytest.Config) -> None:
    """Watch the tests if there is a plan."""
    if path := config.getoption("--test-plan"):
        limits = Limits(json.loads(Path(path).read_text()), Path(config.getoption("--test-outcomes")))
        config.pluginmanager.register(limits)
        threading.Thread(target=limits.watch, daemon=True).start()
