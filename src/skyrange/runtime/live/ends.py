"""How does a node hold its ends of the links that cross to others? Opened once, back whenever the peer is.

An end hands in what it hears as payloads, a protocol unit each, and is told what to send; it never waits.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final, Protocol

from skyrange.codec.deframe import Piece
from skyrange.io.ends import is_loopback
from skyrange.io.http_ends import HttpClientEnd, HttpServerEnd
from skyrange.io.mavlink_sockets import TcpEnd, UdpEnd, serve_tcp
from skyrange.io.zmq_sockets import ZmqEnd
from skyrange.runtime.live.addresses import Crossing
from skyrange.runtime.live.passes import Passes

OnPayload = Callable[[bytes], None]
MAX_BYTES: Final = 1 << 20
"""Of a message over ZeroMQ: what ground receivers heard in a step, as JSON, is the longest."""
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


async def listening(crossing: Crossing, heard: OnPayload, host: str, passes: Passes) -> End:
    """The end that waits at the crossing's address, on the machine `host`. `OSError` where that is taken."""

    def piece(one: Piece) -> None:
        heard(one.data)

    if crossing.transport == "udp":
        return await UdpEnd.open(piece, crossing.address)
    if crossing.transport == "tcp":
        return await _TcpServer.open(piece, crossing.address)
    if crossing.transport == "zmq":
        keys = None if is_loopback(crossing.address[0]) else passes.links
        return await ZmqEnd.bind(piece, crossing.address, keys=keys, max_bytes=MAX_BYTES, queue=QUEUE)
    token = None if is_loopback(crossing.address[0]) else passes.token
    return await HttpServerEnd.open(piece, crossing.address, token=token)


async def calling(crossing: Crossing, heard: OnPayload, host: str, passes: Passes) -> End:
    """The end that goes from `host` to the crossing's address, now or as soon as somebody is there."""

    def piece(one: Piece) -> None:
        heard(one.data)

    if crossing.transport == "udp":
        own = crossing.address[0] if is_loopback(crossing.address[0]) else host
        return await UdpEnd.open(piece, (own, 0), remote=crossing.address)
    if crossing.transport == "tcp":
        return _TcpCaller(piece, crossing.address)
    if crossing.transport == "zmq":
        keys = None if is_loopback(crossing.address[0]) else passes.links
        return await ZmqEnd.connect(piece, crossing.address, keys=keys, max_bytes=MAX_BYTES, queue=QUEUE)
    token = None if is_loopback(crossing.address[0]) else passes.token
    return await HttpClientEnd.open(piece, crossing.address, token=token)


class _TcpServer:
    """Listens for one peer; a later one takes the place of the one before, as with SITL's serial ports."""

    def __init__(self, piece: Callable[[Piece], None]) -> None:
        self._piece = piece
        self._server: asyncio.Server | None = None
        self._peer: TcpEnd | None = None

    @classmethod
    async def open(cls, piece: Callable[[Piece], None], address: tuple[str, int]) -> _TcpServer:
        made = cls(piece)
        made._server, _ = await serve_tcp(made._accept, address)
        return made

    def _accept(self) -> TcpEnd:
        if self._peer is not None:
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

    def __init__(self, piece: Callable[[Piece], None], address: tuple[str, int]) -> None:
        self._peer: TcpEnd | None = None
        self._task = asyncio.get_running_loop().create_task(self._keep(piece, address))

    async def _keep(self, piece: Callable[[Piece], None], address: tuple[str, int]) -> None:
        while True:
            try:
                peer = await TcpEnd.connect(piece, address)
            except OSError:
                await asyncio.sleep(AGAIN_S)
                continue
            self._peer = peer
            await peer.lost
            self._peer = None

    def send(self, payload: bytes) -> bool:
        """See `End`."""
        return self._peer is not None and self._peer.send(payload)

    def close(self) -> None:
        """See `End`."""
        self._task.cancel()
        if self._peer is not None:
            self._peer.close()
