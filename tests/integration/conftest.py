"""What have tests of flights in common?"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.ardupilot import programs


@pytest.fixture
def before() -> Iterator[set[int]]:
    """The ArduPilots of others; at the end none of ours is left."""
    others = programs()
    yield others
    assert programs() - others == set()
