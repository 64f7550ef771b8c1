"""ZeroMQ context of one event loop, with the authenticator that decides which peers may connect.

pyzmq's authenticator is the ZAP handler of the context (https://rfc.zeromq.org/spec/27). Each socket that binds has a
ZAP domain of its own, and with it the keys of the peers that may connect. A socket without keys lets everybody in, but
has a domain too, since libzmq then refuses the ZMTP versions 1 and 2, to which nearly any bytes are frames.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import zmq
from zmq.auth.asyncio import AsyncioAuthenticator

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
        found = _CONTEXTS.get(loop)
        if found is None:
            for gone in [other for other in _CONTEXTS if other.is_closed()]:
                del _CONTEXTS[gone]
            found = _CONTEXTS[loop] = cls(loop)
        found._sockets += 1
        return found

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
