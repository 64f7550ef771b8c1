"""What does the supervisor know and ask of the other machines? Who has joined, their clocks, their records."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from skyrange import __version__
from skyrange.core.errors import ComponentError
from skyrange.record.folder import PARTS
from skyrange.runtime.live.clock import Echo, Offset
from skyrange.runtime.live.control import Desk, Message
from skyrange.runtime.live.files import chunks, write_chunk
from skyrange.runtime.live.host import HOST_MARK, SILENT_S
from skyrange.runtime.live.orders import Orders

FETCH_S: Final = 20.0
"""Wall seconds in which a machine has to hand over a piece of a record."""


@dataclass(slots=True)
class Machine:
    """One other machine."""

    address: str
    joined: bool = False
    clock: Offset = field(default_factory=Offset)
    heard_s: float = 0.0
    """When it last said something, by the supervisor's monotonic clock."""
    answers: asyncio.Queue[tuple[Message, bytes]] = field(default_factory=asyncio.Queue)
    """Parts of records, as asked for."""

    @property
    def silent(self) -> bool:
        """Whether it joined, and is gone."""
        return self.joined and time.monotonic() - self.heard_s > SILENT_S


OnEnded = Callable[[str, str], None]
"""Told the name of a node whose process has ended, and how."""


@dataclass(slots=True)
class Machines:
    """All others, by address."""

    name: str
    """The range's."""
    desk: Desk
    on_ended: OnEnded
    members: dict[str, Machine]
    zero_ns: int = 0
    """The range's time 0 on the supervisor's clock."""

    @property
    def missing(self) -> list[str]:
        """Addresses of those that have not joined, or whose clock was not measured yet."""
        return [address for address, one in self.members.items() if not one.joined or not one.clock.measured]

    def zero_at(self, address: str) -> int:
        """The range's time 0 on the clock of the machine at `address`."""
        return self.zero_ns + (self.members[address].clock.offset_ns if address in self.members else 0)

    async def hear(self, who: str, said: Message, blob: bytes) -> bool:
        """Take what a machine says; False for what nobody of these said, or says before it has joined."""
        kind = said["kind"]
        if not who.startswith(HOST_MARK):
            return False
        if kind == "join":
            await self._let_in(who, said)
            return True
        machine = self.members.get(who.removeprefix(HOST_MARK))
        if machine is None or not machine.joined:
            return False
        machine.heard_s = time.monotonic()
        if kind == "ask":
            await self.desk.tell(who, "answer", sent_ns=said["sent_ns"], answered_ns=time.monotonic_ns())
        elif kind == "clock":
            machine.clock.take(Echo(int(said["sent_ns"]), int(said["answered_ns"]), int(said["back_ns"])), self.zero_ns)
        elif kind == "ended":
            self.on_ended(str(said["node"]), f"{said['how']}. It said last:\n{said['words']}")
        elif kind in ("parts", "chunk"):
            machine.answers.put_nowait((said, blob))
        return True

    async def _let_in(self, who: str, said: Message) -> None:
        address = who.removeprefix(HOST_MARK)
        machine = self.members.get(address)
        fault: dict[str, str] | None = None
        if said.get("version") != __version__:
            fault = {
                "value": f"skyrange {said.get('version')} here, {__version__} there",
                "expected": "the same version on all machines",
                "hint": "Install that one here.",
            }
        elif machine is None:
            wanted = ", ".join(self.members) or "none"
            fault = {
                "value": f"this machine as {address}",
                "expected": f"one of the range's hosts: {wanted}",
                "hint": "Say with --address at which of them the others reach this machine.",
            }
        elif machine.joined and not machine.silent:
            fault = {"value": f"{address} again", "expected": "one for each address", "hint": "End the other one."}
        if fault is not None:
            await self.desk.tell(who, "refused", **fault)
        elif machine is not None:
            machine.joined, machine.heard_s = True, time.monotonic()
            await self.desk.tell(who, "welcome", name=self.name)

    async def give(self, address: str, files: Mapping[str, bytes], orders: list[Orders]) -> None:
        """Send a machine the scenario with its files, and what it shall start."""
        who = HOST_MARK + address
        for name, data in files.items():
            for offset, piece in chunks(data):
                await self.desk.tell(who, "file", piece, name=name, offset=offset)
        for one in orders:
            await self.desk.tell(who, "node", one.to_json().encode())

    async def fetch(self, address: str, into: Path) -> None:
        """Get all that a machine's nodes recorded. `ComponentError` where it does not hand it over; what came stays."""
        machine, who = self.members[address], HOST_MARK + address
        while not machine.answers.empty():
            machine.answers.get_nowait()
        _, blob = await self._answer(machine, self.desk.tell(who, "parts"))
        for name, size in json.loads(blob):
            at = 0
            if not size:
                write_chunk(into / PARTS, name, 0, b"")
            while at < size:
                said, piece = await self._answer(machine, self.desk.tell(who, "fetch", name=name, offset=at))
                if said.get("name") != name or said.get("offset") != at or not piece:
                    raise ComponentError(address, f"handed over something else than {name} from {at} on")
                write_chunk(into / PARTS, name, at, piece)
                at += len(piece)

    async def _answer(self, machine: Machine, ask: Awaitable[None]) -> tuple[Message, bytes]:
        await ask
        try:
            async with asyncio.timeout(FETCH_S):
                return await machine.answers.get()
        except TimeoutError:
            raise ComponentError(machine.address, f"did not hand over its records within {FETCH_S:g} s") from None

    async def dismiss(self) -> None:
        """The range is over."""
        for address, machine in self.members.items():
            if machine.joined:
                await self.desk.tell(HOST_MARK + address, "over")

    @property
    def told(self) -> dict[str, Any]:
        """For the manifest, by address."""
        return {address: machine.clock.told for address, machine in self.members.items()}
