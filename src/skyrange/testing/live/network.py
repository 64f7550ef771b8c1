"""Network in memory: streams, datagrams and Unix sockets of an event loop, each delivered after a latency.

`SocketEventLoop` has asyncio's own interface, so what runs on it (`asyncio.start_server`, the transports of a node, a
tap's socket) is what runs on a real socket. Machines have addresses, and a loopback of their own.
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
from pathlib import Path
from typing import Any, Final, cast

from skyrange.io.ends import is_loopback
from skyrange.testing.live.event_loop import VirtualEventLoop, VirtualTime
from skyrange.testing.live.processes import CURRENT, VirtualProcess, create_task

Address = tuple[str, int]
Key = tuple[str, str, int]
"""Of a listener: family, machine or address, port."""
FIRST_PORT: Final = 40_000
"""Of those that are handed out for port 0."""
HIGH_WATER: Final = 1 << 16
CONNECT_S: Final = 3.0
"""After so long a machine that does not answer counts as unreachable."""


@dataclass(slots=True)
class VirtualNetwork:
    """What all machines of a virtual world are connected by."""

    latency_s: float = 1e-4
    """Of everything that is sent."""
    jitter_s: float = 0.0
    """Mean of what comes on top of it, exponentially distributed; order is kept."""
    seed: int = 0
    cut: set[str] = field(default_factory=set)
    """Machines whose network is down."""
    listeners: dict[Key, Any] = field(default_factory=dict)
    connectors: dict[Key, list[Any]] = field(default_factory=dict)
    """Ends of links that go to a listener, whether one is there or not."""
    _random: random.Random = field(default_factory=random.Random)
    _port: int = FIRST_PORT

    def __post_init__(self) -> None:
        self._random.seed(self.seed)

    def delay_s(self) -> float:
        """How long the next thing takes."""
        return self.latency_s + (self._random.expovariate(1.0 / self.jitter_s) if self.jitter_s else 0.0)

    def key(self, family: str, machine: str, address: Address) -> Key:
        """By what a listener at `address` is found from `machine`."""
        host, port = address
        return (family, machine if is_loopback(host) else f"@{host}", port)

    def reaches(self, one: str, other: str) -> bool:
        """Whether two machines hear each other."""
        return one == other or not {one, other} & self.cut

    def free_port(self) -> int:
        """A port that nobody has."""
        self._port += 1
        return self._port

    def bind(self, family: str, machine: str, address: Address, listener: Any) -> Address:
        """Have `listener` be found at `address`, port 0: a free one. `OSError` where it is taken."""
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
        """Have it be found no more."""
        for key in [key for key, other in self.listeners.items() if other is listener]:
            del self.listeners[key]


@dataclass(slots=True)
class Owner:
    """Whose a socket is: process, machine, and the context in which its callbacks run."""

    process: VirtualProcess | None
    machine: str
    context: Context

    @classmethod
    def current(cls) -> Owner:
        """That of the code that runs."""
        process = CURRENT.get()
        return cls(process, process.machine if process is not None else "", copy_context())

    def opened(self, socket: Any) -> None:
        """Have a socket be closed when the process ends."""
        if self.process is not None:
            self.process.sockets.append(socket)

    def closed(self, socket: Any) -> None:
        """The socket is closed already."""
        if self.process is not None and socket in self.process.sockets:
            self.process.sockets.remove(socket)


class Pipe:
    """Calls on their way to one owner, in order; a process that is paused gets them when it goes on."""

    def __init__(self, network: VirtualNetwork, owner: Owner) -> None:
        self._network = network
        self._owner = owner
        self._waiting: deque[tuple[float, Callable[[], None]]] = deque()
        self._scheduled = False

    def push(self, call: Callable[[], None], delay_s: float | None = None) -> None:
        """Call `call` after the network's latency, and after all that was pushed before."""
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


class _Socket:
    """What asyncio's transports tell of their sockets."""

    def __init__(self, address: Any) -> None:
        self._address = address

    def getsockname(self) -> Any:
        return self._address

    def setsockopt(self, *_: object) -> None:
        """Nothing to set."""


class MemoryStream(asyncio.Transport):
    """One end of a connection."""

    def __init__(self, network: VirtualNetwork, owner: Owner, own: Any, other: Any) -> None:
        super().__init__({"socket": _Socket(own), "sockname": own, "peername": other})
        self._network = network
        self._owner = owner
        self._protocol = asyncio.Protocol()
        self._inbound = Pipe(network, owner)
        self._peer: MemoryStream | None = None
        self._unsent: deque[bytes | None] = deque()
        """What the peer has not taken; `None` is the end."""
        self._size = 0
        self._closing = False
        self._lost = False
        self._reading = True
        self._high, self._low = HIGH_WATER, HIGH_WATER // 4
        self._held_back = False
        owner.opened(self)

    def join(self, peer: MemoryStream) -> None:
        """Connect the two ends."""
        self._peer, peer._peer = peer, self

    def begin(self, factory: Callable[[], asyncio.BaseProtocol]) -> None:
        """Make the protocol, and tell it that it is connected."""
        if not self._lost:
            self._protocol = cast("asyncio.Protocol", factory())
            self._protocol.connection_made(self)

    # --- asyncio's interface -----------------------------------------------------------------------

    def get_protocol(self) -> asyncio.BaseProtocol:
        """See asyncio."""
        return self._protocol

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """See asyncio."""
        self._protocol = cast("asyncio.Protocol", protocol)

    def is_closing(self) -> bool:
        """See asyncio."""
        return self._closing

    def is_reading(self) -> bool:
        """See asyncio."""
        return self._reading

    def pause_reading(self) -> None:
        """See asyncio."""
        self._reading = False

    def resume_reading(self) -> None:
        """See asyncio."""
        if not self._reading:
            self._reading = True
            if self._peer is not None:
                self._inbound.push(self._peer._hand_over)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """See asyncio."""
        self._high = HIGH_WATER if high is None else high
        self._low = self._high // 4 if low is None else low

    def get_write_buffer_size(self) -> int:
        """See asyncio."""
        return self._size

    def can_write_eof(self) -> bool:
        """See asyncio."""
        return True

    def write(self, data: Any) -> None:
        """See asyncio."""
        if self._closing or not data:
            return
        self._put(bytes(data))
        if self._size > self._high and not self._held_back:
            self._held_back = True
            self._protocol.pause_writing()

    def write_eof(self) -> None:
        """See asyncio."""
        if not self._closing:
            self._put(None)

    def close(self) -> None:
        """See asyncio."""
        if not self._closing:
            self._closing = True
            self._put(None)
            if not self._unsent:
                self._lose(None)

    def abort(self) -> None:
        """See asyncio."""
        self._reset(ConnectionResetError(errno.ECONNRESET, "connection reset by peer"))
        self._lose(None)

    def kill(self) -> None:
        """Its process is gone: what was sent arrives, then the end."""
        self._put(None)
        self._closing = self._lost = True
        self._owner.closed(self)

    def cut(self) -> None:
        """End the connection for both, as a reset on the way does; what was on the way is lost."""
        if not self._lost:
            error = ConnectionResetError(errno.ECONNRESET, "connection reset by peer")
            self._reset(error)
            self._inbound.push(lambda: self._lose(error), 0.0)

    # --- what is on the way ------------------------------------------------------------------------

    def _put(self, data: bytes | None) -> None:
        peer = self._peer
        if self._lost or peer is None:
            return
        self._unsent.append(data)
        self._size += len(data or b"")
        peer._inbound.push(self._hand_over)

    def _hand_over(self) -> None:
        """Have the peer take what there is, as far as it reads."""
        peer = self._peer
        assert peer is not None
        if not self._network.reaches(self._owner.machine, peer._owner.machine):
            return
        if peer._lost:
            reset = any(self._unsent) and not self._closing  # nobody there takes it
            self._unsent.clear()
            self._size = 0
            error = ConnectionResetError(errno.ECONNRESET, "connection reset by peer")
            self._inbound.push((lambda: self._lose(error)) if reset else self._after_sending)
            return
        while self._unsent and peer._reading and not peer._lost:
            data = self._unsent.popleft()
            if data is None:
                if not peer._protocol.eof_received():
                    peer.close()
                continue
            self._size -= len(data)
            peer._protocol.data_received(data)
        self._inbound.push(self._after_sending, 0.0)

    def _after_sending(self) -> None:
        if self._lost:
            return
        if self._held_back and self._size <= self._low:
            self._held_back = False
            self._protocol.resume_writing()
        if self._closing and not self._unsent:
            self._lose(None)

    def _reset(self, error: Exception) -> None:
        self._unsent.clear()
        self._size = 0
        peer = self._peer
        if peer is not None and not peer._lost:
            peer._inbound.push(lambda: peer._lose(error))

    def _lose(self, error: Exception | None) -> None:
        if not self._lost:
            self._lost = self._closing = True
            self._owner.closed(self)
            self._owner.context.copy().run(self._protocol.connection_lost, error)


class MemoryServer:
    """Listens for streams, as `asyncio.Server` does."""

    def __init__(self, network: VirtualNetwork, factory: Callable[[], asyncio.BaseProtocol]) -> None:
        self._network = network
        self._owner = Owner.current()
        self._factory = factory
        self._serving = True
        self.streams: list[MemoryStream] = []
        """All that were accepted."""
        self.sockets: list[_Socket] = []
        self._owner.opened(self)

    @property
    def owner(self) -> Owner:
        """Whose it is."""
        return self._owner

    def named(self, address: Any) -> MemoryServer:
        """Have it say that it is bound to `address`."""
        self.sockets = [_Socket(address)]
        return self

    def accept(self, other: MemoryStream, address: Any) -> None:
        """Make the server's end of a new connection."""
        stream = MemoryStream(self._network, self._owner, self.sockets[0].getsockname(), address)
        stream.join(other)
        stream._inbound.push(lambda: stream.begin(self._factory))
        self.streams.append(stream)

    def is_serving(self) -> bool:
        """See asyncio."""
        return self._serving

    def close(self) -> None:
        """See asyncio."""
        self._serving = False
        self._network.release(self)
        self._owner.closed(self)

    kill = close

    async def wait_closed(self) -> None:
        """See asyncio."""


class MemoryDatagrams(asyncio.DatagramTransport):
    """A UDP socket."""

    def __init__(self, network: VirtualNetwork, protocol: asyncio.DatagramProtocol) -> None:
        super().__init__()
        self._network = network
        self._owner = Owner.current()
        self._protocol = protocol
        self._inbound = Pipe(network, self._owner)
        self._closing = False
        self._address: Address = ("", 0)
        self._owner.opened(self)

    def begin(self, address: Address) -> None:
        """It is bound to `address`."""
        self._address = address
        self._extra = {"sockname": address, "socket": _Socket(address)}
        self._protocol.connection_made(self)

    def is_closing(self) -> bool:
        """See asyncio."""
        return self._closing

    def sendto(self, data: Any, addr: Any = None) -> None:
        """See asyncio."""
        if self._closing:
            return
        network = self._network
        other = network.listeners.get(network.key("udp", self._owner.machine, addr))
        if other is not None and network.reaches(self._owner.machine, other._owner.machine):
            payload = bytes(data)
            other._inbound.push(lambda: other._receive(payload, self._address))

    def _receive(self, data: bytes, sender: Address) -> None:
        if not self._closing:
            self._protocol.datagram_received(data, sender)

    def close(self) -> None:
        """See asyncio."""
        if not self._closing:
            self.kill()
            asyncio.get_running_loop().call_soon(self._protocol.connection_lost, None)

    def abort(self) -> None:
        """See asyncio."""
        self.close()

    def kill(self) -> None:
        """Its process is gone."""
        self._closing = True
        self._network.release(self)
        self._owner.closed(self)


class SocketEventLoop(VirtualEventLoop):
    """A `VirtualEventLoop` whose sockets are in a `VirtualNetwork`."""

    def __init__(self, virtual: VirtualTime, network: VirtualNetwork) -> None:
        super().__init__(virtual)
        self._network = network
        self.set_task_factory(create_task)

    async def create_server(self, protocol_factory: Any, host: Any = None, port: Any = None, **_: Any) -> Any:
        """See asyncio; TCP."""
        server = MemoryServer(self._network, protocol_factory)
        return server.named(self._network.bind("tcp", server.owner.machine, (host, port), server))

    async def create_connection(self, protocol_factory: Any, host: Any = None, port: Any = None, **_: Any) -> Any:
        """See asyncio; TCP."""
        owner = Owner.current()
        own = (host if is_loopback(host) else owner.machine, self._network.free_port())
        return await self._connect(protocol_factory, self._network.key("tcp", owner.machine, (host, port)), own)

    async def create_unix_server(self, protocol_factory: Any, path: Any = None, **_: Any) -> Any:
        """See asyncio."""
        real = Path(os.path.realpath(path))
        server = MemoryServer(self._network, protocol_factory)
        os.close(os.open(real, os.O_CREAT | os.O_WRONLY, 0o777))
        self._network.listeners["unix", str(real), 0] = server
        return server.named(str(path))

    async def create_unix_connection(self, protocol_factory: Any, path: Any = None, **_: Any) -> Any:
        """See asyncio."""
        return await self._connect(protocol_factory, ("unix", os.path.realpath(path), 0), "")

    async def _connect(self, factory: Callable[[], asyncio.BaseProtocol], key: Key, own: Any) -> Any:
        owner = Owner.current()
        await asyncio.sleep(self._network.delay_s())
        server: MemoryServer | None = self._network.listeners.get(key)
        if server is None:
            raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED).lower())
        if not self._network.reaches(owner.machine, server.owner.machine):
            await asyncio.sleep(CONNECT_S)
            raise OSError(errno.EHOSTUNREACH, os.strerror(errno.EHOSTUNREACH).lower())
        stream = MemoryStream(self._network, owner, own, server.sockets[0].getsockname())
        server.accept(stream, own)
        stream.begin(factory)
        return stream, stream.get_protocol()

    async def create_datagram_endpoint(
        self, protocol_factory: Any, local_addr: Any = None, remote_addr: Any = None, **_: Any
    ) -> Any:
        """See asyncio; not connected."""
        transport = MemoryDatagrams(self._network, protocol_factory())
        transport.begin(self._network.bind("udp", transport._owner.machine, local_addr, transport))
        return transport, transport._protocol
