"""Garbage collection while a fleet flies: seldom, and not among the objects that existed before.

A run holds hundreds of thousands of objects that live to its end, and little of what it allocates is garbage that only
the collector can find. Collections of all of them took 7 % of a run of a thousand aircraft.
"""

from __future__ import annotations

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager

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
