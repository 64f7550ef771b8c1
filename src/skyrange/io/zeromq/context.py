"""ZeroMQ context of one event loop: which peers may connect, and how many.

pyzmq's authenticator is the ZAP handler of the context (https://rfc.zeromq.org/spec/27). Each socket that binds has a
ZAP domain of its own, and with it the keys of the peers that may connect. A socket without keys lets everybody in, but
has a domain too, since libzmq then refuses the ZMTP versions 1 and 2, to which nearly any bytes are frames.

libzmq itself accepts as many connections as there are descriptors.
The socket's monitor tells of each connection that libzmq accepted, with its descriptor. Above the limit a connection is
shut down, and libzmq closes it. A connection is *pending* until it has sent as much as its handshake takes; then it has
shown its key, or is one of loopback, where there are none. While pending ones are too many, the oldest is shut
down: a peer of the range is not pending for more than a moment, and connects again if it was.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import struct
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import zmq
from zmq.auth.asyncio import AsyncioAuthenticator

from skyrange.io.addresses import is_loopback

AT_ONCE = 64
"""Messages that are taken from one socket before others have their turn."""
_LOG = logging.getLogger(__name__)
_LOG.addHandler(logging.NullHandler())
_LOG.propagate = False  # refused peers are counted; a flood of them would fill the standard error

_CONTEXTS: dict[asyncio.AbstractEventLoop, ZmqContext] = {}


def authenticator_of(context: zmq.Context[Any]) -> AsyncioAuthenticator:
    """The ZAP handler of `context`, started in the running event loop: NULL may enter, CURVE by its domain's keys."""
    authenticator = AsyncioAuthenticator(context, log=_LOG)
    authenticator.start()
    return authenticator


@dataclass(frozen=True, slots=True)
class AllowedKeys:
    """A credentials provider for pyzmq's authenticator: the peers with one of these public keys (Z85)."""

    keys: frozenset[bytes]

    def callback(self, domain: str, key: bytes) -> bool:
        """Whether a peer with this public key may connect; called by the authenticator."""
        return key in self.keys


class ZmqContext:
    """The context that all sockets of one event loop share: one thread of libzmq, however many aircraft."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        """Called by `acquire`."""
        self.loop = loop
        self._sockets = 0
        self._domains = 0
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.context.set(zmq.MAX_SOCKETS, self.context.get(zmq.SOCKET_LIMIT))
        self._authenticator = authenticator_of(self.context)

    @classmethod
    def acquire(cls) -> ZmqContext:
        """The context of the running loop, for one socket more; `release` is its counterpart."""
        loop = asyncio.get_running_loop()
        context = _CONTEXTS.get(loop)
        if context is None:
            for closed_loop in [other for other in _CONTEXTS if other.is_closed()]:
                del _CONTEXTS[closed_loop]
            context = _CONTEXTS[loop] = cls(loop)
        context._sockets += 1
        return context

    def release(self, domain: bytes = b"") -> None:
        """Release one socket and its domain; after the last one the context ends in the background, once all is out."""
        self._authenticator.credentials_providers.pop(domain.decode(), None)
        self._sockets -= 1
        if self._sockets == 0:
            _CONTEXTS.pop(self.loop, None)
            self._authenticator.stop()
            threading.Thread(target=self.context.term, name="zmq-term", daemon=True).start()

    def add_domain(self, allowed: frozenset[bytes] | None) -> bytes:
        """A new domain, for peers with one of these public keys (Z85), or without keys at all."""
        self._domains += 1
        name = f"socket-{self._domains}"
        if allowed is not None:
            self._authenticator.configure_curve_callback(name, AllowedKeys(allowed))
        return name.encode()


def watch_socket(
    loop: asyncio.AbstractEventLoop, socket: zmq.Socket[bytes], serve: Callable[[], bool]
) -> Callable[[], None]:
    """Call `serve` whenever something may wait at `socket`, again while it returns true. Returns how to stop.

    A ZeroMQ socket's descriptor only signals changes, so `serve` has to take all there is, or return that there may be
    more.
    """
    number = int(socket.get(zmq.FD))
    stopped = False

    def look() -> None:
        if not stopped and serve():
            loop.call_soon(look)

    def stop() -> None:
        nonlocal stopped
        if not stopped:
            stopped = True
            loop.remove_reader(number)

    loop.add_reader(number, look)
    loop.call_soon(look)
    return stop


MAX_PENDING: Final = 64
"""Connections that have not completed their handshake."""
MAX_PENDING_OF_PEER: Final = 16
"""Those of one address beyond loopback."""
MAX_WITHOUT_KEY: Final = 128
"""All connections of a socket without keys, where everybody completes the handshake."""
_CURVE_BYTES: Final = 500
"""Fewer than greeting, HELLO and INITIATE of CURVE have together (https://rfc.zeromq.org/spec/26): 64, 202 and 259."""
_NULL_BYTES: Final = 65
"""More than a greeting (https://rfc.zeromq.org/spec/23)."""
_BYTES_RECEIVED: Final = 128
"""Offset of `tcpi_bytes_received` in Linux's `struct tcp_info` (linux/tcp.h, since 4.1)."""


@dataclass(slots=True)
class ConnectionLimit:
    """The open connections of one socket, in the order of their acceptance."""

    with_keys: bool
    shut_down: int = 0
    """Connections that were shut down because there were too many."""
    _open: dict[int, str] = field(default_factory=dict)
    """The peer's address by descriptor."""
    _pending: dict[int, str] = field(default_factory=dict)

    def add(self, descriptor: int) -> None:
        """A connection was accepted; shut down one if there are too many."""
        host = _peer_of(descriptor)
        if host is None:  # it has ended already
            return
        self._open[descriptor] = host
        self._pending[descriptor] = host
        of_peer = Counter(self._pending.values())[host]
        if len(self._pending) > MAX_PENDING or (of_peer > MAX_PENDING_OF_PEER and not is_loopback(host)):
            self._forget_completed()
            self._shut_down_pending(host)
        if not self.with_keys and len(self._open) > MAX_WITHOUT_KEY and descriptor in self._open:
            self._shut_down(descriptor)

    def remove(self, descriptor: int) -> None:
        """A connection has ended."""
        self._open.pop(descriptor, None)
        self._pending.pop(descriptor, None)

    def _forget_completed(self) -> None:
        enough = _CURVE_BYTES if self.with_keys else _NULL_BYTES
        for descriptor in [pending for pending in self._pending if _received_bytes(pending) >= enough]:
            del self._pending[descriptor]

    def _shut_down_pending(self, host: str) -> None:
        """Shut down the oldest pending connections, of `host` if that has too many, until few enough are left."""
        peer_descriptors = [pending for pending, peer in self._pending.items() if peer == host]
        if not is_loopback(host):
            for descriptor in peer_descriptors[: max(len(peer_descriptors) - MAX_PENDING_OF_PEER, 0)]:
                self._shut_down(descriptor)
        for descriptor in list(self._pending)[: max(len(self._pending) - MAX_PENDING, 0)]:
            self._shut_down(descriptor)

    def _shut_down(self, descriptor: int) -> None:
        self.remove(descriptor)
        self.shut_down += 1
        connection = socket.socket(fileno=descriptor)  # no descriptor more, which there may not be
        try:
            connection.shutdown(socket.SHUT_RDWR)
        except OSError:  # it has ended
            pass
        finally:
            connection.detach()


def _peer_of(descriptor: int) -> str | None:
    try:
        connection = socket.socket(fileno=descriptor)
    except (OSError, ValueError):
        return None
    try:
        return str(connection.getpeername()[0])
    except (OSError, IndexError):
        return None
    finally:
        connection.detach()


def _received_bytes(descriptor: int) -> int:
    """The bytes that a connection has received; as many as there can be where the system does not tell (Linux does)."""
    try:
        connection = socket.socket(fileno=descriptor)
    except OSError:
        return 0
    try:
        facts = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _BYTES_RECEIVED + 8)
        return int(struct.unpack_from("=Q", facts, _BYTES_RECEIVED)[0])
    except (AttributeError, struct.error):
        return 1 << 62
    except OSError:
        return 0
    finally:
        connection.detach()
