"""What do the supervisor and its nodes say to each other? One JSON object per message, over ZeroMQ.

Node: `hello`, `bound` (it flew on trial, its addresses are held), `ready` (booted, connected), `status` twice a second,
`done`. Supervisor: `warm_up` to the first, and to the others once that one is bound; `connect` once all are bound;
`start` with the clock's zero once all are ready; `stop`.
Nothing that is received is evaluated; what is no such object is dropped and counted.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any, Final

import zmq
import zmq.asyncio

Message = dict[str, Any]
MOST_BYTES: Final = 65_536
_LINGER_MS: Final = 2_000


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
    """The supervisor's side: who says what."""

    address: str = ""
    strange: int = 0
    """Messages that were none."""
    _context: zmq.asyncio.Context = field(default_factory=zmq.asyncio.Context)
    _socket: Any = None

    def open(self) -> None:
        """Listen at a free port of the loopback."""
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MOST_BYTES)
        self._socket.setsockopt(zmq.ROUTER_MANDATORY, 0)
        self.address = f"tcp://127.0.0.1:{self._socket.bind_to_random_port('tcp://127.0.0.1')}"

    async def hear(self) -> tuple[str, Message]:
        """The next message, and the name of the node that it comes from."""
        while True:
            parts = await self._socket.recv_multipart()
            said = unpacked(parts[1]) if len(parts) == 2 else None
            if said is not None:
                return parts[0].decode(errors="replace"), said
            self.strange += 1

    async def tell(self, node: str, kind: str, **data: Any) -> None:
        """Say something to a node; one that is gone does not hear it."""
        await self._socket.send_multipart([node.encode(), packed(kind, **data)])

    def close(self) -> None:
        """Give the port back."""
        if self._socket is not None:
            self._socket.close(linger=0)
        self._context.term()


@dataclass(slots=True)
class Phone:
    """A node's side."""

    name: str
    address: str
    _context: zmq.asyncio.Context = field(default_factory=zmq.asyncio.Context)
    _socket: Any = None

    def open(self) -> None:
        """Call the supervisor."""
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.IDENTITY, self.name.encode())
        self._socket.setsockopt(zmq.MAXMSGSIZE, MOST_BYTES)
        self._socket.setsockopt(zmq.LINGER, _LINGER_MS)
        self._socket.connect(self.address)

    async def hear(self) -> Message:
        """The next message."""
        while True:
            said = unpacked(await self._socket.recv())
            if said is not None:
                return said

    async def tell(self, kind: str, **data: Any) -> None:
        """Say something."""
        await self._socket.send(packed(kind, **data))

    def close(self) -> None:
        """Hang up, after what was said has gone out."""
        if self._socket is not None:
            self._socket.close()
        self._context.term()
