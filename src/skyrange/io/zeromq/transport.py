"""ZeroMQ transport of a link: one message is one payload, and only peers with the right key may connect.

The side that binds is a ROUTER, the side that connects a DEALER whose first message is empty: it announces itself. Two
DEALERs would deal the messages out among all that connect; a ROUTER addresses one peer, here the one that connected or
sent last, so a peer that starts anew is the peer at once; when it leaves, the one before it is again. Foreign
programs connect with a DEALER. Without a peer nothing is kept for later: `send` returns False. What a lost connection
leaves in the queue goes out on the next one.

What libzmq holds is bounded by `queue` messages of `max_bytes` each way and peer. One thing is not: parts of a
message that never ends, which only a peer that was let in can send; beyond loopback that takes a key.
"""

from __future__ import annotations

import contextlib
import struct
from dataclasses import dataclass

import zmq

from skyrange.codec.mavlink.deframer import Piece
from skyrange.core.errors import InputError
from skyrange.core.whole_numbers import worth_noting
from skyrange.io.addresses import OnNote, check_guarded, format_address, ignore_note, with_address
from skyrange.io.mavlink.transports import LOOPBACK, Address, OnPiece
from skyrange.io.zeromq.context import AT_ONCE, ConnectionLimit, ZmqContext, watch_socket
from skyrange.io.zeromq.curve_keys import Keys

MAX_BYTES = 65_536
QUEUE = 1_024
HANDSHAKE_MS = 5_000
HEARTBEAT_MS = 2_000
SILENT_MS = 10_000
"""A peer that answers no heartbeat for so long is gone; a process that was paused for five seconds is not.

Only under keys, where it may be on another machine. On loopback TCP says when a process ends, and anybody may connect:
libzmq 4.3.5 aborts the process when a heartbeat is due on a connection that filled the queue and was closed
(https://github.com/zeromq/libzmq/pull/4852)."""
MAX_PEERS = 8
"""Number of connected peers that are remembered."""
RECONNECT_MS = 100
SLOWEST_RECONNECT_MS = 1_000
LINGER_MS = 1_000
"""What was sent has this long to go out after `close`."""

_NO_ZMQ = "no ZeroMQ handshake"
_FAILED = {
    int(zmq.Event.HANDSHAKE_FAILED_NO_DETAIL): _NO_ZMQ,
    int(zmq.Event.HANDSHAKE_FAILED_PROTOCOL): "a broken handshake, or one under another key",
    int(zmq.Event.HANDSHAKE_FAILED_AUTH): "its key is not allowed",
}
_WATCHED = (
    zmq.Event.ACCEPTED
    | zmq.Event.CONNECTED
    | zmq.Event.HANDSHAKE_SUCCEEDED
    | zmq.Event.HANDSHAKE_FAILED_NO_DETAIL
    | zmq.Event.HANDSHAKE_FAILED_PROTOCOL
    | zmq.Event.HANDSHAKE_FAILED_AUTH
    | zmq.Event.DISCONNECTED
)


@dataclass(slots=True)
class Counts:
    """Messages and connections so far."""

    frames: int = 0
    """Received messages of one payload."""
    garbage: int = 0
    """Received messages of several parts, or empty."""
    garbage_bytes: int = 0
    sent: int = 0
    overflowed: int = 0
    """Not sent because the peer reads too slowly."""
    unsent: int = 0
    """Not sent because no peer was there."""
    unfit: int = 0
    """Not sent because empty or too long."""
    connections: int = 0
    """Peers that were let in."""
    refused: int = 0
    """Connections that were refused: no ZeroMQ, no key, or a wrong one."""


class ZmqTransport:
    """One side of one link over ZeroMQ, made by `bind` or `connect` in a running event loop."""

    def __init__(
        self,
        on_piece: OnPiece,
        address: Address,
        *,
        binds: bool,
        keys: Keys | None,
        on_note: OnNote,
        max_bytes: int,
        queue: int,
    ) -> None:
        """Called by `bind` and `connect`."""
        check_guarded("ZeroMQ", address, guarded=keys is not None, remedy="Give both sides keys (`skyrange keys`).")
        if keys is not None and not binds and len(keys.peers) != 1:
            raise InputError.one(
                "ZeroMQ", format_address(address), f"{len(keys.peers)} peers' keys", "that of the peer that binds there"
            )
        self.counts = Counts()
        self._on_piece = on_piece
        self._on_note = on_note
        self._max_bytes = max_bytes
        self._binds = binds
        self._peers: list[bytes] = []
        """The peers of a ROUTER, which addresses the last one."""
        self._greeted = False
        self._connections = 0
        """Open connections, and how many of them were let in."""
        self._let_in = 0
        self._limit = ConnectionLimit(with_keys=keys is not None)
        self._refusal = _NO_ZMQ
        self._closed = False
        self._context = ZmqContext.acquire()
        self._domain = b""
        self._socket = self._context.context.socket(zmq.ROUTER if binds else zmq.DEALER)
        self._monitor = self._socket.get_monitor_socket(_WATCHED)
        try:
            self._configure(keys, address, queue)
            endpoint = f"tcp://{format_address(address)}"
            if binds:
                self._socket.bind(endpoint)
            else:
                self._socket.connect(endpoint)
        except zmq.ZMQError as error:
            self._monitor.close(linger=0)
            self._socket.close(linger=0)
            self._context.release(self._domain)
            number = error.errno or 0
            raise with_address(address, OSError(number, zmq.strerror(number))) from error
        self._address = self._bound() if binds else address
        loop = self._context.loop
        self._stops = (
            watch_socket(loop, self._monitor, self._take_events),
            watch_socket(loop, self._socket, self._read),
        )
        self._loop = loop

    @classmethod
    async def bind(
        cls,
        on_piece: OnPiece,
        local: Address = (LOOPBACK, 0),
        *,
        keys: Keys | None = None,
        on_note: OnNote = ignore_note,
        max_bytes: int = MAX_BYTES,
        queue: int = QUEUE,
    ) -> ZmqTransport:
        """Wait at `local`, an IP address (port 0: any free one), for a peer with one of `keys.peers`.

        Raises `OSError` with an address that cannot be had, `InputError` with one beyond loopback without keys.
        `max_bytes` and `queue` have to fit the longest payload and burst: their product bounds the memory.
        """
        return cls(on_piece, local, binds=True, keys=keys, on_note=on_note, max_bytes=max_bytes, queue=queue)

    @classmethod
    async def connect(
        cls,
        on_piece: OnPiece,
        remote: Address,
        *,
        keys: Keys | None = None,
        on_note: OnNote = ignore_note,
        max_bytes: int = MAX_BYTES,
        queue: int = QUEUE,
    ) -> ZmqTransport:
        """Connect to `remote`, now or when a peer is there, and again whenever the connection was lost.

        Otherwise as `bind`; `keys.peers` holds the key of the peer that binds there, and no other.
        """
        return cls(on_piece, remote, binds=False, keys=keys, on_note=on_note, max_bytes=max_bytes, queue=queue)

    @property
    def address(self) -> Address:
        """The address that it is bound or connects to."""
        return self._address

    @property
    def connected(self) -> bool:
        """Whether `send` has a peer to send to, as far as is known."""
        return not self._closed and (bool(self._peers) if self._binds else self._let_in > 0)

    def send(self, payload: bytes) -> bool:
        """Send one payload as one message; returns `False`, and counts it, without a peer or if its queue is full."""
        if self._closed:
            return False
        counts = self.counts
        if not 0 < len(payload) <= self._max_bytes:
            counts.unfit += 1
            return False
        if not self.connected:
            counts.unsent += 1
            return False
        try:
            if self._binds:
                self._socket.send_multipart([self._peers[-1], payload], zmq.NOBLOCK)
            else:
                self._socket.send(payload, zmq.NOBLOCK)
        except zmq.Again:
            counts.overflowed += 1
            sent = False
        except zmq.ZMQError as error:
            if error.errno != zmq.EHOSTUNREACH:
                raise
            self._peers.pop()
            return self.send(payload)
        else:
            counts.sent += 1
            sent = True
        # a send may swallow the descriptor's signal that something has come
        if int(self._socket.get(zmq.EVENTS)) & zmq.POLLIN:
            self._loop.call_soon(self._read_again)
        return sent

    def close(self) -> None:
        """Close after what was sent has gone out, within `LINGER_MS`; the port is free a moment later."""
        if self._closed:
            return
        self._closed = True
        for stop in self._stops:
            stop()
        self._socket.disable_monitor()
        self._monitor.close(linger=0)
        self._socket.close(linger=LINGER_MS)
        self._context.release(self._domain)

    # --- receiving -------------------------------------------------------------------------------

    def _read_again(self) -> None:
        if not self._closed and self._read():
            self._loop.call_soon(self._read_again)

    def _read(self) -> bool:
        """Deliver what has come; true if there may be more. Events first: a peer that sent has connected before."""
        self._take_events()
        for _ in range(AT_ONCE):
            if self._closed:  # by the receiver of a piece
                return False
            try:
                parts = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return False
            if self._binds:
                sender, *parts = parts
                if self._peers[-1:] != [sender]:
                    earlier = [peer for peer in self._peers if peer != sender]
                    self._peers, self._greeted = [*earlier[1 - MAX_PEERS :], sender], False
                if parts == [b""] and not self._greeted:
                    self._greeted = True
                    continue
            self._deliver(parts)
        return True

    def _deliver(self, parts: list[bytes]) -> None:
        data = b"".join(parts)
        if len(parts) == 1 and data:
            self.counts.frames += 1
            self._on_piece(Piece(data, garbage=False))
            return
        self.counts.garbage += 1
        self.counts.garbage_bytes += len(data)
        if data:
            self._on_piece(Piece(data[: self._max_bytes], garbage=True))

    def _take_events(self) -> bool:
        """Take the monitor's events, in the order in which they happened."""
        while not self._closed:
            try:
                event, _ = self._monitor.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                break
            kind, value = struct.unpack("=hi", event)
            self._on_event(kind, value)
        return False

    def _on_event(self, kind: int, value: int) -> None:
        if kind in (zmq.Event.ACCEPTED, zmq.Event.CONNECTED):
            self._connections += 1
            if kind == zmq.Event.ACCEPTED:
                self._limit.add(value)
        elif kind == zmq.Event.HANDSHAKE_SUCCEEDED:
            self._let_in += 1
            self.counts.connections += 1
            if not self._binds:
                # not left to ZMQ_PROBE_ROUTER: it needs ZMQ_IMMEDIATE to do so at each connection, which in turn
                # throws away what came before a disconnection and is not read yet
                with contextlib.suppress(zmq.Again):  # a full queue speaks for itself
                    self._socket.send(b"", zmq.NOBLOCK)
            self._on_note("connected", f"{format_address(self._address)}: connection {self.counts.connections}")
        elif kind == zmq.Event.DISCONNECTED:
            self._limit.remove(value)
            self._on_disconnected()
        else:
            self._refusal = _FAILED[kind]

    def _on_disconnected(self) -> None:
        """A connection has ended.

        libzmq does not say which: while there are more connections than were let in, it counts as a refused one.
        So the counts are right once all have ended, in whatever order.
        """
        self._connections -= 1
        if self._connections < self._let_in:
            self._let_in -= 1
            if not self._let_in:
                self._peers.clear()
                self._on_note("disconnected", f"{format_address(self._address)}: the peer has gone")
            return
        counts = self.counts
        counts.refused += 1
        if worth_noting(counts.refused):
            self._on_note("refused", f"{format_address(self._address)}: {self._refusal}, {counts.refused} so far")
        self._refusal = _NO_ZMQ

    # --- options of the socket -------------------------------------------------------------------

    def _configure(self, keys: Keys | None, address: Address, queue: int) -> None:
        socket = self._socket
        socket.linger = LINGER_MS
        socket.ipv6 = ":" in address[0]
        socket.set(zmq.SNDHWM, queue)
        socket.set(zmq.RCVHWM, queue)
        socket.set(zmq.MAXMSGSIZE, self._max_bytes)
        socket.set(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        if keys is not None:
            socket.set(zmq.HEARTBEAT_IVL, HEARTBEAT_MS)
            socket.set(zmq.HEARTBEAT_TIMEOUT, SILENT_MS)
            socket.curve_publickey = keys.public
            socket.curve_secretkey = keys.secret
        if self._binds:
            socket.set(zmq.ROUTER_MANDATORY, 1)
            socket.set(zmq.ROUTER_HANDOVER, 1)
            self._domain = self._context.add_domain(None if keys is None else keys.peers)
            socket.zap_domain = self._domain
            socket.set(zmq.ZAP_ENFORCE_DOMAIN, 1)
            socket.curve_server = keys is not None
            return
        socket.set(zmq.RECONNECT_IVL, RECONNECT_MS)
        socket.set(zmq.RECONNECT_IVL_MAX, SLOWEST_RECONNECT_MS)
        if keys is not None:
            (socket.curve_serverkey,) = keys.peers

    def _bound(self) -> Address:
        endpoint = self._socket.get(zmq.LAST_ENDPOINT)
        assert isinstance(endpoint, bytes)
        host, port = endpoint.rstrip(b"\0").decode().removeprefix("tcp://").rsplit(":", 1)
        return host.strip("[]"), int(port)
