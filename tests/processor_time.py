"""Processor time of each test, by phase and part, and the limit of a test of the fast tier.

The times are seconds of processor time of the worker and of the processes that it has waited for. `--processor-times
FILE` writes them, with the yardsticks that were measured meanwhile. With `--limit-processor-time`, a test whose call
takes more than `LIMIT_S` fails, unless it is one of `tests/dear_tests.toml`. The limit holds at the speed of the
reference machine and is scaled by the yardstick of `skyrange bench`, which each worker measures every minute and after
a test that is over the limit. Such a test runs once more, because what else the machine does takes processor time too:
it is named at the end, and fails if it is over the limit by `NOISE` the second time.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
import tomllib
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

PARTS = ("total", "compiled", "flown", "shared", "children")
"""What is measured of a phase: all of it; what numba compiled; what `Kernel.advance` took; what flights took that tests
share; and what other processes took that ended in the phase. The others are parts of the first."""
LIMIT_S = 2.0
"""The most that the call of a test may take, without compilation and shared flights, at the reference yardstick."""
MARK_LIMITS_S = {"catalogue": 10.0, "rotating": 6.0}
"""The same for tests by their mark, of which a tenth and a third run."""
NOISE = 1.5
"""How much longer than its limit a test may take that was over it before, because of what else the machine does."""
REFERENCE_US = 7.5
"""The yardstick of the reference machine, in microseconds."""
DEAR_TESTS = Path(__file__).with_name("dear_tests.toml")
_SPENT = pytest.StashKey[dict[str, float]]()
_OVER = pytest.StashKey[float]()
Reported = Generator[None, pytest.TestReport, pytest.TestReport]


@dataclass
class Clock:
    """Processor time of this process and the processes that it has waited for, by `PARTS`, since it began."""

    spent: dict[str, float] = field(default_factory=lambda: {"compiled": 0.0, "flown": 0.0, "shared": 0.0})
    _depth: dict[str, int] = field(default_factory=dict)
    _began: dict[str, float] = field(default_factory=dict)
    _attached: set[str] = field(default_factory=set)

    def read(self) -> dict[str, float]:
        """The seconds of each part so far."""
        self._attach()
        total, children = _used()
        return {"total": total, "children": children, **self.spent}

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """What is done inside is of `part`."""
        self.enter(part)
        try:
            yield
        finally:
            self.leave(part)

    def enter(self, part: str) -> None:
        """`part` begins; it may begin again inside."""
        depth = self._depth.get(part, 0)
        if depth == 0:
            self._began[part] = _used()[0]
        self._depth[part] = depth + 1

    def leave(self, part: str) -> None:
        """`part` ends."""
        self._depth[part] -= 1
        if self._depth[part] == 0:
            self.spent[part] += _used()[0] - self._began[part]

    def _attach(self) -> None:
        """Listen to numba and the kernel once they have been imported; some tests see what they import themselves."""
        if "numba.core.dispatcher" in sys.modules and "numba" not in self._attached:
            self._attached.add("numba")
            self._listen()
        kernel: Any = getattr(sys.modules.get("skyrange.kernel.kernel"), "Kernel", None)
        if kernel is not None and "kernel" not in self._attached:
            self._attached.add("kernel")
            kernel.advance = self._timing(kernel.advance, "flown")

    def _timing(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        @wraps(function)
        def timed(*words: Any, **named: Any) -> Any:
            with self.timed(part):
                return function(*words, **named)

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


def _used() -> tuple[float, float]:
    """Processor time so far, of this process with those that it has waited for, and of the latter."""
    times = os.times()
    children = times.children_user + times.children_system
    return time.process_time() + children, children


CLOCK = Clock()


@dataclass
class Speed:
    """The yardsticks that were measured in this process."""

    seen_us: list[float] = field(default_factory=list)
    _next_s: float = 0.0

    def look(self) -> None:
        """Measure the yardstick, if the last measurement is a minute ago."""
        if time.monotonic() >= self._next_s:
            self.measure()

    def measure(self) -> float:
        """Measure the yardstick, in microseconds."""
        from skyrange.bench.yardstick import yardstick_us

        self.seen_us.append(yardstick_us())
        self._next_s = time.monotonic() + 60.0
        return self.seen_us[-1]


class Times:
    """A plugin of pytest that adds to each report what its phase took, and writes them all to a file at the end."""

    def __init__(self, path: Path | None, speed: Speed) -> None:
        self._path = path
        self._speed = speed
        self._rows: dict[str, dict[str, dict[str, float]]] = {}

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Generator[None, object, object]:
        with _measured(item):
            return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, object, object]:
        with _measured(item):
            return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Generator[None, object, object]:
        with _measured(item):
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Reported:
        report = yield
        report.processor_s = item.stash.get(_SPENT, {})  # type: ignore[attr-defined]
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._rows.setdefault(report.nodeid, {})[report.when] = getattr(report, "processor_s", {})

    def pytest_runtest_logstart(self) -> None:
        if self._path is not None and "skyrange.codec.mavlink" in sys.modules:
            self._speed.look()

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if isinstance(output := getattr(session.config, "workeroutput", None), dict):
            output["yardsticks_us"] = self._speed.seen_us
        elif self._path is not None:
            found = {"yardsticks_us": self._speed.seen_us or [self._speed.measure()], "tests": self._rows}
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.write_text(json.dumps(found, indent=0))

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        self._speed.seen_us += getattr(node, "workeroutput", {}).get("yardsticks_us", [])


class Limit:
    """A plugin of pytest that fails tests which take too much processor time."""

    def __init__(self, speed: Speed) -> None:
        self._dear = read_dear_tests()
        self._speed = speed
        self._twice: list[str] = []

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Reported:
        report = yield
        spent = item.stash.get(_SPENT, {})
        if report.when == "call" and report.passed and (words := self._excess(item, spent)):
            report.outcome, report.longrepr = "failed", words
            item.stash[_OVER] = spent["total"]
        return report

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        """Run a test, and once more if it is over the limit; the last time is reported, and that there were two."""
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        if (first_s := item.stash.get(_OVER, 0.0)) > 0.0:
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
        for report in reports:
            report.first_s = first_s  # type: ignore[attr-defined]
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" and (first_s := getattr(report, "first_s", 0.0)) > 0.0:
            again_s = getattr(report, "processor_s", {}).get("total", 0.0)
            self._twice.append(f"{report.nodeid} {first_s:.1f} s, then {again_s:.1f} s")

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for words in self._twice:
            terminalreporter.write_line(f"over the limit of processor time, and so run twice: {words}")

    def _excess(self, item: pytest.Item, spent: dict[str, float]) -> str:
        taken_s = spent["total"] - spent["compiled"] - spent["shared"]
        usual_s = max([LIMIT_S] + [limit_s for mark, limit_s in MARK_LIMITS_S.items() if item.get_closest_marker(mark)])
        limit_s = self._dear.get(item.nodeid.partition("[")[0], usual_s) * (NOISE if _OVER in item.stash else 1.0)
        if taken_s <= limit_s * self._scale():
            return ""
        scale = max(self._speed.measure() / REFERENCE_US, self._scale())
        if taken_s <= limit_s * scale:
            return ""
        return (
            f"{item.nodeid} takes {taken_s:.1f} s of processor time, more than {limit_s:g} s times {scale:.2f} for the"
            " machine. Make it shorter, read a flight of tests/flights.py, or mark it rotating or slow; if its"
            f" length is what finds something, list it in tests/{DEAR_TESTS.name}."
        )

    def _scale(self) -> float:
        return statistics.median(self._speed.seen_us or [REFERENCE_US]) / REFERENCE_US


def read_dear_tests() -> dict[str, float]:
    """The tests that may take more than `LIMIT_S`, without their parameters, and how much each may take."""
    tables = tomllib.loads(DEAR_TESTS.read_text(encoding="utf-8"))
    return {name: float(table["limit_s"]) for name, table in tables.items()}


@contextmanager
def _measured(item: pytest.Item) -> Iterator[None]:
    before = CLOCK.read()
    try:
        yield
    finally:
        after = CLOCK.read()
        item.stash[_SPENT] = {part: round(after[part] - before[part], 4) for part in PARTS}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--processor-times", metavar="FILE", help="write the processor time of each test to FILE, as JSON")
    parser.addoption(
        "--limit-processor-time", action="store_true", help=f"fail tests that take more than {LIMIT_S:g} s of it"
    )


def pytest_configure(config: pytest.Config) -> None:
    speed = Speed()
    path = config.getoption("--processor-times")
    config.pluginmanager.register(Times(Path(path) if path else None, speed))
    if config.getoption("--limit-processor-time"):
        config.pluginmanager.register(Limit(speed))
