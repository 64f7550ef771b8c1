"""System interface of a live range: clock, sockets and processes of the machine that a part of the range runs on.

Everything else in `runtime.live` is the same in real time and in virtual time. `RealSystem` is this machine;
`tests.live_ranges` has one with a virtual clock, transports in memory and processes that are tasks.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from skyrange.io.mavlink.transports import Address, OnPiece
from skyrange.io.processes.program import reserve_files
from skyrange.io.zeromq.curve_keys import Keys
from skyrange.runtime.live.clock import Clock, MonotonicClock
from skyrange.runtime.live.config import NodeConfig, start_node
from skyrange.runtime.live.transport.addresses import Credentials, Crossing, check_free, check_own_addresses
from skyrange.runtime.live.transport.control import ControlClient, ControlServer, ZmqControlClient, ZmqControlServer
from skyrange.runtime.live.transport.links import Transport, connect, listen
from skyrange.runtime.warm_up import warm_up
from skyrange.scenario.model.scenario import Scenario

T = TypeVar("T")


class Process(Protocol):
    """A node's process, as whoever started it sees it."""

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        ...

    @property
    def ended(self) -> str:
        """How it ended, such as "exit 1" or "signal SIGKILL"; "" while it runs."""
        ...

    def last_words(self) -> str:
        """The last lines that it printed, "" for none."""
        ...

    def kill(self) -> None:
        """End it now, and wait until it has. Again does nothing."""
        ...


class System(Protocol):
    """What a live range asks of the machine that it runs on."""

    @property
    def clock(self) -> Clock:
        """The machine's monotonic clock."""
        ...

    def run(self, main: Coroutine[Any, Any, T]) -> T:
        """Run `main` in an event loop whose time passes with `clock`; its result."""
        ...

    def check_own_addresses(self, base: str) -> None:
        """Raise `InputError` unless loopback is up and `base` is an address of this machine."""
        ...

    def check_free(self, crossings: Sequence[Crossing]) -> None:
        """Raise `InputError` with every address of links that cannot be had here."""
        ...

    def control_server(self, keys: Keys) -> ControlServer:
        """A supervisor's side of the control channel, not yet open."""
        ...

    def control_client(self, name: str, address: Address, keys: Keys) -> ControlClient:
        """The side of the node or machine `name`, not yet open."""
        ...

    async def listen(self, crossing: Crossing, on_piece: OnPiece, host: str, credentials: Credentials) -> Transport:
        """The transport of a link's listening end, on the machine `host`; `OSError` where its address is taken."""
        ...

    async def connect(self, crossing: Crossing, on_piece: OnPiece, host: str, credentials: Credentials) -> Transport:
        """The transport of a link's other end, from the machine `host`."""
        ...

    def start_node(self, root: Path, config: NodeConfig, through: Sequence[str] = ()) -> Process:
        """Start a node's process in the run's folder `root`, by way of the command `through`."""
        ...

    def warm_up(self, scenario: Scenario, *, rehearse: bool) -> None:
        """Have everything compiled that the scenario's flight needs."""
        ...


class RealSystem:
    """The machine that this process runs on: its clock, its sockets, its processes."""

    def __init__(self) -> None:
        self.clock = MonotonicClock()

    def run(self, main: Coroutine[Any, Any, T]) -> T:
        """See `System`."""
        reserve_files()  # strangers at the sockets shall not take what a process needs
        return asyncio.run(main)

    def check_own_addresses(self, base: str) -> None:
        """See `System`."""
        check_own_addresses(base)

    def check_free(self, crossings: Sequence[Crossing]) -> None:
        """See `System`."""
        check_free(crossings)

    def control_server(self, keys: Keys) -> ControlServer:
        """See `System`."""
        return ZmqControlServer(keys)

    def control_client(self, name: str, address: Address, keys: Keys) -> ControlClient:
        """See `System`."""
        return ZmqControlClient(name, address, keys)

    async def listen(self, crossing: Crossing, on_piece: OnPiece, host: str, credentials: Credentials) -> Transport:
        """See `System`."""
        return await listen(crossing, on_piece, host, credentials)

    async def connect(self, crossing: Crossing, on_piece: OnPiece, host: str, credentials: Credentials) -> Transport:
        """See `System`."""
        return await connect(crossing, on_piece, host, credentials)

    def start_node(self, root: Path, config: NodeConfig, through: Sequence[str] = ()) -> Process:
        """See `System`."""
        return start_node(root, config, through)

    def warm_up(self, scenario: Scenario, *, rehearse: bool) -> None:
        """See `System`."""
        warm_up(scenario, rehearse=rehearse)
