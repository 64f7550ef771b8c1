"""A plugin of pytest that traces lines with coverage.py, in a context for each test, also in processes that it starts.

What runs once for several tests has a context that they share: a fixture of a wider scope than a function has its own,
and the tests that use it are listed in a file; functions of tests whose results are cached have that of the test file.
"""

from __future__ import annotations

import functools
import json
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

FIXTURE = "::fixture "
"""What stands in the context of a shared fixture between where it is defined and its name."""

USERS = "fixtures"
"""Files with this name beside the configuration list the shared fixtures of each test, one for each process."""

F = TypeVar("F", bound=Callable[..., Any])


class Tracer:
    """coverage.py in this process, and its context: a node id, a file or a shared fixture, "" between tests."""

    def __init__(self) -> None:
        self._coverage: coverage.Coverage | None = None
        self._context = ""
        self._file = ""
        self._users = Path()
        self._caches: list[Any] = []

    def start(self, configuration: str) -> None:
        """Trace from now on, and in processes that this one starts."""
        self._users = Path(configuration).with_name(f"{USERS}.{os.getpid()}")
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
        file = context.partition("::")[0]
        if file != self._file and FIXTURE not in context:
            self._file = file
            for cache in self._caches:
                cache.cache_clear()
        self._context = context
        self._coverage.switch_context(context)
        os.environ[CONTEXT] = context.replace("\x00", "(null)")

    @property
    def file(self) -> str:
        """The test file of the context."""
        return self._context.partition("::")[0]

    def list_fixtures(self, item: pytest.Item) -> None:
        """Write which fixtures a test shares with others."""
        definitions = item._fixtureinfo.name2fixturedefs.values() if isinstance(item, pytest.Function) else ()
        shared = [name_fixture(each[-1]) for each in definitions if each[-1].scope != "function"]
        if shared and self._coverage is not None:
            with self._users.open("a") as file:
                file.write(json.dumps([item.nodeid, shared]) + "\n")

    @contextmanager
    def shared(self, context: str = "") -> Iterator[None]:
        """What is executed inside is of the tests that share `context`: by default all of the current file."""
        before = self._context
        self.switch(context or self.file)
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


def name_fixture(definition: pytest.FixtureDef[Any]) -> str:
    """The context of a fixture that several tests share."""
    return f"{definition.baseid}{FIXTURE}{definition.argname}"


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
    TRACER.list_fixtures(item)
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
    """Trace a fixture; one that several tests may share has a context of its own."""
    if fixturedef.scope == "function":
        return (yield)
    with TRACER.shared(name_fixture(fixturedef)):
        return (yield)
