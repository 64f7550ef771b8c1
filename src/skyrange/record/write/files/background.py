"""Thread beside the simulation that does work in order; the simulation waits when too much of it is pending."""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Final

PENDING: Final = 2
"""Calls that may wait or be under way; a further one waits for the first."""

_NICENESS: Final = 10


def _yield_to_simulation() -> None:
    """Let this thread run while the simulation waits, for another core or for this thread, rather than in its place."""
    if sys.platform == "linux":  # elsewhere a priority is the whole process's (setpriority(2), "C library differences")
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)


class Background:
    """Calls functions one after the other in a thread of its own, which starts with the first one.

    After an exception, later calls are dropped, and `submit` and `wait` raise it.
    """

    def __init__(self) -> None:
        self._executor: ThreadPoolExecutor | None = None
        self._pending: deque[Future[None]] = deque()
        self._error: BaseException | None = None

    @property
    def is_used(self) -> bool:
        """Whether anything was submitted."""
        return self._executor is not None

    def submit(self, call: Callable[[], object]) -> None:
        """Call a function later, after all earlier ones."""
        if self._executor is None:
            self._executor = ThreadPoolExecutor(1, "recorder", initializer=_yield_to_simulation)
        while len(self._pending) >= PENDING or (self._pending and self._pending[0].done()):
            self._pending.popleft().result()
        self._raise()
        self._pending.append(self._executor.submit(self._do, call))

    def _do(self, call: Callable[[], object]) -> None:
        if self._error is None:
            try:
                call()
            except BaseException as error:  # pa.ArrowException is no OSError; the simulation's thread raises it
                self._error = error

    def wait(self) -> None:
        """Wait until everything is done."""
        while self._pending:
            self._pending.popleft().result()
        self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """Drop what has not begun, wait for the rest, and end the thread."""
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)
            self._pending.clear()
