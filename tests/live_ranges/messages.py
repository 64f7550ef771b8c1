"""Message transports in memory: they replace ZeroMQ and HTTP links, and the control channel."""

from __future__ import annotations

import asyncio
from typing import Any, Final

from skyrange.codec.mavlink.deframer import Piece
from skyrange.io.mavlink.transports import LOOPBACK, Address, OnPiece
from skyrange.io.zeromq.curve_keys import Keys
from skyrange.runtime.live.transport.control import Message, pack_message, unpack_message
from tests.live_ranges.network import Key, Owner, Pipe, VirtualNetwork

RECONNECT_S: Final = 0.1
"""Between two attempts to reach a control socket."""


class _Endpoint:
    """A receiver of messages."""

    def __init__(self, network: VirtualNetwork) -> None:
        self.network = network
        self.owner = Owner.current()
        self.inbound = Pipe(network, self.owner)
        self.closed = False
        self.owner.opened(self)

    def close(self) -> None:
        """Stop receiving and sending; what was sent arrives."""
        if not self.closed:
            self.closed = True
            self.network.release(self)
            self.owner.closed(self)

    def kill(self) -> None:
        """Close it for a process that was killed."""
        self.close()

    def reaches(self, other: _Endpoint) -> bool:
        """Whether a message that is sent now arrives at `other`."""
        return not other.closed and self.network.reaches(self.owner.machine, other.owner.machine)


class MessageListener(_Endpoint):
    """The listening side of a link; its peer is the one that connected or sent last, as for `ZmqTransport`."""

    refused = 0

    def __init__(self, network: VirtualNetwork, on_piece: OnPiece, family: str, address: Address) -> None:
        """Raises `OSError` if the address is taken."""
        super().__init__(network)
        self.on_piece = on_piece
        network.bind(family, self.owner.machine, address, self)
        waiting = network.connectors.get(network.key(family, self.owner.machine, address), [])
        self.peers: list[MessageConnector] = [one for one in waiting if not one.closed]

    def send(self, payload: bytes) -> bool:
        """See `Transport`."""
        while self.peers and self.peers[-1].closed:
            self.peers.pop()
        if self.closed or not self.peers or not self.reaches(self.peers[-1]):
            return False
        peer = self.peers[-1]
        peer.inbound.push(lambda: peer.receive(payload))
        return True

    def receive(self, payload: bytes, sender: MessageConnector) -> None:
        """Take a message that has arrived."""
        if not self.closed:
            self.peers = [*(peer for peer in self.peers if peer is not sender), sender]
            self.on_piece(Piece(payload, garbage=False))


class MessageConnector(_Endpoint):
    """The connecting side of a link, connected whenever a listener is there."""

    refused = 0

    def __init__(self, network: VirtualNetwork, on_piece: OnPiece, family: str, address: Address) -> None:
        super().__init__(network)
        self.on_piece = on_piece
        self._key: Key = network.key(family, self.owner.machine, address)
        network.connectors.setdefault(self._key, []).append(self)
        listener: MessageListener | None = network.listeners.get(self._key)
        if listener is not None:
            listener.peers.append(self)

    def send(self, payload: bytes) -> bool:
        """See `Transport`."""
        listener: MessageListener | None = self.network.listeners.get(self._key)
        if self.closed or listener is None or not self.reaches(listener):
            return False
        listener.inbound.push(lambda: listener.receive(payload, self))
        return True

    def receive(self, payload: bytes) -> None:
        """Take a message that has arrived."""
        if not self.closed:
            self.on_piece(Piece(payload, garbage=False))

    def close(self) -> None:
        """See `Transport`."""
        super().close()
        others = self.network.connectors.get(self._key, [])
        if self in others:
            others.remove(self)


class MemoryControlServer:
    """A `ControlServer` in memory, which accepts clients with one of `keys.peers`."""

    def __init__(self, network: VirtualNetwork, keys: Keys) -> None:
        self.keys = keys
        self.strange = 0
        self.refused = 0
        self.address: Address = ("", 0)
        self._network = network
        self._received: asyncio.Queue[tuple[str, bytes, bytes]] = asyncio.Queue()
        self._clients: dict[str, MemoryControlClient] = {}
        self.endpoint: _Endpoint | None = None

    def open(self, local: Address = (LOOPBACK, 0)) -> None:
        """See `ControlServer`."""
        self.endpoint = _Endpoint(self._network)
        self.address = self._network.bind("control", self.endpoint.owner.machine, local, self)

    def admit(self, client: MemoryControlClient) -> bool:
        """Accept a client, which takes the place of an earlier one of its name; False if its key is unknown."""
        if client.keys.public not in self.keys.peers:
            self.refused += 1
            return False
        self._clients[client.name] = client
        return True

    def take(self, client: MemoryControlClient, data: bytes, blob: bytes) -> None:
        """Take a message of a client that was accepted."""
        self._received.put_nowait((client.name, data, blob))

    async def receive(self) -> tuple[str, Message, bytes]:
        """See `ControlServer`."""
        while True:
            name, data, blob = await self._received.get()
            message = unpack_message(data)
            if message is not None:
                return name, message, blob
            self.strange += 1

    async def send(self, who: str, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        """See `ControlServer`."""
        client = self._clients.get(who)
        assert self.endpoint is not None
        if client is not None and client.endpoint is not None and self.endpoint.reaches(client.endpoint):
            message = pack_message(kind, **data)
            client.endpoint.inbound.push(lambda: client.take(message, blob))

    def close(self) -> None:
        """See `ControlServer`."""
        self._network.release(self)
        if self.endpoint is not None:
            self.endpoint.close()


class MemoryControlClient:
    """A `ControlClient` in memory."""

    def __init__(self, network: VirtualNetwork, name: str, address: Address, keys: Keys) -> None:
        self.name = name
        self.address = address
        self.keys = keys
        self.reached = 0
        self.refused = 0
        self._network = network
        self._received: asyncio.Queue[tuple[bytes, bytes]] = asyncio.Queue()
        self._server: MemoryControlServer | None = None
        self._unsent: list[tuple[bytes, bytes]] = []
        self.endpoint: _Endpoint | None = None

    def open(self) -> None:
        """See `ControlClient`."""
        self.endpoint = _Endpoint(self._network)
        self._retry()

    def _retry(self) -> None:
        """Connect, and try again after `RECONNECT_S` until a server accepts."""
        if self.endpoint is not None and not self.endpoint.closed and self._connect() is None:
            asyncio.get_running_loop().call_later(RECONNECT_S, self._retry)

    def _connect(self) -> MemoryControlServer | None:
        """The server, if it is there and accepts; messages sent before are sent then."""
        assert self.endpoint is not None
        key = self._network.key("control", self.endpoint.owner.machine, self.address)
        server: MemoryControlServer | None = self._network.listeners.get(key)
        if server is None or server.endpoint is None or not self.endpoint.reaches(server.endpoint):
            return None
        if server is not self._server:
            self.reached += 1
            if server.keys.public not in self.keys.peers:  # it understands no answer, so it cannot know the reason
                server.refused += 1
                return None
            if not server.admit(self):
                self.refused += 1
                return None
            self._server = server
            unsent, self._unsent = self._unsent, []
            for message, blob in unsent:
                self._send(server, message, blob)
        return server

    def _send(self, server: MemoryControlServer, message: bytes, blob: bytes) -> None:
        assert server.endpoint is not None
        server.endpoint.inbound.push(lambda: server.take(self, message, blob))

    def take(self, data: bytes, blob: bytes) -> None:
        """Take a message that has arrived."""
        self._received.put_nowait((data, blob))

    async def receive(self) -> tuple[Message, bytes]:
        """See `ControlClient`."""
        while True:
            data, blob = await self._received.get()
            message = unpack_message(data)
            if message is not None:
                return message, blob

    async def send(self, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        """See `ControlClient`."""
        server, message = self._server, pack_message(kind, **data)
        if server is None:
            self._unsent.append((message, blob))
        elif self.endpoint is not None and server.endpoint is not None and self.endpoint.reaches(server.endpoint):
            self._send(server, message, blob)

    def close(self) -> None:
        """See `ControlClient`."""
        if self.endpoint is not None:
            self.endpoint.close()
