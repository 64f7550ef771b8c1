"""MAVLink transports over UDP and TCP, which deframe what they receive.

Both deliver the same pieces whatever the chunks were: a frame, or a run of bytes that is none.
Each transport is one side of one link and binds to loopback unless told otherwise.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import cast

from skyrange.codec.mavlink.deframer import Deframer, DeframerCounts, Piece
from skyrange.io.limited_listener import LimitedListener, listen

LOOPBACK = "127.0.0.1"
MAX_UNSENT_BYTES = 1 << 18
"""Bytes that wait for a TCP peer that does not read; more are lost, as in a full serial buffer."""
_SILENT_S = 10
"""Seconds after which a TCP peer is taken to be gone whose machine does not answer."""
_PROBES = (("TCP_KEEPIDLE", 4), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3), ("TCP_USER_TIMEOUT", _SILENT_S * 1000))
Address = tuple[str, int]
OnPiece = Callable[[Piece], None]


class UdpTransport(asyncio.DatagramProtocol):
    """One side of a link over UDP.

    Without a `remote` it answers the peer that sent MAVLink last, as a ground station's listening port does. With one
    it keeps sending there, and accepts what any port of the same host sends, as MAVProxy's `udpout` does. A datagram
    is complete: an unfinished frame in it is garbage, never the beginning of the next one.
    """

    def __init__(self, on_piece: OnPiece, remote: Address | None = None) -> None:
        self._on_piece = on_piece
        self._remote = remote
        self._has_remote = remote is not None
        self._transport: asyncio.DatagramTransport | None = None
        self._deframer = Deframer()

    @classmethod
    async def open(
        cls, on_piece: OnPiece, local: Address = (LOOPBACK, 0), remote: Address | None = None
    ) -> UdpTransport:
        """Bind to `local` (port 0: any free one). Raises `OSError` if it is taken."""
        loop = asyncio.get_running_loop()
        _, end = await loop.create_datagram_endpoint(lambda: cls(on_piece, remote), local_addr=local)
        return end

    @property
    def counts(self) -> DeframerCounts:
        """Frames and garbage so far."""
        return self._deframer.counts

    @property
    def address(self) -> Address:
        """The address that it is bound to."""
        assert self._transport is not None
        return cast("Address", self._transport.get_extra_info("sockname")[:2])

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Called by asyncio."""
        if self._has_remote and self._remote is not None and self._remote[0] != addr[0]:
            return
        pieces = [*self._deframer.feed(data), *self._deframer.finish()]
        if not self._has_remote and not all(piece.garbage for piece in pieces):
            self._remote = addr
        for piece in pieces:
            self._on_piece(piece)

    def send(self, payload: bytes) -> bool:
        """Send one frame as one datagram; returns `False` while no peer is known."""
        if self._remote is None or self._transport is None:
            return False
        self._transport.sendto(payload, self._remote)
        return True

    def close(self) -> None:
        """Give the port back."""
        if self._transport is not None:
            self._transport.close()


class TcpTransport(asyncio.Protocol):
    """One side of a link over TCP, made by `connect` or by a server's `accept`."""

    def __init__(self, on_piece: OnPiece) -> None:
        self._on_piece = on_piece
        self._transport: asyncio.Transport | None = None
        self._aborted = False
        self._deframer = Deframer()
        self.lost = asyncio.get_running_loop().create_future()
        """Done when the peer has gone; what it left unfinished has been delivered by then."""

    @classmethod
    async def connect(cls, on_piece: OnPiece, remote: Address) -> TcpTransport:
        """Connect to `remote`. Raises `OSError` if nobody listens."""
        loop = asyncio.get_running_loop()
        _, end = await loop.create_connection(lambda: cls(on_piece), *remote)
        return end

    @property
    def counts(self) -> DeframerCounts:
        """Frames and garbage so far."""
        return self._deframer.counts

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio."""
        self._transport = cast("asyncio.Transport", transport)
        if self._aborted:  # asyncio makes the protocols of several connections before it makes the connections
            self._transport.abort()
            return
        tcp_socket = transport.get_extra_info("socket")
        tcp_socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _PROBES:
            if hasattr(socket, name):
                tcp_socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    def data_received(self, data: bytes) -> None:
        """Called by asyncio."""
        for piece in self._deframer.feed(data):
            self._on_piece(piece)

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by asyncio."""
        for piece in self._deframer.finish():
            self._on_piece(piece)
        if not self.lost.done():
            self.lost.set_result(None)

    def send(self, payload: bytes) -> bool:
        """Send one frame; `False` once the connection is closed, or if more than `MAX_UNSENT_BYTES` would wait."""
        if self._transport is None or self._transport.is_closing():
            return False
        if self._transport.get_write_buffer_size() + len(payload) > MAX_UNSENT_BYTES:
            return False
        self._transport.write(payload)
        return True

    def close(self) -> None:
        """Close after what was sent has gone out."""
        if self._transport is not None:
            self._transport.close()

    def abort(self) -> None:
        """Close now, or as soon as the connection is made; what was not sent is lost."""
        self._aborted = True
        if self._transport is not None:
            self._transport.abort()


async def listen_tcp(
    accept: Callable[[], asyncio.BaseProtocol], local: Address = (LOOPBACK, 0)
) -> tuple[LimitedListener, Address]:
    """Listen at `local`; `accept` makes a protocol for each connection. Returns the listener and its address."""
    listener = await listen(accept, *local)
    return listener, cast("Address", listener.address[:2])
