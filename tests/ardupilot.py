"""Is there an arducopter to test with, and which processes of it run? Without one `needs_arducopter` skips a test."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from skyrange.core.errors import InputError
from skyrange.vehicle.ardupilot.arducopter_binary import VARIABLE, Binary, find_binary
from tests.own_processes import find_own


def _look() -> tuple[Binary | None, str]:
    try:
        return find_binary(), ""
    except InputError as error:
        return None, str(error)


ARDUCOPTER, WHY_NOT = _look()
"""The binary that tests run, and why there is none."""

needs_arducopter = pytest.mark.external(missing=WHY_NOT and f"no arducopter found: {WHY_NOT}")
"""For tests that run it. One that is named but will not do skips these too, and fails `test_ardupilot_binary`."""

NAMED = bool(os.environ.get(VARIABLE))
"""Whether the variable says that there is one."""


def programs() -> set[int]:
    """The process ids of all ArduPilots that descend from us, and of orphans."""
    return find_own(lambda command: command[1:2] == [b"--model"])


def listening(pids: set[int]) -> set[str]:
    """Sockets of these processes that listen on TCP."""
    theirs = {os.readlink(link) for pid in pids for link in Path(f"/proc/{pid}/fd").iterdir() if os.path.islink(link)}
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A":  # LISTEN
                found.add(f"socket:[{fields[9]}]")
    return theirs & found
