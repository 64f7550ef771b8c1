"""Listening socket with a limit on its connections, which are counted from their acceptance on, before any handshake.

Above the limit, and where the process has no descriptors left, the connection that has been idle the longest gives way:
of the peer with the most connections, the one that has sent nothing for the longest time. So whoever opens many
connections, and keeps them, displaces its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
import ssl
import stat
import struct
from collections import Counter
from collections.abc import Awaitable, Callable, Collection
from typing import Any, Final

MAX_CONNECTIONS: Final = 128
HANDSHAKE_S: Final = 10.0
"""How long a client may take for the handshake of TLS."""
RETRY_S: Final = 0.1
"""Time until the next attempt, where no descriptors are left."""
_BACKLOG: Final = 128
_BATCH: Final = 32
"""Connections that are accepted before anything else gets its turn."""
_EXHAUSTED: Final = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
_LAST_DATA_RECEIVED: Final = 52
"""Offset of `tcpi_last_data_recv` in Linux's `struct tcp_info`: milliseconds, 32 bits."""

ProtocolFactory = Callable[[], asyncio.BaseProtocol]
Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class LimitedListener:
    """Accepts connections of one or more listening sockets, for a factory of protocols; made by `listen`."""

    def __init__(
        self, sockets: list[socket.socket], factory: ProtocolFactory, context: ssl.SSLContext | None, most: int
    ) -> None:
        """Called by `listen` and `listen_unix`."""
        self.displaced = 0
        """Connections that gave way to others."""
        self._sockets = sockets
        self._factory = factory
        self._context = context
        self._most = most
        self._open: dict[socket.socket, str] = {}
        """The peer's address by connection; those that have ended are left out at the next acceptance."""
        self._connecting: set[asyncio.Task[None]] = set()
        self._loop = asyncio.get_running_loop()
        self._timers: dict[socket.socket, asyncio.TimerHandle] = {}
        self.address: Any = sockets[0].getsockname()
        """Where the first socket listens."""
        for listening in sockets:
            self._loop.add_reader(listening, self._accept, listening)

    @property
    def is_open(self) -> bool:
        """Whether it accepts connections."""
        return bool(self._sockets)

    @property
    def connections(self) -> int:
        """How many are open."""
        self._forget_ended()
        return len(self._open)

    def close(self) -> None:
        """Accept no more connections; those in a handshake end, and the others are their protocols'."""
        for listening in self._sockets:
            timer = self._timers.pop(listening, None)
            if timer is not None:
                timer.cancel()
            self._loop.remove_reader(listening)
            listening.close()
        self._sockets = []
        for task in self._connecting:
            task.cancel()

    def _accept(self, listening: socket.socket) -> None:
        for _ in range(_BATCH):
            try:
                connection, peer = listening.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                if error.errno in _EXHAUSTED:
                    self._wait_for_descriptors(listening)
                return
            connection.settimeout(0.0)
            self._forget_ended()
            self._open[connection] = str(peer[0]) if isinstance(peer, tuple) else ""
            if len(self._open) > self._most:
                self._displace()
            if connection.fileno() >= 0:
                task = self._loop.create_task(self._connect(connection))
                self._connecting.add(task)
                task.add_done_callback(self._connecting.discard)

    async def _connect(self, connection: socket.socket) -> None:
        handshake_s = HANDSHAKE_S if self._context is not None else None
        try:
            if self._context is not None:
                await _wait_for_data(connection)
            await self._loop.connect_accepted_socket(
                self._factory, connection, ssl=self._context, ssl_handshake_timeout=handshake_s
            )
        except (OSError, asyncio.CancelledError):  # no TLS, too slow, or displaced; or the listener is closed
            connection.close()

    def _wait_for_descriptors(self, listening: socket.socket) -> None:
        """Try again soon, with the descriptor of the connection that has been idle the longest."""
        self._forget_ended()
        self._displace()
        self._loop.remove_reader(listening)
        self._timers[listening] = self._loop.call_later(RETRY_S, self._resume, listening)

    def _resume(self, listening: socket.socket) -> None:
        del self._timers[listening]
        self._loop.add_reader(listening, self._accept, listening)

    def _forget_ended(self) -> None:
        self._open = {connection: peer for connection, peer in self._open.items() if connection.fileno() >= 0}

    def _displace(self) -> None:
        idlest = find_idlest(self._open)
        if idlest is not None:
            self.displaced += 1
            del self._open[idlest]
            with contextlib.suppress(OSError):  # it has ended
                idlest.shutdown(socket.SHUT_RDWR)  # its transport closes it


async def _wait_for_data(connection: socket.socket) -> None:
    """Wait until a client begins its handshake: asyncio has 256 KiB ready for each connection from then on.

    Raises `TimeoutError`, and `ConnectionResetError` if it ends before.
    """
    loop = asyncio.get_running_loop()
    readable = asyncio.Event()
    loop.add_reader(connection, readable.set)
    try:
        async with asyncio.timeout(HANDSHAKE_S):
            await readable.wait()
    finally:
        loop.remove_reader(connection)
    if not connection.recv(1, socket.MSG_PEEK):
        raise ConnectionResetError(errno.ECONNRESET, "ended before its handshake")


def find_idlest(peers: dict[socket.socket, str]) -> socket.socket | None:
    """Of the peer with the most connections, the one that has sent nothing for the longest time; the newest where the
    system does not tell (Unix sockets). `None` of none.
    """
    if not peers:
        return None
    counts = Counter(peers.values())
    most = max(counts.values())
    candidates = [connection for connection, peer in peers.items() if counts[peer] == most]
    idle_ms = [_idle_ms(connection) for connection in candidates]
    longest = max(idle_ms)
    return candidates[-1] if longest < 0 else candidates[idle_ms.index(longest)]


def _idle_ms(connection: socket.socket) -> int:
    """Milliseconds since the peer sent something, or connected; -1 where the system does not tell."""
    if connection.family == socket.AF_UNIX:
        return -1
    try:
        facts = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _LAST_DATA_RECEIVED + 4)
        return int(struct.unpack_from("=I", facts, _LAST_DATA_RECEIVED)[0])
    except (AttributeError, struct.error):
        return -1
    except OSError:  # it has ended
        return 1 << 62


async def listen(
    factory: ProtocolFactory,
    host: str,
    port: int,
    *,
    context: ssl.SSLContext | None = None,
    most: int = MAX_CONNECTIONS,
) -> LimitedListener:
    """Listen at a TCP port (0: any free one) of an address of this machine, for `most` connections at a time.

    Raises `OSError` if the address cannot be had.
    """
    found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    sockets: list[socket.socket] = []
    try:
        for family, address in dict.fromkeys((family, address) for family, _, _, _, address in found):
            sockets.append(socket.create_server(address[:2], family=family, backlog=_BACKLOG))
            sockets[-1].settimeout(0.0)
            if port == 0:
                break
    except OSError:
        _close_all(sockets)
        raise
    return LimitedListener(sockets, factory, context, most)


def stream_factory(serve: Serve, limit: int) -> ProtocolFactory:
    """Protocols that have `serve` read and write each connection as streams, up to `limit` bytes a line."""

    def make() -> asyncio.StreamReaderProtocol:
        return asyncio.StreamReaderProtocol(asyncio.StreamReader(limit), serve)

    return make


def listen_unix(factory: ProtocolFactory, path: str, *, most: int) -> LimitedListener:
    """Listen at a Unix socket that only this user may use. Raises `OSError`."""
    listening = socket.socket(socket.AF_UNIX)
    before = os.umask(0o177)
    try:
        with contextlib.suppress(FileNotFoundError):
            if stat.S_ISSOCK(os.lstat(path).st_mode):  # of a process that was killed
                os.unlink(path)
        listening.bind(path)
        listening.listen(_BACKLOG)
        listening.settimeout(0.0)
    except OSError:
        listening.close()
        raise
    finally:
        os.umask(before)
    return LimitedListener([listening], factory, None, most)


def _close_all(sockets: Collection[socket.socket]) -> None:
    for one in sockets:
        one.close()
