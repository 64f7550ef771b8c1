"""Rules of all tests: a test of the external tier is skipped where its program is missing."""

from __future__ import annotations

import pytest

import tests.tiers  # noqa: F401  # registers the profiles of hypothesis before the command line chooses one


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("external"):
        if missing := mark.kwargs.get("missing"):
            pytest.skip(missing)
