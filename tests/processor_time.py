"""Processor time of each test, by phase: how much of it compiled, flew, or was of other processes."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any

import pytest

PARTS = ("total", "compiled", "flown", "children")
"""What is measured of each phase, in seconds of processor time: all of it; what numba compiled; what `Kernel.advance`
took; and what other processes took that have ended in the phase. The last three are parts of the first."""


Reported = Generator[None, pytest.TestReport, pytest.TestReport]


@dataclass
class Clock:
    """Processor time of this process and the processes that it has waited for, by `PARTS`, since it began."""

    spent: dict[str, float] = field(default_factory=lambda: {"compiled": 0.0, "flown": 0.0})
    _depth: dict[str, int] = field(default_factory=dict)
    _began: dict[str, float] = field(default_factory=dict)
    _wrapped: bool = False
    _listening: bool = False

    def read(self) -> dict[str, float]:
        """The seconds of each part so far."""
        self._attach()
        times = os.times()
        children = times.children_user + times.children_system
        return {"total": time.process_time() + children, "children": children, **self.spent}

    def enter(self, part: str) -> None:
        """`part` begins; it may begin again inside."""
        depth = self._depth.get(part, 0)
        if depth == 0:
            self._began[part] = time.process_time()
        self._depth[part] = depth + 1

    def leave(self, part: str) -> None:
        """`part` ends."""
        self._depth[part] -= 1
        if self._depth[part] == 0:
            self.spent[part] += time.process_time() - self._began[part]

    def _attach(self) -> None:
        """Listen to numba and the kernel once they have been imported; some tests see what they import themselves."""
        if not self._listening and "numba.core.dispatcher" in sys.modules:
            self._listening = True
            self._listen()
        if not self._wrapped and (module := sys.modules.get("skyrange.kernel.kernel")) and hasattr(module, "Kernel"):
            self._wrapped = True
            module.Kernel.advance = self._timed(module.Kernel.advance, "flown")

    def _timed(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        @wraps(function)
        def timed(*words: Any, **named: Any) -> Any:
            self.enter(part)
            try:
                return function(*words, **named)
            finally:
                self.leave(part)

        return timed

    def _listen(self) -> None:
        from numba.core import event

        clock = self

        class Listener(event.Listener):
            def on_start(self, event: Any) -> None:
                clock.enter("compiled")

            def on_end(self, event: Any) -> None:
                clock.leave("compiled")

        event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]


CLOCK = Clock()


class Costs:
    """A plugin of pytest that adds to each report what its phase took, and writes them all to a file at the end."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._rows: dict[str, dict[str, dict[str, float]]] = {}

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        with _Measured(item):
            return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        with _Measured(item):
            return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        with _Measured(item):
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: Any
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        report.processor_s = item.stash.get(_SPENT, {})  # type: ignore[attr-defined]
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._rows.setdefault(report.nodeid, {})[report.when] = getattr(report, "processor_s", {})

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self._path is not None and not hasattr(session.config, "workerinput"):
            self._path.write_text(json.dumps(self._rows, indent=0))


_SPENT = pytest.StashKey[dict[str, float]]()


class _Measured:
    def __init__(self, item: pytest.Item) -> None:
        self._item = item

    def __enter__(self) -> None:
        self._before = CLOCK.read()

    def __exit__(self, *_: object) -> None:
        after = CLOCK.read()
        self._item.stash[_SPENT] = {part: round(after[part] - self._before[part], 4) for part in PARTS}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--processor-times", metavar="FILE", help="write the processor time of each test to FILE, as JSON")


def pytest_configure(config: pytest.Config) -> None:
    path = config.getoption("--processor-times")
    config.pluginmanager.register(Costs(Path(path) if path else None))
