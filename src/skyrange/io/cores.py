"""How do we and a program that takes turns with us share one processor core?

It computes while we wait, and waits while we do. On two cores each turn wakes a core that has just gone to sleep, which
takes as long as a step of ArduPilot, and finds its caches cold. So the program is kept on the core that we are on, and
gets it when we wait. We ourselves stay free to be moved, and it follows: to bind our thread would bind every thread
that is begun in it later. Where another program wants the core too, we part for a while.
"""

from __future__ import annotations

import ctypes
import os
import sys
from time import monotonic

from skyrange.io.programs import Program

_LONG_S = 0.001
"""Who gets the core back so late had to share it with somebody else: the least slice of Linux is longer."""
_APART_S = 1.0


class Pair:
    """One program and this thread. Where the system is not Linux it does nothing."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._core = -1
        self._apart_until = 0.0
        self._core_now = None
        if sys.platform == "linux":
            self._core_now = getattr(ctypes.CDLL(None), "sched_getcpu", None)

    def give_way(self) -> None:
        """Let it compute: called when it has got its work, before waiting for its answer."""
        if self._core_now is None:
            return
        began = monotonic()
        if began < self._apart_until:
            return
        core = self._core_now()
        if core != self._core:
            self._core = core
            self._program.keep_to({core})
        os.sched_yield()
        if monotonic() - began > _LONG_S:
            self._core = -1
            self._program.keep_to(os.sched_getaffinity(0))
            self._apart_until = began + _APART_S
