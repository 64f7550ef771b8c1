"""Where do the ZeroMQ ends of one event loop live, and who lets their peers in? One context and one doorman.

The doorman is the ZAP handler of the context (https://rfc.zeromq.org/spec/27): each end that binds has
a domain of its own, and with it the keys that may come in. An end without keys lets everybody in, but has
a domain too, since libzmq then refuses the ZMTP versions 1 and 2, to which nearly any bytes are frames.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

import zmq
from zmq.utils import z85

ZAP = "inproc://zeromq.zap.01"
AT_ONCE = 64
"""Messages that are taken from one socket before others have their turn."""

_ROOMS: dict[asyncio.AbstractEventLoop, ZmqContext] = {}


class ZmqContext:
    """The context that all ends of one event loop share: one thread of libzmq, however many aircraft."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self._ends = 0
        self._made = 0
        self._allowed: dict[bytes, frozenset[bytes] | None] = {}
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.context.set(zmq.MAX_SOCKETS, self.context.get(zmq.SOCKET_LIMIT))
        self._doorman = self.context.socket(zmq.REP)
        self._doorman.bind(ZAP)
        self._stop = watch(loop, self._doorman, self._ask)

    @classmethod
    def enter(cls) -> ZmqContext:
        """The room of the running loop, for one end more; `leave` is its counterpart."""
        loop = asyncio.get_running_loop()
        room = _ROOMS.get(loop)
        if room is None:
            for gone in [other for other in _ROOMS if other.is_closed()]:
                del _ROOMS[gone]
            room = _ROOMS[loop] = cls(loop)
        room._ends += 1
        return room

    def leave(self, domain: bytes = b"") -> None:
        """One end less; after the last one the context ends, behind the scenes, when all that was sent is out."""
        self._allowed.pop(domain, None)
        self._ends -= 1
        if self._ends == 0:
            _ROOMS.pop(self.loop, None)
            self._stop()
            self._doorman.close(linger=0)
            threading.Thread(target=self.context.term, name="zmq-term", daemon=True).start()

    def domain(self, allowed: frozenset[bytes] | None) -> bytes:
        """A new domain, for peers with one of these public keys (Z85), or for all of them."""
        self._made += 1
        name = b"end-%d" % self._made
        self._allowed[name] = allowed
        return name

    def _ask(self) -> bool:
        for _ in range(AT_ONCE):
            try:
                request = self._doorman.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return False
            version, number, domain = [*request, b"", b"", b""][:3]
            code, reason = (b"200", b"OK") if self._may_enter(domain, request[5:]) else (b"400", b"unknown key")
            self._doorman.send_multipart([version, number, code, reason, b"", b""], zmq.NOBLOCK)
        return True

    def _may_enter(self, domain: bytes, credentials: list[bytes]) -> bool:
        if domain not in self._allowed:
            return False
        allowed = self._allowed[domain]
        if allowed is None:
            return True
        return len(credentials) == 2 and credentials[0] == b"CURVE" and z85.encode(credentials[1]) in allowed


def watch(loop: asyncio.AbstractEventLoop, socket: zmq.Socket[bytes], serve: Callable[[], bool]) -> Callable[[], None]:
    """Call `serve` whenever something may wait at `socket`, again while it returns true. Returns how to stop.

    A ZeroMQ socket's descriptor only signals changes, so `serve` has to take all there is, or say that
    there may be more.
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
