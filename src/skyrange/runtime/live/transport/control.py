"""Control channel between the supervisor, its nodes and other machines: JSON objects over ZeroMQ, under CURVE keys.

A node sends `hello`, `bound` (it has flown on trial, and holds its addresses), `ready` (booted and connected), `status`
twice a second, `attack` when one begins by a trigger or by hand in the world, or is stopped by hand there, `acted` as
the answer to an `act`, `done`. The supervisor sends `warm_up` to the first node of each machine, and to the others once
those are bound; `connect` once all are bound; `start` with the clock's zero once all are ready; `clock` when that is
known better; `attack` as the world said; `act` to the world's node, where somebody starts or stops an act by hand;
`stop`. The messages of machines are in `remote_hosts`. A message may carry bytes, a part of a file in a transfer by
chunks. Nothing that is received is evaluated; anything but such an object is dropped and counted, and nobody without a
key of the range is let in.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final, Protocol

import zmq
import zmq.asyncio
from zmq.utils.monitor import recv_monitor_message

from skyrange.codec.strict_json import parse_json_object
from skyrange.core.errors import ComponentError, DecodeError
from skyrange.io.addresses import format_address, with_address
from skyrange.io.mavlink.transports import LOOPBACK, Address
from skyrange.io.zeromq.context import AllowedKeys, ConnectionLimit, authenticator_of
from skyrange.io.zeromq.curve_keys import Keys

Message = dict[str, Any]
MAX_MESSAGE_BYTES: Final = 65_536
CHUNK_BYTES: Final = 1 << 19
"""Longest part of a file that goes with one message."""
_SEALED_BYTES: Final = 33
"""By so much CURVE makes a part of a message longer; ZeroMQ measures what arrives with it."""
_LINGER_MS: Final = 2_000
_HEARTBEAT_MS: Final = 2_000
_HANDSHAKE_MS: Final = 5_000
_REFUSED: Final = int(zmq.Event.HANDSHAKE_FAILED_AUTH | zmq.Event.HANDSHAKE_FAILED_PROTOCOL)
_REACHED: Final = int(zmq.Event.CONNECTED)
_ACCEPTED: Final = int(zmq.Event.ACCEPTED)
_ENDED: Final = int(zmq.Event.DISCONNECTED)


def pack_message(kind: str, **data: Any) -> bytes:
    """A message as bytes."""
    return json.dumps({"kind": kind, **data}, separators=(",", ":")).encode()


def unpack_message(data: bytes) -> Message | None:
    """The message in `data`; `None` where there is none."""
    if len(data) > MAX_MESSAGE_BYTES:
        return None
    try:
        message = parse_json_object(data)
    except DecodeError:
        return None
    return message if isinstance(message.get("kind"), str) else None


class ControlServer(Protocol):
    """The supervisor's side of the control channel."""

    strange: int
    """Received messages that were none."""
    refused: int
    """Connections without a key that is known here, and those above the limit."""
    address: Address

    def open(self, local: Address = (LOOPBACK, 0)) -> None:
        """Listen at `local`, port 0: any free one. `OSError` names an address that cannot be had."""
        ...

    async def receive(self) -> tuple[str, Message, bytes]:
        """The next message: the sender's name, the message, and the bytes with it."""
        ...

    async def send(self, who: str, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        """Send a message to the peer of that name; a peer that is gone does not get it."""
        ...

    def close(self) -> None:
        """Give the port back."""
        ...


class ControlClient(Protocol):
    """The side of a node, or of another machine."""

    name: str
    address: Address
    """Of the server."""
    reached: int
    """Connections to somebody, who may yet not speak under these keys."""
    refused: int
    """Connections that the other side refused for the key."""

    def open(self) -> None:
        """Connect to the supervisor, now or when it is there."""
        ...

    async def receive(self) -> tuple[Message, bytes]:
        """The next message, and the bytes with it."""
        ...

    async def send(self, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        """Send a message."""
        ...

    def close(self) -> None:
        """Disconnect, after what was sent has gone out."""
        ...


@dataclass(slots=True)
class ZmqControlServer:
    """A `ControlServer` as a ZeroMQ ROUTER, which lets in whoever has one of `keys.peers`."""

    keys: Keys
    strange: int = 0
    refused: int = 0
    address: Address = ("", 0)
    _context: zmq.asyncio.Context = field(default_factory=zmq.asyncio.Context)
    _socket: Any = None
    _authenticator: Any = None
    _monitor: Any = None
    _watch: asyncio.Task[None] | None = None

    def open(self, local: Address = (LOOPBACK, 0)) -> None:
        """See `ControlServer`."""
        self._authenticator = authenticator_of(self._context)
        self._authenticator.configure_curve_callback("*", AllowedKeys(self.keys.peers))
        socket = self._socket = self._context.socket(zmq.ROUTER)
        _configure(socket, self.keys, local)
        socket.curve_server = True
        socket.set(zmq.ROUTER_HANDOVER, 1)  # a node that was started anew has its predecessor's name
        self._monitor = socket.get_monitor_socket(_REFUSED | _ACCEPTED | _ENDED)
        self._watch = asyncio.ensure_future(self._watch_connections())
        try:
            socket.bind(f"tcp://{format_address(local)}")
        except zmq.ZMQError as error:
            number = error.errno or 0
            raise with_address(local, OSError(number, zmq.strerror(number))) from error
        bound = bytes(self._socket.get(zmq.LAST_ENDPOINT)).decode().rstrip("\0")
        self.address = (local[0], int(bound.rpartition(":")[2]))

    async def _watch_connections(self) -> None:
        limit = ConnectionLimit(with_keys=True)
        refused = 0
        while True:
            event = await recv_monitor_message(self._monitor)
            kind = int(event["event"])
            if kind & _ACCEPTED:
                limit.add(int(event["value"]))
            elif kind & _ENDED:
                limit.remove(int(event["value"]))
            else:
                refused += 1
            self.refused = refused + limit.shut_down

    async def receive(self) -> tuple[str, Message, bytes]:
        """See `ControlServer`."""
        while True:
            name, *parts = await self._socket.recv_multipart()
            message = unpack_message(parts[0]) if 1 <= len(parts) <= 2 else None
            if message is not None:
                return name.decode(errors="replace"), message, parts[1] if len(parts) == 2 else b""
            self.strange += 1

    async def send(self, who: str, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        """See `ControlServer`."""
        await self._socket.send_multipart([who.encode(), pack_message(kind, **data), *([blob] if blob else [])])

    def close(self) -> None:
        """See `ControlServer`."""
        if self._watch is not None:
            self._watch.cancel()
        if self._authenticator is not None:
            self._authenticator.stop()
        if self._socket is not None:
            self._socket.disable_monitor()
            self._monitor.close(linger=0)
            self._socket.close(linger=0)
        self._context.term()


@dataclass(slots=True)
class ZmqControlClient:
    """A `ControlClient` as a ZeroMQ DEALER. `keys.peers` holds the server's key."""

    name: str
    address: Address
    keys: Keys
    reached: int = 0
    refused: int = 0
    _context: zmq.asyncio.Context = field(default_factory=zmq.asyncio.Context)
    _socket: Any = None
    _monitor: Any = None
    _watch: asyncio.Task[None] | None = None

    def open(self) -> None:
        """See `ControlClient`."""
        socket = self._socket = self._context.socket(zmq.DEALER)
        socket.setsockopt(zmq.IDENTITY, self.name.encode())
        _configure(socket, self.keys, self.address)
        (socket.curve_serverkey,) = self.keys.peers
        self._monitor = socket.get_monitor_socket(_REFUSED | _REACHED)
        self._watch = asyncio.ensure_future(self._count_events())
        socket.connect(f"tcp://{format_address(self.address)}")

    async def _count_events(self) -> None:
        while True:
            if int((await recv_monitor_message(self._monitor))["event"]) & _REFUSED:
                self.refused += 1
            else:
                self.reached += 1

    async def receive(self) -> tuple[Message, bytes]:
        """See `ControlClient`."""
        while True:
            parts = await self._socket.recv_multipart()
            message = unpack_message(parts[0]) if len(parts) <= 2 else None
            if message is not None:
                return message, parts[1] if len(parts) == 2 else b""

    async def send(self, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        """See `ControlClient`."""
        await self._socket.send_multipart([pack_message(kind, **data), *([blob] if blob else [])])

    def close(self) -> None:
        """See `ControlClient`."""
        if self._watch is not None:
            self._watch.cancel()
        if self._socket is not None:
            self._socket.disable_monitor()
            self._monitor.close(linger=0)
            self._socket.close()
        self._context.term()


def _configure(socket: Any, keys: Keys, address: Address) -> None:
    socket.linger = _LINGER_MS
    socket.ipv6 = ":" in address[0]
    socket.set(zmq.MAXMSGSIZE, max(MAX_MESSAGE_BYTES, CHUNK_BYTES) + _SEALED_BYTES)
    socket.set(zmq.HEARTBEAT_IVL, _HEARTBEAT_MS)
    socket.set(zmq.HANDSHAKE_IVL, _HANDSHAKE_MS)
    socket.curve_publickey, socket.curve_secretkey = keys.public, keys.secret


def split_chunks(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The chunks of a file, each with its offset; an empty file has one chunk."""
    for offset in range(0, max(len(data), 1), CHUNK_BYTES):
        yield offset, data[offset : offset + CHUNK_BYTES]


def list_files(folder: Path) -> list[tuple[str, int]]:
    """All files below `folder`: relative name and size in bytes."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file() and not path.is_symlink())
    return [(path.relative_to(folder).as_posix(), path.stat().st_size) for path in paths]


def read_chunk(folder: Path, name: str, offset: int) -> bytes:
    """A chunk of a file below `folder`, empty beyond its end. `ComponentError` as `path_inside`; `OSError`."""
    with path_inside(folder, name).open("rb") as file:
        file.seek(offset)
        return file.read(CHUNK_BYTES)


def write_chunk(folder: Path, name: str, offset: int, data: bytes) -> None:
    """Write a chunk at its offset. `ComponentError` as `path_inside`; `OSError`."""
    path = path_inside(folder, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("r+b" if offset else "wb") as file:
        file.seek(offset)
        file.write(data)


def path_inside(folder: Path, name: str) -> Path:
    """The path of a name that another machine sent; `ComponentError` where it would lie outside `folder`."""
    parts = PurePosixPath(name).parts
    if not parts or PurePosixPath(name).is_absolute() or ".." in parts or "\0" in name or "\\" in name:
        raise ComponentError("live", f"a file named {name!r} was announced, which would lie outside of {folder}")
    return folder.joinpath(*parts)
