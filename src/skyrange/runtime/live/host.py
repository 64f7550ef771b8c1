"""What does a machine do that has joined a range? It starts the processes it is told to, and gives back their records.

It asks for the time all along, so that its clock is known; what ends it says; and when the range falls silent it ends
them and keeps what they recorded.
"""

from __future__ import annotations

import asyncio
import json
import shutil
import socket
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from skyrange import __version__
from skyrange.core.errors import ComponentError, InputError
from skyrange.io.curve_keys import Keys
from skyrange.io.ends import text
from skyrange.io.mavlink_sockets import Address
from skyrange.io.programs import Program
from skyrange.record.folder import PARTS
from skyrange.runtime.live.clock import Echo, best
from skyrange.runtime.live.control import Message, Phone
from skyrange.runtime.live.files import listed, read_chunk, write_chunk
from skyrange.runtime.live.launch import start
from skyrange.runtime.live.orders import Orders

HOST_MARK: Final = "@"
"""What a machine's name at the control socket begins with; a node's never does."""
SILENT_S: Final = 10.0
"""Without a word for so long, the other side is taken to be gone."""
_ASK_S: Final = 1.0
_ECHOES: Final = 5
"""Questions about the time in a row, of which the quickest counts."""
_LOOK_S: Final = 0.1
_STRANGER: Final = 3
"""Connections after which somebody who never answers is taken to have other keys."""

OnWord = Callable[[str], None]


@dataclass(slots=True)
class Host:
    """A machine in one range, from joining it to its end."""

    address: str
    phone: Phone
    root: Path
    on_word: OnWord
    programs: dict[str, Program] = field(default_factory=dict)
    welcome: bool = False
    over: bool = False
    _told: set[str] = field(default_factory=set)
    _heard_s: float = field(default_factory=time.monotonic)
    _echoes: list[Echo] = field(default_factory=list)

    async def serve(self, wait_s: float) -> None:
        """Join, do as told, and end with the range."""
        await self.phone.tell("join", version=__version__, address=self.address)
        tasks = [asyncio.create_task(self._listen()), asyncio.create_task(self._ask())]
        try:
            await self._wait_to_join(wait_s, tasks)
            while not self.over:
                self._raise_of(tasks)
                await self._tell_ended()
                if time.monotonic() - self._heard_s > SILENT_S:
                    raise ComponentError("live", f"the range at {text(self.phone.address)} fell silent")
                await asyncio.sleep(_LOOK_S)
        finally:
            for task in tasks:
                task.cancel()
            for program in self.programs.values():
                program.kill()

    async def _wait_to_join(self, wait_s: float, tasks: list[asyncio.Task[None]]) -> None:
        phone, until_s = self.phone, time.monotonic() + wait_s
        where = text(phone.address)
        while not self.welcome:
            self._raise_of(tasks)
            if phone.refused:
                hint = "Make one with `skyrange keys` in the folder that the range is started with."
                raise InputError.one(
                    "node", "key", f"the range at {where} does not know it", "a key of the range", hint
                )
            if phone.reached > _STRANGER:
                hint = "Take the key file from the folder that the range was started with."
                raise InputError.one("node", "key", f"who answers at {where} has another", "the key of the range", hint)
            if time.monotonic() > until_s:
                hint = "Start it there with `skyrange live`, and see that no firewall is between"
                raise ComponentError("node", f"no range answers at {where} within {wait_s:g} s", hint)
            await asyncio.sleep(_LOOK_S)
        self._heard_s = time.monotonic()

    @staticmethod
    def _raise_of(tasks: list[asyncio.Task[None]]) -> None:
        for task in tasks:
            if task.done():
                task.result()

    # --- what the range says -----------------------------------------------------------------------

    async def _listen(self) -> None:
        while True:
            said, blob = await self.phone.hear()
            self._heard_s = time.monotonic()
            await self._obey(said, blob)

    async def _obey(self, said: Message, blob: bytes) -> None:
        kind = said["kind"]
        if kind == "refused":
            raise InputError.one("node", "join", str(said["value"]), str(said["expected"]), str(said["hint"]))
        if kind == "welcome":
            self.welcome = True
            self.on_word(f"joined {said['name']} as {self.address}; its folder here is {self.root}")
        elif kind == "file":
            write_chunk(self.root, said["name"], int(said["offset"]), blob)
        elif kind == "node":
            orders = Orders.from_json(blob.decode())
            self.programs[orders.name] = start(self.root, orders)
            self._told.discard(orders.name)
            self.on_word(f"started {orders.name}")
        elif kind == "answer":
            self._echoes.append(Echo(int(said["sent_ns"]), int(said["answered_ns"]), time.monotonic_ns()))
        elif kind == "parts":
            names = json.dumps(listed(self.root / PARTS)).encode()
            await self.phone.tell("parts", names)
        elif kind == "fetch":
            data = read_chunk(self.root / PARTS, said["name"], int(said["offset"]))
            await self.phone.tell("chunk", data, name=said["name"], offset=said["offset"])
        elif kind == "over":
            self.over = True

    # --- what this machine says --------------------------------------------------------------------

    async def _ask(self) -> None:
        """The time, again and again."""
        while True:
            self._echoes.clear()
            for _ in range(_ECHOES):
                await self.phone.tell("ask", sent_ns=time.monotonic_ns())
                await asyncio.sleep(_ASK_S / _ECHOES / 4)
            await asyncio.sleep(_ASK_S)
            if self._echoes:
                echo = best(self._echoes)
                times = {"sent_ns": echo.sent_ns, "answered_ns": echo.answered_ns, "back_ns": echo.back_ns}
                await self.phone.tell("clock", **times)

    async def _tell_ended(self) -> None:
        for name, program in self.programs.items():
            if name not in self._told and not program.running:
                self._told.add(name)
                words = program.last_words()
                await self.phone.tell("ended", node=name, how=program.ended, words=words)
                self.on_word(f"{name} ended: {program.ended}")


def join(
    remote: Address, keys: Keys, address: str | None = None, *, wait_s: float = 60.0, on_word: OnWord = print
) -> None:
    """Offer this machine to the range at `remote`, and serve it to its end.

    `address` is where the others reach this machine, as the scenario's `hosts` name it; without it the one from which
    `remote` is reached. `InputError` for keys or versions that do not match, `ComponentError` where no range answers
    or it falls silent; then what was recorded stays, and the error says where.
    """
    own = address or _own_address(remote)
    root = Path(tempfile.mkdtemp(prefix="skyrange-node-"))
    try:
        asyncio.run(_join(remote, keys, own, root, wait_s, on_word))
    except ComponentError as error:
        kept = any((root / PARTS).glob("*/manifest.json"))
        if kept:
            raise ComponentError("node", str(error), f"What was recorded here is in {root / PARTS}") from error
        shutil.rmtree(root, ignore_errors=True)
        raise
    except BaseException:
        shutil.rmtree(root, ignore_errors=True)
        raise
    shutil.rmtree(root, ignore_errors=True)


async def _join(remote: Address, keys: Keys, own: str, root: Path, wait_s: float, on_word: OnWord) -> None:
    phone = Phone(f"{HOST_MARK}{own}", remote, keys)
    phone.open()
    on_word(f"waiting for a range at {text(remote)}")
    try:
        await Host(own, phone, root, on_word).serve(wait_s)
    finally:
        phone.close()


def _own_address(remote: Address) -> str:
    """The address from which the system would send to `remote`. Nothing is sent."""
    family = socket.AF_INET6 if ":" in remote[0] else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as tried:
        try:
            tried.connect(remote)
        except OSError as error:
            raise ComponentError("node", f"no way to {text(remote)}: {error.strerror or error}") from error
        return str(tried.getsockname()[0])
