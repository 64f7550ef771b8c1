"""Sharing of one processor core by this thread and a program that takes turns with it.

The program computes while this thread waits, and waits while it computes. On two cores each turn wakes a core that has
just gone to sleep, which takes as long as a step of ArduPilot, and finds its caches cold. So the program is kept on the
core of this thread, and gets it when the thread waits. The thread itself may be moved, and the program follows: to pin
the thread would pin every thread that it starts later. If another program uses the core too, the two separate for a
while.
"""

from __future__ import annotations

import ctypes
import os
import sys
from time import monotonic

from skyrange.io.processes.program import Program

_SHARED_S = 0.001
"""If the core comes back later than this, a third program has used it: the shortest time slice of Linux is longer."""
_SEPARATE_S = 1.0


class CoreSharing:
    """One program and this thread. On systems other than Linux it does nothing."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._core = -1
        self._separate_until = 0.0
        self._core_now = None
        if sys.platform == "linux":
            self._core_now = getattr(ctypes.CDLL(None), "sched_getcpu", None)

    def yield_core(self) -> None:
        """Let the program compute: call it after sending work, before waiting for the answer."""
        if self._core_now is None:
            return
        began = monotonic()
        if began < self._separate_until:
            return
        core = self._core_now()
        if core != self._core:
            self._core = core
            self._program.keep_to({core})
        os.sched_yield()
        if monotonic() - began > _SHARED_S:
            self._core = -1
            self._program.keep_to(os.sched_getaffinity(0))
            self._separate_until = began + _SEPARATE_S
