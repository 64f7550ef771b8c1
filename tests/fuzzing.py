"""A plugin of pytest that repeats property tests for some minutes, with new examples each time.

`make fuzz` loads it. Each pass runs the files in another order, without the tests that have failed. Hypothesis stores
what fails in `.hypothesis/examples`, tries it first in every later run, and writes a patch to `.hypothesis/patches`
that makes it a case of its test; this plugin writes the report of each failure to `.hypothesis/findings`.
"""

from __future__ import annotations

import random
import re
import time
from itertools import groupby

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--fuzz-minutes", type=float, default=10.0, help="how long property tests are repeated")


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(_Fuzzing(config))


class _Fuzzing:
    def __init__(self, config: pytest.Config) -> None:
        self._time_s = 60.0 * float(config.getoption("--fuzz-minutes"))
        self._findings = config.rootpath / ".hypothesis" / "findings"
        self._failed: set[str] = set()
        self._passes = 0

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        others = [item for item in items if not item.get_closest_marker("hypothesis")]
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if item.get_closest_marker("hypothesis")]

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        if session.testsfailed or session.config.option.collectonly:
            return None  # pytest's own loop says so
        ends_s = time.monotonic() + self._time_s
        while items := self._next_pass(session.items):
            self._passes += 1
            for item, following in zip(items, [*items[1:], None], strict=True):
                session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if session.shouldfail:
                    raise session.Failed(session.shouldfail)
                if session.shouldstop:
                    raise session.Interrupted(session.shouldstop)
                if time.monotonic() > ends_s:
                    return True
        return True

    def _next_pass(self, items: list[pytest.Item]) -> list[pytest.Item]:
        """The items that have not failed; files in a random order, so that fixtures of a module are made once."""
        left = [item for item in items if item.nodeid not in self._failed]
        files = [list(group) for _, group in groupby(left, lambda item: item.path)]
        random.shuffle(files)
        return [item for file in files for item in file]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._failed.add(report.nodeid)
            self._findings.mkdir(parents=True, exist_ok=True)
            name = re.sub(r"\W+", "-", report.nodeid)[:200]
            parts = [report.longreprtext, *(f"{title}\n{text}" for title, text in report.sections)]
            (self._findings / f"{name}.txt").write_text("\n\n".join(parts) + "\n", encoding="utf-8")

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        terminalreporter.section("fuzzing")
        terminalreporter.line(f"pass {self._passes} was the last; {len(self._failed)} tests failed")
        if self._failed:
            terminalreporter.line(f"reports: {self._findings}; `make test` tries the failing examples first")
