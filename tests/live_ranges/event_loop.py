"""Event loop in virtual time: when every task waits, its clock advances to the next timer."""

from __future__ import annotations

import asyncio
import math
import selectors
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from skyrange.core.time import NS_PER_S

BEGIN_NS: Final = 1_000 * NS_PER_S
"""The initial virtual time; not 0, which stands for an unset time."""


class DeadlockError(RuntimeError):
    """Every task waits, and there is no timer, so nothing will ever happen again."""


@dataclass(slots=True)
class VirtualTime:
    """The time of one virtual world, in nanoseconds."""

    now_ns: int = BEGIN_NS


class _VirtualSelector(selectors.DefaultSelector):
    """Polls real files without waiting; instead of waiting it advances virtual time."""

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
    """An event loop on a `VirtualTime`, in which `asyncio.sleep`, timers and timeouts pass.

    Threads and sockets of the system work, but the loop does not wait for them.
    """

    def __init__(self, virtual: VirtualTime) -> None:
        self._virtual = virtual
        super().__init__(_VirtualSelector(self._advance))

    def time(self) -> float:
        """Seconds of virtual time."""
        return self._virtual.now_ns / NS_PER_S

    def _advance(self, seconds: float) -> None:
        self._virtual.now_ns += max(math.ceil(seconds * NS_PER_S), 1)
