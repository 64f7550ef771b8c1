"""Rules of all tests: an external program that is missing skips its tests; kinds that a test registers end with it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import tests.tiers  # noqa: F401  # registers the profiles of hypothesis before the command line chooses one
from skyrange.contracts import plugins
from tests.registered_kinds import registered


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("external"):
        if missing := mark.kwargs.get("missing"):
            pytest.skip(missing)


def pytest_collection_finish(session: pytest.Session) -> None:
    """A module that registers kinds when it is imported would change what every other test sees."""
    if plugins._registered:
        names = ", ".join(f"{kind} ({group})" for group, kind in plugins._registered)
        raise pytest.UsageError(f"registered by the import of a test module: {names}; use tests.registered_kinds")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    with registered():
        return (yield)
