"""How does a node hold its ends of the links that cross to others? Opened once, back whenever the peer is.

An end hands in what it hears as payloads, a protocol unit each, and is told what to send; it never waits.
"""

from __future__ import annotations

import asyncio
from typing import Final, Protocol

from skyrange.io.ends import is_loopback
from skyrange.io.http_ends import HttpClientEnd, HttpServerEnd
from skyrange.io.mavlink_sockets import OnPiece, TcpEnd, UdpEnd, serve_tcp
from skyrange.io.zmq_sockets import Counts as ZmqCounts
from skyrange.io.zmq_sockets import ZmqEnd
from skyrange.runtime.live.addresses import Crossing
from skyrange.runtime.live.passes import Passes

MOST_BYTES: Final = {"oracle": 1 << 20}
"""Of a message over ZeroMQ, by kind of link: what ground receivers heard in a step, as JSON, is the longest."""
USUAL_BYTES: Final = 1 << 12
"""Of any other kind: a Remote ID message pack with its header has 300, a MAVLink frame 280."""
QUEUE: Final = 256
AGAIN_S: Final = 0.2
"""Between two attempts to reach a peer that is not there."""


class End(Protocol):
    """One side of one crossing."""

    def send(self, payload: bytes) -> bool:
        """Say a payload; False where nobody is there to hear it, or too much waits already."""
        ...

    def close(self) -> None:
        """Give the socket back."""
        ...

    @property
    def refused(self) -> int:
        """Connections and requests that were not let in."""
        ...


async def listening(crossing: Crossing, piece: OnPiece, host: str, passes: Passes) -> End:
    """The end that waits at the crossing's address, on the machine `host`. `OSError` where that is taken."""
    if crossing.transport == "udp":
        return _Udp(await UdpEnd.open(piece, crossing.address))
    if crossing.transport == "tcp":
        return await _TcpServer.open(piece, crossing.address)
    if crossing.transport == "zmq":
        keys = None if is_loopback(crossing.address[0]) else passes.links
        end = await ZmqEnd.bind(piece, crossing.address, keys=keys, max_bytes=_most(crossing), queue=QUEUE)
        return _Counted(end)
    token = None if is_loopback(crossing.address[0]) else passes.token
    return _Counted(await HttpServerEnd.open(piece, crossing.address, token=token))


async def calling(crossing: Crossing, piece: OnPiece, host: str, passes: Passes) -> End:
    """The end that goes from `host` to the crossing's address, now or as soon as somebody is there."""
    if crossing.transport == "udp":
        own = crossing.address[0] if is_loopback(crossing.address[0]) else host
        return _Udp(await UdpEnd.open(piece, (own, 0), remote=crossing.address))
    if crossing.transport == "tcp":
        return _TcpCaller(piece, crossing.address)
    if crossing.transport == "zmq":
        keys = None if is_loopback(crossing.address[0]) else passes.links
        end = await ZmqEnd.connect(piece, crossing.address, keys=keys, max_bytes=_most(crossing), queue=QUEUE)
        return _Counted(end)
    token = None if is_loopback(crossing.address[0]) else passes.token
    return _Counted(await HttpClientEnd.open(piece, crossing.address, token=token))


def _most(crossing: Crossing) -> int:
    return MOST_BYTES.get(crossing.link.name.partition(":")[0], USUAL_BYTES)


class _Udp:
    """Lets everybody in."""

    refused = 0

    def __init__(self, end: UdpEnd) -> None:
        self.send, self.close = end.send, end.close


class _Counted:
    """An end that counts by itself whom it does not let in."""

    def __init__(self, end: ZmqEnd | HttpServerEnd | HttpClientEnd) -> None:
        self.send, self.close = end.send, end.close
        self._end = end

    @property
    def refused(self) -> int:
        """See `End`."""
        counts = self._end.counts
        return counts.refused + (0 if isinstance(counts, ZmqCounts) else counts.garbage + counts.overflowed)


class _Refusal(asyncio.Protocol):
    """Ends a connection before a byte is read."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        transport.abort()  # type: ignore[attr-defined]


class _TcpServer:
    """Listens for one peer, as SITL's serial ports do: while the one there lives, another is refused.

    (SITL leaves it waiting; mavlink-router lets all in, each an endpoint of its own.) Who has not spoken MAVLink yet
    gives way, so that a port scan that came first does not keep the peer out; a peer whose machine died is noticed by
    its silence on TCP.
    """

    def __init__(self, piece: OnPiece) -> None:
        self.refused = 0
        self._piece = piece
        self._server: asyncio.Server | None = None
        self._peer: TcpEnd | None = None

    @classmethod
    async def open(cls, piece: OnPiece, address: tuple[str, int]) -> _TcpServer:
        made = cls(piece)
        made._server, _ = await serve_tcp(made._accept, address)
        return made

    def _accept(self) -> asyncio.BaseProtocol:
        if self._peer is not None and not self._peer.lost.done():
            if self._peer.counts.frames:
                self.refused += 1
                return _Refusal()
            self._peer.close()
        self._peer = TcpEnd(self._piece)
        return self._peer

    def send(self, payload: bytes) -> bool:
        """See `End`."""
        return self._peer is not None and self._peer.send(payload)

    def close(self) -> None:
        """See `End`."""
        if self._server is not None:
            self._server.close()
        if self._peer is not None:
            self._peer.close()


class _TcpCaller:
    """Connects, and again whenever the connection is lost."""

    refused = 0

    def __init__(self, piece: OnPiece, address: tuple[str, int]) -> None:
        self._peer: TcpEnd | None = None
        self._task = asyncio.get_running_loop().create_task(self._keep(piece, address))

    async def _keep(self, piece: OnPiece, address: tuple[str, int]) -> None:
        while True:
            try:
                peer = await TcpEnd.connect(piece, address)
            except OSError:
                await asyncio.sleep(AGAIN_S)
                continue
            self._peer = peer
            await peer.lost
            self._peer = None
            await asyncio.sleep(AGAIN_S)  # one that refuses is not asked all the time

    def send(self, payload: bytes) -> bool:
        """See `End`."""
        return self._peer is not None and self._peer.send(payload)

    def close(self) -> None:
        """See `End`."""
        self._task.cancel()
        if self._peer is not None:
            self._peer.close()
