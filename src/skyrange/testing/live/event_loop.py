"""Event loop in virtual time: when every task waits, its clock is set to the next timer."""

from __future__ import annotations

import asyncio
import math
import selectors
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from skyrange.core.time import NS_PER_S

BEGIN_NS: Final = 1_000 * NS_PER_S
"""Where virtual time begins: a monotonic clock that shows 0 is none."""


class DeadlockError(RuntimeError):
    """Every task waits, and there is no timer: nothing will ever happen again."""


@dataclass(slots=True)
class VirtualTime:
    """The present, in nanoseconds; the clock of everything in one virtual world."""

    now_ns: int = BEGIN_NS


class _VirtualSelector(selectors.DefaultSelector):
    """Looks at real files without waiting for them; in place of waiting time passes."""

    def __init__(self, advance: Callable[[float], None]) -> None:
        super().__init__()
        self._advance = advance

    def select(self, timeout: float | None = None) -> list[Any]:
        """See `selectors.BaseSelector`."""
        ready: list[Any] = super().select(0)
        if ready or (timeout is not None and timeout <= 0.0):
            return ready
        if timeout is None:
            raise DeadlockError("every task waits, and there is no timer")
        self._advance(timeout)
        return []


class VirtualEventLoop(asyncio.SelectorEventLoop):
    """An event loop on a `VirtualTime`. `asyncio.sleep`, timers and timeouts are in its time.

    Threads and sockets of the system work, but nothing waits for them.
    """

    def __init__(self, virtual: VirtualTime) -> None:
        self._virtual = virtual
        super().__init__(_VirtualSelector(self._advance))

    def time(self) -> float:
        """Seconds of virtual time."""
        return self._virtual.now_ns / NS_PER_S

    def _advance(self, seconds: float) -> None:
        self._virtual.now_ns += max(math.ceil(seconds * NS_PER_S), 1)
