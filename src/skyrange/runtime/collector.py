"""How often does Python look for garbage while a fleet flies? Seldom, and not among what was there before.

A run holds hundreds of thousands of objects that stay to its end, and little of what it makes is garbage that only the
collector can find. Looking at all of them again and again took 7 % of a run of a thousand aircraft.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_YOUNG = 20_000  # objects made before the young ones are looked at; Python's own figure is 700


@contextmanager
def at_ease() -> Iterator[None]:
    """Set apart all objects that there are, and look for garbage among new ones less often; then all is as before."""
    before = gc.get_threshold()
    nested = gc.get_freeze_count() > 0
    if not nested:
        gc.freeze()
    gc.set_threshold(_YOUNG, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
        if not nested:
            gc.unfreeze()
