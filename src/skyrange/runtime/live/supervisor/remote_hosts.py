"""Other machines of a live range as the supervisor knows them: who has joined, their clocks, their records."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from skyrange import __version__
from skyrange.codec.strict_json import parse_json
from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_S
from skyrange.record.folder import PARTS
from skyrange.runtime.live.clock import Clock, ClockOffset, ClockSample
from skyrange.runtime.live.config import NodeConfig
from skyrange.runtime.live.node.host_agent import HOST_PREFIX, SILENT_S
from skyrange.runtime.live.transport.control import ControlServer, Message, split_chunks, write_chunk

FETCH_S: Final = 20.0
"""Seconds in which a machine has to hand over a chunk of a record."""


@dataclass(slots=True)
class RemoteHost:
    """One other machine."""

    address: str
    joined: bool = False
    clock: ClockOffset = field(default_factory=ClockOffset)
    heard_ns: int = 0
    """When it last sent something, by the supervisor's monotonic clock."""
    answers: asyncio.Queue[tuple[Message, bytes]] = field(default_factory=asyncio.Queue)
    """Chunks of records, as asked for."""


OnEnded = Callable[[str, str], None]
"""Called with the name of a node whose process has ended, and how it ended."""


@dataclass(slots=True)
class RemoteHosts:
    """All other machines, by address."""

    name: str
    """The range's."""
    control: ControlServer
    on_ended: OnEnded
    members: dict[str, RemoteHost]
    clock: Clock
    """The supervisor's."""
    zero_ns: int = 0
    """The range's time 0 on `clock`."""

    @property
    def missing(self) -> list[str]:
        """Addresses of those that have not joined, or whose clock was not measured yet."""
        return [address for address, host in self.members.items() if not host.joined or not host.clock.measured]

    def is_silent(self, host: RemoteHost) -> bool:
        """Whether a machine joined, and has sent nothing for so long that it is taken to be gone."""
        return host.joined and self.clock.monotonic_ns() - host.heard_ns > SILENT_S * NS_PER_S

    def zero_at(self, address: str) -> int:
        """The range's time 0 on the clock of the machine at `address`."""
        return self.zero_ns + (self.members[address].clock.offset_ns if address in self.members else 0)

    async def handle_message(self, who: str, message: Message, blob: bytes) -> bool:
        """Act on a message of a machine; False for one of nobody of these, or from before it has joined."""
        kind = message["kind"]
        if not who.startswith(HOST_PREFIX):
            return False
        if kind == "join":
            await self._admit(who, message)
            return True
        host = self.members.get(who.removeprefix(HOST_PREFIX))
        if host is None or not host.joined:
            return False
        host.heard_ns = self.clock.monotonic_ns()
        if kind == "ask":
            await self.control.send(who, "answer", sent_ns=message["sent_ns"], answered_ns=host.heard_ns)
        elif kind == "clock":
            times = (int(message[key]) for key in ("sent_ns", "answered_ns", "back_ns"))
            host.clock.add_sample(ClockSample(*times), self.zero_ns)
        elif kind == "ended":
            self.on_ended(str(message["node"]), f"{message['how']}. It said last:\n{message['words']}")
        elif kind in ("parts", "chunk"):
            host.answers.put_nowait((message, blob))
        return True

    async def _admit(self, who: str, message: Message) -> None:
        address = who.removeprefix(HOST_PREFIX)
        host = self.members.get(address)
        problem: dict[str, str] | None = None
        if message.get("version") != __version__:
            problem = {
                "value": f"skyrange {message.get('version')} here, {__version__} there",
                "expected": "the same version on all machines",
                "hint": "Install that one here.",
            }
        elif host is None:
            wanted = ", ".join(self.members) or "none"
            problem = {
                "value": f"this machine as {address}",
                "expected": f"one of the range's hosts: {wanted}",
                "hint": "Say with --address at which of them the others reach this machine.",
            }
        elif host.joined and not self.is_silent(host):
            problem = {"value": f"{address} again", "expected": "one for each address", "hint": "End the other one."}
        if problem is not None:
            await self.control.send(who, "refused", **problem)
        elif host is not None:
            host.joined, host.heard_ns = True, self.clock.monotonic_ns()
            await self.control.send(who, "welcome", name=self.name)

    async def send_nodes(self, address: str, files: Mapping[str, bytes], nodes: list[NodeConfig]) -> None:
        """Send a machine the scenario with its files, and the nodes that it shall start."""
        who = HOST_PREFIX + address
        for name, data in files.items():
            for offset, chunk in split_chunks(data):
                await self.control.send(who, "file", chunk, name=name, offset=offset)
        for config in nodes:
            await self.control.send(who, "node", config.to_json().encode())

    async def fetch_records(self, address: str, into: Path) -> None:
        """Get all that a machine's nodes recorded.

        `ComponentError` where it does not hand it over; what has come by then stays.
        """
        host, who = self.members[address], HOST_PREFIX + address
        while not host.answers.empty():
            host.answers.get_nowait()
        _, blob = await self._answer(host, self.control.send(who, "parts"))
        for name, size in parse_json(blob):
            at = 0
            if not size:
                write_chunk(into / PARTS, name, 0, b"")
            while at < size:
                message, chunk = await self._answer(host, self.control.send(who, "fetch", name=name, offset=at))
                if message.get("name") != name or message.get("offset") != at or not chunk:
                    raise ComponentError(address, f"handed over something else than {name} from {at} on")
                write_chunk(into / PARTS, name, at, chunk)
                at += len(chunk)

    async def _answer(self, host: RemoteHost, request: Awaitable[None]) -> tuple[Message, bytes]:
        await request
        try:
            async with asyncio.timeout(FETCH_S):
                return await host.answers.get()
        except TimeoutError:
            raise ComponentError(host.address, f"did not hand over its records within {FETCH_S:g} s") from None

    async def dismiss(self) -> None:
        """Tell all machines that the range is over."""
        for address, host in self.members.items():
            if host.joined:
                await self.control.send(HOST_PREFIX + address, "over")

    @property
    def manifest_entries(self) -> dict[str, Any]:
        """What the manifest says of their clocks, by address."""
        return {address: host.clock.manifest_entry for address, host in self.members.items()}
