"""A plugin of pytest that traces lines with coverage.py, in a context for each test, also in processes that it starts.

What runs once for several tests has the context of their file: fixtures of a wider scope than a function, and functions
of tests whose results are cached.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import coverage
import pytest
from hypothesis import HealthCheck, settings

from tests import flights

CONTEXT = "SKYRANGE_TEST_CONTEXT"
"""The environment variable that has the current context; coverage's configuration of other processes reads it."""

_cache = functools.cache

F = TypeVar("F", bound=Callable[..., Any])


class Tracer:
    """coverage.py in this process, and the context that it is in: a node id or a file, "" between tests."""

    def __init__(self) -> None:
        self._coverage: coverage.Coverage | None = None
        self._context = ""
        self._caches: list[Any] = []

    def start(self, configuration: str) -> None:
        """Trace from now on, and in processes that this one starts."""
        self._coverage = coverage.Coverage(config_file=configuration, data_suffix=True)
        self._coverage.start()
        os.environ["COVERAGE_PROCESS_START"] = configuration

    def stop(self) -> None:
        """Save what was traced."""
        if self._coverage is not None:
            self.switch("")
            self._coverage.stop()
            self._coverage.save()

    def switch(self, context: str) -> None:
        """What is executed from now on is of `context`."""
        if self._coverage is None or context == self._context:
            return
        if context.partition("::")[0] != self._context.partition("::")[0]:
            for cache in self._caches:
                cache.cache_clear()
        self._context = context
        self._coverage.switch_context(context)
        os.environ[CONTEXT] = context.replace("\x00", "(null)")

    @property
    def file(self) -> str:
        """The test file of the context."""
        return self._context.partition("::")[0]

    @contextmanager
    def shared(self) -> Iterator[None]:
        """What is executed inside is of all tests of the current file."""
        before = self._context
        self.switch(self.file)
        try:
            yield
        finally:
            self.switch(before)

    def cache_of_file(self, function: F) -> F:
        """`functools.cache` of a function of the tests: computed once for each test file, in the file's context."""

        @_cache
        @functools.wraps(function)
        def compute(*words: Any, **named: Any) -> Any:
            with self.shared():
                return function(*words, **named)

        self._caches.append(compute)
        return compute  # type: ignore[return-value]


TRACER = Tracer()


def cache(function: F) -> F:
    """`functools.cache`, in the file's context for functions of the tests."""
    if function.__module__.partition(".")[0] == "tests":
        return TRACER.cache_of_file(function)
    return _cache(function)  # type: ignore[return-value]


functools.cache = cache  # type: ignore[assignment]


def _fly_for_file(how: str, scenario: Any, make: Callable[[Path], object]) -> Path:
    """A flight that tests share, flown once for each test file, in the file's context."""
    with TRACER.shared():
        return _flown(f"{how}-{TRACER.file.replace('/', '.')}", scenario, make)


_flown = flights._flown
flights._flown = _fly_for_file


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that starts the tracer."""
    parser.addoption("--trace-lines", metavar="FILE", help="trace lines with this configuration of coverage.py")


@pytest.hookimpl(trylast=True)  # after hypothesis has chosen its profile
def pytest_configure(config: pytest.Config) -> None:
    """Start to trace, in the processes that run tests alone; hypothesis does not mind that they are slow."""
    configuration = config.getoption("--trace-lines")
    runs_tests = hasattr(config, "workerinput") or not config.getoption("numprocesses", None)
    if configuration and runs_tests:
        settings.register_profile("traced", settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow])
        settings.load_profile("traced")
        TRACER.start(configuration)


def pytest_unconfigure() -> None:
    """Save what was traced."""
    TRACER.stop()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Trace the fixtures of a test."""
    TRACER.switch(item.nodeid)
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Trace a test."""
    TRACER.switch(item.nodeid)
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Trace the end of a test; the last of a file also ends what all its tests share."""
    file = item.nodeid.partition("::")[0]
    last = nextitem is None or nextitem.nodeid.partition("::")[0] != file
    TRACER.switch(file if last else item.nodeid)
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[Any]) -> Generator[None, Any, Any]:
    """Trace a fixture; one that several tests share is of all tests of the file."""
    if fixturedef.scope == "function":
        return (yield)
    with TRACER.shared():
        return (yield)
