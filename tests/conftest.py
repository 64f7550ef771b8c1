"""Rules of all tests: an external program that is missing skips its tests; kinds that a test registers end with it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import tests.tiers  # noqa: F401  # registers the profiles of hypothesis before the command line chooses one
from tests.registered_kinds import registered

pytest_plugins = ["tests.catalogue", "tests.processor_time", "tests.flight_folder"]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("external"):
        if missing := mark.kwargs.get("missing"):
            pytest.skip(missing)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    with registered():
        return (yield)
