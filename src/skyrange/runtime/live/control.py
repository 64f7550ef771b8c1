"""What do the supervisor, its nodes and other machines say to each other? JSON objects over ZeroMQ, under CURVE keys.

Node: `hello`, `bound` (it flew on trial, its addresses are held), `ready` (booted, connected), `status` twice a second,
`attack` when the trigger of one holds in the world, `done`. Supervisor: `warm_up` to the first of each machine, and to
the others once those are bound; `connect` once all are bound; `start` with the clock's zero once all are ready; `clock`
when that is known better; `attack` as the world said; `stop`.
Machines: see `joining`. A message may have bytes with it, a part of a file. Nothing that is received is evaluated; what
is no such object is dropped and counted, and who has no key of the range's is not let in.
"""

from __future__ import annotations

import asyncio
import json
import logging
from dataclasses import dataclass, field
from typing import Any, Final

import zmq
import zmq.asyncio
from zmq.auth.asyncio import AsyncioAuthenticator
from zmq.utils.monitor import recv_monitor_message

from skyrange.io.curve_keys import Keys
from skyrange.io.ends import naming, text
from skyrange.io.mavlink_sockets import LOOPBACK, Address

Message = dict[str, Any]
MOST_BYTES: Final = 65_536
"""Of a message."""
CHUNK_BYTES: Final = 1 << 19
"""Of a file, that go with one message."""
_LINGER_MS: Final = 2_000
_HEARTBEAT_MS: Final = 2_000
_REFUSED: Final = int(zmq.Event.HANDSHAKE_FAILED_AUTH | zmq.Event.HANDSHAKE_FAILED_PROTOCOL)
_REACHED: Final = int(zmq.Event.CONNECTED)
_LOG = logging.getLogger(__name__)
_LOG.addHandler(logging.NullHandler())
_LOG.propagate = False  # who is refused is counted; a flood of them would fill the standard error


def packed(kind: str, **data: Any) -> bytes:
    """A message."""
    return json.dumps({"kind": kind, **data}, separators=(",", ":")).encode()


def unpacked(data: bytes) -> Message | None:
    """What a message says; `None` for what is none."""
    if len(data) > MOST_BYTES:
        return None
    try:
        said = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return said if isinstance(said, dict) and isinstance(said.get("kind"), str) else None


@dataclass(slots=True)
class Desk:
    """The supervisor's side: who says what, among those that have one of `keys.peers`."""

    keys: Keys
    strange: int = 0
    """Messages that were none."""
    refused: int = 0
    """Connections without a key that is known here."""
    address: Address = ("", 0)
    _context: zmq.asyncio.Context = field(default_factory=zmq.asyncio.Context)
    _socket: Any = None
    _doorman: Any = None
    _monitor: Any = None
    _watch: asyncio.Task[None] | None = None

    def open(self, local: Address = (LOOPBACK, 0)) -> None:
        """Listen at `local`, port 0: any free one. `OSError` names an address that cannot be had."""
        self._doorman = AsyncioAuthenticator(self._context, log=_LOG)
        self._doorman.start()
        self._doorman.configure_curve_callback("*", self)
        socket = self._socket = self._context.socket(zmq.ROUTER)
        _set(socket, self.keys, local)
        socket.curve_server = True
        socket.set(zmq.ROUTER_HANDOVER, 1)  # a node that was started anew has its predecessor's name
        self._monitor = socket.get_monitor_socket(_REFUSED)
        self._watch = asyncio.ensure_future(self._count())
        try:
            socket.bind(f"tcp://{text(local)}")
        except zmq.ZMQError as error:
            number = error.errno or 0
            raise naming(local, OSError(number, zmq.strerror(number))) from error
        bound = bytes(self._socket.get(zmq.LAST_ENDPOINT)).decode().rstrip("\0")
        self.address = (local[0], int(bound.rpartition(":")[2]))

    def callback(self, domain: str, key: bytes) -> bool:
        """Whether somebody with this public key (Z85) may come in; called by the authenticator."""
        return key in self.keys.peers

    async def _count(self) -> None:
        while True:
            await recv_monitor_message(self._monitor)
            self.refused += 1

    async def hear(self) -> tuple[str, Message, bytes]:
        """The next message, whom it is from, and the bytes with it."""
        while True:
            name, *parts = await self._socket.recv_multipart()
            said = unpacked(parts[0]) if 1 <= len(parts) <= 2 else None
            if said is not None:
                return name.decode(errors="replace"), said, parts[1] if len(parts) == 2 else b""
            self.strange += 1

    async def tell(self, who: str, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        """Say something to somebody; who is gone does not hear it."""
        await self._socket.send_multipart([who.encode(), packed(kind, **data), *([blob] if blob else [])])

    def close(self) -> None:
        """Give the port back."""
        if self._watch is not None:
            self._watch.cancel()
        if self._doorman is not None:
            self._doorman.stop()
        if self._socket is not None:
            self._socket.disable_monitor()
            self._monitor.close(linger=0)
            self._socket.close(linger=0)
        self._context.term()


@dataclass(slots=True)
class Phone:
    """The side of a node or of another machine. `keys.peers` holds the desk's key."""

    name: str
    address: Address
    keys: Keys
    reached: int = 0
    """Connections to somebody, who may yet not speak under these keys."""
    refused: int = 0
    """Those that the other side refused for the key."""
    _context: zmq.asyncio.Context = field(default_factory=zmq.asyncio.Context)
    _socket: Any = None
    _monitor: Any = None
    _watch: asyncio.Task[None] | None = None

    def open(self) -> None:
        """Call the supervisor, now or when it is there."""
        socket = self._socket = self._context.socket(zmq.DEALER)
        socket.setsockopt(zmq.IDENTITY, self.name.encode())
        _set(socket, self.keys, self.address)
        (socket.curve_serverkey,) = self.keys.peers
        self._monitor = socket.get_monitor_socket(_REFUSED | _REACHED)
        self._watch = asyncio.ensure_future(self._count())
        socket.connect(f"tcp://{text(self.address)}")

    async def _count(self) -> None:
        while True:
            if int((await recv_monitor_message(self._monitor))["event"]) & _REFUSED:
                self.refused += 1
            else:
                self.reached += 1

    async def hear(self) -> tuple[Message, bytes]:
        """The next message, and the bytes with it."""
        while True:
            parts = await self._socket.recv_multipart()
            said = unpacked(parts[0]) if len(parts) <= 2 else None
            if said is not None:
                return said, parts[1] if len(parts) == 2 else b""

    async def tell(self, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        """Say something."""
        await self._socket.send_multipart([packed(kind, **data), *([blob] if blob else [])])

    def close(self) -> None:
        """Hang up, after what was said has gone out."""
        if self._watch is not None:
            self._watch.cancel()
        if self._socket is not None:
            self._socket.disable_monitor()
            self._monitor.close(linger=0)
            self._socket.close()
        self._context.term()


def _set(socket: Any, keys: Keys, address: Address) -> None:
    socket.linger = _LINGER_MS
    socket.ipv6 = ":" in address[0]
    socket.set(zmq.MAXMSGSIZE, max(MOST_BYTES, CHUNK_BYTES))
    socket.set(zmq.HEARTBEAT_IVL, _HEARTBEAT_MS)
    socket.curve_publickey, socket.curve_secretkey = keys.public, keys.secret
