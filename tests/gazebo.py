"""Is there a Gazebo with skyrange's plugin to test with, and which of its processes run? Without it tests skip."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from skyrange.core.errors import InputError
from skyrange.vehicle.gazebo.program.gazebo_commands import Gazebo
from skyrange.vehicle.gazebo.program.gazebo_release import find_gazebo
from skyrange.vehicle.gazebo.program.plugin_library import find_plugin
from tests.ardupilot import WHY_NOT as NO_ARDUCOPTER


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
    """The process ids of all Gazebos of this user that a world of skyrange was given."""
    found = set()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
                state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
                own = entry.stat().st_uid == os.getuid()
            except OSError:
                continue
            if own and state != "Z" and any(b"skyrange-gazebo-world-" in word for word in words):
                found.add(int(entry.name))
    return found
