"""Memory of this process: its peak, and garbage collection while a fleet flies.

Garbage is collected seldom, and not among the objects that existed before. A run holds hundreds of thousands of objects
that live to its end, and little of what it allocates is garbage that only the collector can find. Collections of all of
them took 7 % of a run of a thousand aircraft.
"""

from __future__ import annotations

import atexit
import gc
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

_STATUS = Path("/proc/self/status")


def peak_memory_mb() -> float:
    """Peak resident set size in MiB.

    Linux's VmHWM if available: `ru_maxrss` starts with the parent's value at the time it started this process.
    """
    if _STATUS.exists():
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


_YOUNG = 20_000  # allocations before a collection of the young generation; Python's own figure is 700


def collect_less() -> None:
    """Collect new objects less often from now on, in a process that is the command's own, and none at its end."""
    _collect_young_less()
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)  # Python would look through all objects several times before it ends


@contextmanager
def collect_seldom() -> Iterator[None]:
    """Exempt all existing objects from collection, and collect new ones less often; restore both at the end."""
    before = gc.get_threshold()
    nested = gc.get_freeze_count() > 0
    if not nested:
        gc.freeze()
    _collect_young_less()
    try:
        yield
    finally:
        gc.set_threshold(*before)
        if not nested:
            gc.unfreeze()


class RunGarbage:
    """What runs that have ended leave to the collector: `collect_seldom` keeps it from looking, so that it is told to.

    The parts of a run refer to each other: about half a megabyte each.
    """

    EVERY: Final = 32
    """Runs between two collections, which take about as long as a third of a short run."""

    def __init__(self) -> None:
        self._runs = 0

    def add(self, runs: int) -> None:
        """Count runs that have ended, and collect if there are enough."""
        self._runs += runs
        if self._runs >= self.EVERY:
            self._runs = 0
            gc.collect()


def _collect_young_less() -> None:
    gc.set_threshold(_YOUNG, *gc.get_threshold()[1:])
