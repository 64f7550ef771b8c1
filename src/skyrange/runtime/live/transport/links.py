"""Transports of the links between nodes: UDP, TCP, ZeroMQ or HTTP, reconnected whenever the peer is back.

A transport hands over what it receives as payloads, one protocol unit each, and never waits.
"""

from __future__ import annotations

import asyncio
from typing import Final, Protocol

from skyrange.io.addresses import is_loopback
from skyrange.io.http.transports import HttpClientTransport, HttpServerTransport
from skyrange.io.limited_listener import LimitedListener
from skyrange.io.mavlink.transports import OnPiece, TcpTransport, UdpTransport, listen_tcp
from skyrange.io.zeromq.transport import Counts as ZmqCounts
from skyrange.io.zeromq.transport import ZmqTransport
from skyrange.runtime.live.transport.addresses import Credentials, Crossing

MAX_BYTES: Final = {"oracle": 1 << 20, "scan": 1 << 21}
"""Longest message over ZeroMQ by kind of link: receptions of ground receivers as JSON; a scan of a million pulses."""
USUAL_MAX_BYTES: Final = 1 << 12
"""Of every other kind: a Remote ID message pack with its header has 300, a MAVLink frame 280."""
QUEUES: Final = {"scan": 16}
"""Messages that may wait for a ZeroMQ peer by kind of link: nobody needs the scans of a second ago."""
USUAL_QUEUE: Final = 256
"""Of every other kind."""
RECONNECT_S: Final = 0.2
"""Between two attempts to reach a TCP peer."""


class Transport(Protocol):
    """One side of one link between two nodes."""

    def send(self, payload: bytes) -> bool:
        """Send a payload; False where no peer is there to receive it, or too much waits already."""
        ...

    def close(self) -> None:
        """Give the socket back."""
        ...

    @property
    def refused(self) -> int:
        """Connections and requests that were not let in."""
        ...


async def listen(crossing: Crossing, on_piece: OnPiece, host: str, credentials: Credentials) -> Transport:
    """The transport that waits at the link's address, on the machine `host`. `OSError` where the address is taken."""
    if crossing.transport == "udp":
        return _Udp(await UdpTransport.open(on_piece, crossing.address))
    if crossing.transport == "tcp":
        return await TcpListener.open(on_piece, crossing.address)
    if crossing.transport == "zmq":
        keys = None if is_loopback(crossing.address[0]) else credentials.links
        end = await ZmqTransport.bind(
            on_piece, crossing.address, keys=keys, max_bytes=_max_bytes(crossing), queue=_queue(crossing)
        )
        return _Counted(end)
    token = None if is_loopback(crossing.address[0]) else credentials.token
    return _Counted(await HttpServerTransport.open(on_piece, crossing.address, token=token))


async def connect(crossing: Crossing, on_piece: OnPiece, host: str, credentials: Credentials) -> Transport:
    """The transport that connects from `host` to the link's address, now or as soon as somebody is there."""
    if crossing.transport == "udp":
        local_host = crossing.address[0] if is_loopback(crossing.address[0]) else host
        return _Udp(await UdpTransport.open(on_piece, (local_host, 0), remote=crossing.address))
    if crossing.transport == "tcp":
        return TcpConnector(on_piece, crossing.address)
    if crossing.transport == "zmq":
        keys = None if is_loopback(crossing.address[0]) else credentials.links
        end = await ZmqTransport.connect(
            on_piece, crossing.address, keys=keys, max_bytes=_max_bytes(crossing), queue=_queue(crossing)
        )
        return _Counted(end)
    token = None if is_loopback(crossing.address[0]) else credentials.token
    return _Counted(await HttpClientTransport.open(on_piece, crossing.address, token=token))


def _max_bytes(crossing: Crossing) -> int:
    return MAX_BYTES.get(crossing.link.name.partition(":")[0], USUAL_MAX_BYTES)


def _queue(crossing: Crossing) -> int:
    return QUEUES.get(crossing.link.name.partition(":")[0], USUAL_QUEUE)


class _Udp:
    """Refuses nobody."""

    refused = 0

    def __init__(self, end: UdpTransport) -> None:
        self.send, self.close = end.send, end.close


class _Counted:
    """A transport that counts itself whom it does not let in."""

    def __init__(self, end: ZmqTransport | HttpServerTransport | HttpClientTransport) -> None:
        self.send, self.close = end.send, end.close
        self._end = end

    @property
    def refused(self) -> int:
        """See `Transport`."""
        counts = self._end.counts
        return counts.refused + (0 if isinstance(counts, ZmqCounts) else counts.garbage + counts.overflowed)


class _RefusedConnection(asyncio.Protocol):
    """Ends a connection before a byte is read."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        transport.abort()  # type: ignore[attr-defined]


class TcpListener:
    """Listens for one TCP peer, as SITL's serial ports do: while that one is connected, another is refused.

    (SITL leaves it waiting; mavlink-router lets all in, each an endpoint of its own.) A peer that has not sent MAVLink
    yet gives way, so that a port scan that came first does not keep the right peer out; a peer whose machine died is
    noticed by its silence on TCP.
    """

    def __init__(self, on_piece: OnPiece) -> None:
        """Called by `open`."""
        self.refused = 0
        self._on_piece = on_piece
        self._server: LimitedListener | None = None
        self._peer: TcpTransport | None = None

    @classmethod
    async def open(cls, on_piece: OnPiece, address: tuple[str, int]) -> TcpListener:
        """Listen at `address`; `OSError` where it is taken."""
        made = cls(on_piece)
        made._server, _ = await listen_tcp(made._accept, address)
        return made

    def _accept(self) -> asyncio.BaseProtocol:
        if self._peer is not None and not self._peer.lost.done():
            if self._peer.counts.frames:
                self.refused += 1
                return _RefusedConnection()
            self._peer.abort()  # not `close`, which would wait until it has read
        self._peer = TcpTransport(self._on_piece)
        return self._peer

    def send(self, payload: bytes) -> bool:
        """See `Transport`."""
        return self._peer is not None and self._peer.send(payload)

    def close(self) -> None:
        """See `Transport`."""
        if self._server is not None:
            self._server.close()
        if self._peer is not None:
            self._peer.close()


class TcpConnector:
    """Connects to a TCP peer, and again whenever the connection is lost."""

    refused = 0

    def __init__(self, on_piece: OnPiece, address: tuple[str, int]) -> None:
        """Begin to connect, in the running event loop."""
        self._peer: TcpTransport | None = None
        self._task = asyncio.get_running_loop().create_task(self._keep_connected(on_piece, address))

    async def _keep_connected(self, on_piece: OnPiece, address: tuple[str, int]) -> None:
        while True:
            try:
                peer = await TcpTransport.connect(on_piece, address)
            except OSError:
                await asyncio.sleep(RECONNECT_S)
                continue
            self._peer = peer
            await peer.lost
            self._peer = None
            await asyncio.sleep(RECONNECT_S)  # a peer that refuses is not asked all the time

    def send(self, payload: bytes) -> bool:
        """See `Transport`."""
        return self._peer is not None and self._peer.send(payload)

    def close(self) -> None:
        """See `Transport`."""
        self._task.cancel()
        if self._peer is not None:
            self._peer.close()
