"""Is there an arducopter to test with? `needs_arducopter` skips a test, with the reason, where there is none."""

from __future__ import annotations

import os

import pytest

from skyrange.core.errors import InputError
from skyrange.vehicle.ardupilot.binary import VARIABLE, Binary, find


def _look() -> tuple[Binary | None, str]:
    try:
        return find(), ""
    except InputError as error:
        return None, str(error)


ARDUCOPTER, WHY_NOT = _look()
"""The binary that tests run, and why there is none."""

needs_arducopter = pytest.mark.skipif(ARDUCOPTER is None, reason=f"no arducopter found: {WHY_NOT}")
"""For tests that run it. One that is named but will not do skips these too, and fails `test_ardupilot_binary`."""

NAMED = bool(os.environ.get(VARIABLE))
"""Whether the variable says that there is one."""
