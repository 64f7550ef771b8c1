"""System interface of a live range in virtual time: a virtual clock, memory for sockets, tasks for processes."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from skyrange.io.mavlink.transports import Address, OnPiece
from skyrange.io.zeromq.curve_keys import Keys
from skyrange.runtime.live.config import NodeConfig, write_config
from skyrange.runtime.live.node.process import run_node
from skyrange.runtime.live.transport.addresses import Credentials, Crossing
from skyrange.runtime.live.transport.control import ControlClient, ControlServer
from skyrange.runtime.live.transport.links import Transport, connect, listen
from skyrange.runtime.memory import collect_seldom
from skyrange.scenario.model.scenario import Scenario
from tests.live_ranges.event_loop import VirtualTime
from tests.live_ranges.messages import (
    MemoryControlClient,
    MemoryControlServer,
    MessageConnector,
    MessageListener,
)
from tests.live_ranges.network import VirtualNetwork
from tests.live_ranges.processes import VirtualProcess
from tests.live_ranges.sockets import SocketEventLoop

T = TypeVar("T")
_PPM = 1_000_000


@dataclass(slots=True)
class VirtualClock:
    """A machine's monotonic clock in virtual time, with an offset and a frequency error."""

    virtual: VirtualTime
    ahead_ns: int = 0
    fast_ppm: int = 0

    def monotonic_ns(self) -> int:
        """See `runtime.live.clock.Clock`."""
        now_ns = self.virtual.now_ns
        return now_ns + self.ahead_ns + now_ns * self.fast_ppm // _PPM


@dataclass(slots=True)
class VirtualSystem:
    """A `runtime.live.system.System`: one machine of a virtual world, `machine()` makes others.

    Transports over UDP and TCP are those of `runtime.live` on sockets in memory; ZeroMQ and HTTP are replaced by
    transports of whole messages. Nothing is compiled beforehand, since compilation takes no virtual time.
    """

    virtual: VirtualTime = field(default_factory=VirtualTime)
    network: VirtualNetwork = field(default_factory=VirtualNetwork)
    address: str = ""
    """The machine's address; "" for the one on which the range is started."""
    clock: VirtualClock = field(default=None)  # type: ignore[assignment]
    processes: dict[str, list[VirtualProcess]] = field(default_factory=dict)
    """The processes of each node, by its name, in the order of their starts."""
    start_s: float = 0.0
    """Seconds that a process takes to start."""

    def __post_init__(self) -> None:
        self.clock = self.clock or VirtualClock(self.virtual)

    def machine(self, address: str, *, ahead_ns: int = 0, fast_ppm: int = 0) -> VirtualSystem:
        """Another machine of the same world, with a clock of its own."""
        clock = VirtualClock(self.virtual, ahead_ns, fast_ppm)
        return VirtualSystem(self.virtual, self.network, address, clock, self.processes, self.start_s)

    def process(self, node: str) -> VirtualProcess:
        """The last process of a node."""
        return self.processes[node][-1]

    def run(self, main: Coroutine[Any, Any, T]) -> T:
        """See `System`. Raises `DeadlockError` if every task waits and there is no timer."""
        with (
            collect_seldom(),  # nodes do so themselves, do not end in reverse order, and may be killed
            asyncio.Runner(loop_factory=lambda: SocketEventLoop(self.virtual, self.network)) as runner,
        ):
            return runner.run(main)

    def begin(self, name: str, main: Coroutine[Any, Any, int]) -> VirtualProcess:
        """Run `main`, whose result is the exit code, as a process of this machine."""
        process = VirtualProcess(name, self.address)
        self.processes.setdefault(name, []).append(process)
        process.start(main)
        return process

    def check_own_addresses(self, base: str) -> None:
        """See `System`; every address is this machine's."""

    def check_free(self, crossings: Sequence[Crossing]) -> None:
        """See `System`; every address is free."""

    def control_server(self, keys: Keys) -> ControlServer:
        """See `System`."""
        return MemoryControlServer(self.network, keys)

    def control_client(self, name: str, address: Address, keys: Keys) -> ControlClient:
        """See `System`."""
        return MemoryControlClient(self.network, name, address, keys)

    async def listen(self, crossing: Crossing, on_piece: OnPiece, host: str, credentials: Credentials) -> Transport:
        """See `System`."""
        if crossing.transport in ("udp", "tcp"):
            return await listen(crossing, on_piece, host, credentials)
        return MessageListener(self.network, on_piece, crossing.transport, crossing.address)

    async def connect(self, crossing: Crossing, on_piece: OnPiece, host: str, credentials: Credentials) -> Transport:
        """See `System`."""
        if crossing.transport in ("udp", "tcp"):
            return await connect(crossing, on_piece, host, credentials)
        return MessageConnector(self.network, on_piece, crossing.transport, crossing.address)

    def start_node(self, root: Path, config: NodeConfig, through: Sequence[str] = ()) -> VirtualProcess:
        """See `System`; `through` is ignored."""
        write_config(root, config)
        return self.begin(config.name, self._run_node(root, config))

    async def _run_node(self, root: Path, config: NodeConfig) -> int:
        await asyncio.sleep(self.start_s)
        return await run_node(config, root, self)

    def warm_up(self, scenario: Scenario, *, rehearse: bool) -> None:
        """See `System`."""
