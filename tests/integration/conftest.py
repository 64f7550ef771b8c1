"""Fixtures of the tests of flights."""

from __future__ import annotations

import fcntl
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ardupilot import programs


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
