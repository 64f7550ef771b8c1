"""Processes that descend from this one, and orphans, by their command lines."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


def find_own(matches: Callable[[list[bytes]], bool]) -> set[int]:
    """The process ids of those, of all that descend from us and of orphans, whose command line `matches`."""
    parents, found = {}, set()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                command = (entry / "cmdline").read_bytes().split(b"\0")
                state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
            except OSError:
                continue
            parents[int(entry.name)] = int(parent)
            if matches(command) and state != "Z":
                found.add(int(entry.name))

    def ours(pid: int) -> bool:
        above = parents.get(pid, 0)
        return above == os.getpid() or (above > 1 and ours(above))

    return {pid for pid in found if parents[pid] == 1 or ours(pid)}
