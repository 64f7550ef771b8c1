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


def _collect_young_less() -> None:
    gc.set_threshold(_YOUNG, *gc.get_threshold()[1:])
