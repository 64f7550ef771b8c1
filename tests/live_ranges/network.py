"""Network in memory: which address belongs to which socket, and the delay of everything that is sent.

Machines have addresses, and a loopback of their own.
"""

from __future__ import annotations

import asyncio
import errno
import os
import random
from collections import deque
from collections.abc import Callable
from contextvars import Context, copy_context
from dataclasses import dataclass, field
from typing import Any, Final

from skyrange.io.addresses import is_loopback
from tests.live_ranges.processes import CURRENT, VirtualProcess

Address = tuple[str, int]
Key = tuple[str, str, int]
"""The key of a listener: family, machine or address, port."""
FIRST_PORT: Final = 40_000
"""The first port that is assigned for port 0."""


@dataclass(slots=True)
class VirtualNetwork:
    """The network that connects all machines of a virtual world."""

    latency_s: float = 1e-4
    """Delay of everything that is sent, in s."""
    jitter_s: float = 0.0
    """Mean of an additional, exponentially distributed delay, in s; the order of messages is kept."""
    seed: int = 0
    cut: set[str] = field(default_factory=set)
    """Machines whose network is down."""
    listeners: dict[Key, Any] = field(default_factory=dict)
    connectors: dict[Key, list[Any]] = field(default_factory=dict)
    """Transports that connect to a listener, whether it exists or not."""
    _random: random.Random = field(default_factory=random.Random)
    _port: int = FIRST_PORT

    def __post_init__(self) -> None:
        self._random.seed(self.seed)

    def delay_s(self) -> float:
        """Draw the delay of the next message, in s."""
        return self.latency_s + (self._random.expovariate(1.0 / self.jitter_s) if self.jitter_s else 0.0)

    def key(self, family: str, machine: str, address: Address) -> Key:
        """The key of the listener at `address`, as seen from `machine`."""
        host, port = address
        return (family, machine if is_loopback(host) else f"@{host}", port)

    def reaches(self, one: str, other: str) -> bool:
        """Whether two machines can communicate."""
        return one == other or not {one, other} & self.cut

    def free_port(self) -> int:
        """A port that is not in use."""
        self._port += 1
        return self._port

    def bind(self, family: str, machine: str, address: Address, listener: Any) -> Address:
        """Register `listener` at `address`, port 0: a free one; the address. Raises `OSError` if it is taken."""
        if address[1] == 0:
            address = (address[0], self.free_port())
        key = self.key(family, machine, address)
        if key in self.listeners:
            raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE).lower())
        self.listeners[key] = listener
        return address

    def cut_connections(self, port: int) -> None:
        """Reset all connections that a TCP server at `port` has accepted."""
        for (family, _, number), server in self.listeners.items():
            if (family, number) == ("tcp", port):
                for stream in server.streams:
                    stream.cut()

    def release(self, listener: Any) -> None:
        """Remove `listener` from all its addresses."""
        for key in [key for key, other in self.listeners.items() if other is listener]:
            del self.listeners[key]


@dataclass(slots=True)
class Owner:
    """The owner of a socket: process, machine, and the context in which its callbacks run."""

    process: VirtualProcess | None
    machine: str
    context: Context

    @classmethod
    def current(cls) -> Owner:
        """The owner of sockets that the running code opens."""
        process = CURRENT.get()
        return cls(process, process.machine if process is not None else "", copy_context())

    def opened(self, socket: Any) -> None:
        """Register a socket, to be closed when the process ends."""
        if self.process is not None:
            self.process.sockets.append(socket)

    def closed(self, socket: Any) -> None:
        """Unregister a socket that is closed."""
        if self.process is not None and socket in self.process.sockets:
            self.process.sockets.remove(socket)


class Pipe:
    """Calls that are delivered to one owner in order; a paused process gets them when it resumes."""

    def __init__(self, network: VirtualNetwork, owner: Owner) -> None:
        self._network = network
        self._owner = owner
        self._waiting: deque[tuple[float, Callable[[], None]]] = deque()
        self._scheduled = False

    def push(self, call: Callable[[], None], delay_s: float | None = None) -> None:
        """Call `call` after the network's delay, or `delay_s`, and after all calls pushed before."""
        loop = asyncio.get_running_loop()
        due = loop.time() + (self._network.delay_s() if delay_s is None else delay_s)
        if self._waiting:
            due = max(due, self._waiting[-1][0])
        self._waiting.append((due, call))
        self._schedule(loop)

    def _schedule(self, loop: asyncio.AbstractEventLoop) -> None:
        if not self._scheduled and self._waiting:
            self._scheduled = True
            loop.call_at(self._waiting[0][0], self._deliver, context=self._owner.context)

    def _deliver(self) -> None:
        process = self._owner.process
        if process is not None and process.paused:
            process.when_resumed(self._deliver)
            return
        self._scheduled = False
        loop = asyncio.get_running_loop()
        now = loop.time() + 1e-9
        while self._waiting and self._waiting[0][0] <= now:
            self._owner.context.copy().run(self._waiting.popleft()[1])
        self._schedule(loop)
