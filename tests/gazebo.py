"""Is there a Gazebo with skyrange's plugin to test with, and which of its processes run? Without it tests skip."""

from __future__ import annotations

import pytest

from skyrange.core.errors import InputError
from skyrange.vehicle.gazebo.gazebo_program import Gazebo, find_gazebo
from skyrange.vehicle.gazebo.plugin_library import find_plugin
from tests.ardupilot import WHY_NOT as NO_ARDUCOPTER
from tests.own_processes import find_own


def _look() -> tuple[Gazebo | None, str]:
    try:
        found = find_gazebo()
        find_plugin(found)
    except InputError as error:
        return None, str(error)
    return found, ""


GAZEBO, WHY_NOT = _look()
"""The Gazebo that tests run, and why there is none, or no plugin for it."""

_MISSING = (WHY_NOT and f"no Gazebo found: {WHY_NOT}") or (NO_ARDUCOPTER and f"no arducopter found: {NO_ARDUCOPTER}")
needs_gazebo = pytest.mark.external(missing=_MISSING)
"""For tests that fly in it."""


def simulators() -> set[int]:
    """The process ids of all Gazebos with a world of skyrange that descend from us, and of orphans."""
    return find_own(lambda command: any(b"skyrange-gazebo-world-" in word for word in command))
