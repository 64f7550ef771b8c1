"""Sockets in memory: streams, datagrams and Unix sockets of an event loop, delivered by a virtual network.

`SocketEventLoop` has asyncio's own interface, so the same code runs on it as on real sockets: the transports of a node,
a tap's socket. Listeners with a limit accept real sockets themselves, so `listen` and `listen_unix` of
`skyrange.io.limited_listener` are replaced, for those that run on such a loop, wherever they were imported.
"""

from __future__ import annotations

import asyncio
import errno
import os
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, cast

from skyrange.io import limited_listener
from skyrange.io.addresses import is_loopback
from tests.live_ranges.event_loop import VirtualEventLoop, VirtualTime
from tests.live_ranges.network import Address, Key, Owner, Pipe, VirtualNetwork
from tests.live_ranges.processes import create_task

HIGH_WATER: Final = 1 << 16
"""Default limit of a stream's write buffer, in bytes, above which the writer is paused."""
CONNECT_S: Final = 3.0
"""Seconds after which an attempt to connect to an unreachable machine fails."""


class _Socket:
    """The socket of a transport, as far as asyncio's users ask for it."""

    def __init__(self, address: Any) -> None:
        self._address = address

    def getsockname(self) -> Any:
        return self._address

    def setsockopt(self, *_: object) -> None:
        """Does nothing."""


class MemoryStream(asyncio.Transport):
    """One side of a connection."""

    def __init__(self, network: VirtualNetwork, owner: Owner, own: Any, other: Any) -> None:
        super().__init__({"socket": _Socket(own), "sockname": own, "peername": other})
        self._network = network
        self._owner = owner
        self._protocol = asyncio.Protocol()
        self._inbound = Pipe(network, owner)
        self._peer: MemoryStream | None = None
        self._unsent: deque[bytes | None] = deque()
        """Data that the peer has not received yet; `None` is the end of the stream."""
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
        """Make the protocol and call its `connection_made`."""
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
        """Close it for a process that was killed: what was sent arrives, then the end of the stream."""
        self._put(None)
        self._closing = self._lost = True
        self._owner.closed(self)

    def cut(self) -> None:
        """Reset the connection for both sides; data in transit is lost."""
        if not self._lost:
            error = ConnectionResetError(errno.ECONNRESET, "connection reset by peer")
            self._reset(error)
            self._inbound.push(lambda: self._lose(error), 0.0)

    # --- data in transit ---------------------------------------------------------------------------

    def _put(self, data: bytes | None) -> None:
        peer = self._peer
        if self._lost or peer is None:
            return
        self._unsent.append(data)
        self._size += len(data or b"")
        peer._inbound.push(self._hand_over)

    def _hand_over(self) -> None:
        """Deliver to the peer what is there, as far as it reads."""
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
    """Listens for connections, as `asyncio.Server` does."""

    def __init__(self, network: VirtualNetwork, factory: Callable[[], asyncio.BaseProtocol]) -> None:
        self._network = network
        self._owner = Owner.current()
        self._factory = factory
        self._serving = True
        self.streams: list[MemoryStream] = []
        """The server's side of all accepted connections."""
        self.sockets: list[_Socket] = []
        self._owner.opened(self)

    @property
    def owner(self) -> Owner:
        """The owner of the server."""
        return self._owner

    def named(self, address: Any) -> MemoryServer:
        """Set the address that it reports."""
        self.sockets = [_Socket(address)]
        return self

    displaced = 0
    """See `LimitedListener`; nothing is displaced here."""

    @property
    def address(self) -> Any:
        """See `LimitedListener`."""
        return self.sockets[0].getsockname()

    @property
    def is_open(self) -> bool:
        """See `LimitedListener`."""
        return self._serving

    def accept(self, other: MemoryStream, address: Any) -> None:
        """Make the server's side of a new connection."""
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
        """Set the address and call the protocol's `connection_made`."""
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
        """Close it for a process that was killed."""
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

    def listen_unix(self, protocol_factory: Any, path: Any = None) -> MemoryServer:
        """A server at the path of a Unix socket."""
        real = Path(os.path.realpath(path))
        server = MemoryServer(self._network, protocol_factory)
        os.close(os.open(real, os.O_CREAT | os.O_WRONLY, 0o777))
        self._network.listeners["unix", str(real), 0] = server
        return server.named(str(path))

    async def create_unix_server(self, protocol_factory: Any, path: Any = None, **_: Any) -> Any:
        """See asyncio."""
        return self.listen_unix(protocol_factory, path)

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


_listen, _listen_unix = limited_listener.listen, limited_listener.listen_unix


async def listen(factory: Any, host: str, port: int, **options: Any) -> Any:
    """`limited_listener.listen` on real sockets or in memory."""
    loop = asyncio.get_running_loop()
    if isinstance(loop, SocketEventLoop):
        return await loop.create_server(factory, host, port)
    return await _listen(factory, host, port, **options)


def listen_unix(factory: Any, path: str, **options: Any) -> Any:
    """`limited_listener.listen_unix` on a real socket or in memory."""
    loop = asyncio.get_running_loop()
    return (
        loop.listen_unix(factory, path) if isinstance(loop, SocketEventLoop) else _listen_unix(factory, path, **options)
    )


for _module in [module for name, module in sys.modules.items() if name.startswith("skyrange.")]:
    for _name, _usual, _new in (("listen", _listen, listen), ("listen_unix", _listen_unix, listen_unix)):
        if vars(_module).get(_name) is _usual:
            setattr(_module, _name, _new)
