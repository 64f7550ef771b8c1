"""Agent of a machine that has joined a live range: starts the processes it is told to, hands over their records.

It asks for the time all along, so that its clock is known; it reports every process that ends; and when the range falls
silent it ends them all and keeps what they recorded.
"""

from __future__ import annotations

import asyncio
import json
import shutil
import socket
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from skyrange import __version__
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import NS_PER_S
from skyrange.io.addresses import format_address
from skyrange.io.mavlink.transports import Address
from skyrange.io.zeromq.curve_keys import Keys
from skyrange.record.folder import PARTS
from skyrange.runtime.live.clock import ClockSample, quickest_sample
from skyrange.runtime.live.config import NodeConfig
from skyrange.runtime.live.system import Process, RealSystem, System
from skyrange.runtime.live.transport.control import ControlClient, Message, list_files, read_chunk, write_chunk

HOST_PREFIX: Final = "@"
"""What a machine's name at the control socket begins with; a node's never does."""
SILENT_S: Final = 10.0
"""The other side is taken to be gone when it has sent nothing for so long."""
_ASK_S: Final = 1.0
_SAMPLES: Final = 5
"""Requests for the time in a row, of which the quickest counts."""
_UPDATE_S: Final = 0.1
_STRANGER: Final = 3
"""Connections after which a peer that never answers is taken to have other keys."""

OnWord = Callable[[str], None]
"""Called with a line for the user."""


@dataclass(slots=True)
class HostAgent:
    """A machine in one range, from joining it to its end."""

    address: str
    client: ControlClient
    root: Path
    on_word: OnWord
    system: System = field(default_factory=RealSystem)
    processes: dict[str, Process] = field(default_factory=dict)
    welcome: bool = False
    over: bool = False
    _reported: set[str] = field(default_factory=set)
    _heard_ns: int = 0
    _samples: list[ClockSample] = field(default_factory=list)

    async def serve(self, wait_s: float) -> None:
        """Join, do as told, and end with the range.

        `InputError` for keys or versions that do not match; `ComponentError` where no range answers within `wait_s`, or
        the range falls silent.
        """
        await self.client.send("join", version=__version__, address=self.address)
        tasks = [asyncio.create_task(self._receive()), asyncio.create_task(self._measure_clock())]
        try:
            await self._wait_to_join(wait_s, tasks)
            while not self.over:
                self._raise_of(tasks)
                await self._report_ended()
                if self._now_ns() - self._heard_ns > SILENT_S * NS_PER_S:
                    raise ComponentError("live", f"the range at {format_address(self.client.address)} fell silent")
                await asyncio.sleep(_UPDATE_S)
        finally:
            for task in tasks:
                task.cancel()
            for process in self.processes.values():
                process.kill()

    def _now_ns(self) -> int:
        return self.system.clock.monotonic_ns()

    async def _wait_to_join(self, wait_s: float, tasks: list[asyncio.Task[None]]) -> None:
        client, until_ns = self.client, self._now_ns() + wait_s * NS_PER_S
        where = format_address(client.address)
        while not self.welcome:
            self._raise_of(tasks)
            if client.refused:
                hint = "Make one with `skyrange keys` in the folder that the range is started with."
                raise InputError.one(
                    "node", "key", f"the range at {where} does not know it", "a key of the range", hint
                )
            if client.reached > _STRANGER:
                hint = "Take the key file from the folder that the range was started with."
                raise InputError.one("node", "key", f"who answers at {where} has another", "the key of the range", hint)
            if self._now_ns() > until_ns:
                hint = "Start it there with `skyrange live`, and see that no firewall is between"
                raise ComponentError("node", f"no range answers at {where} within {wait_s:g} s", hint)
            await asyncio.sleep(_UPDATE_S)
        self._heard_ns = self._now_ns()

    @staticmethod
    def _raise_of(tasks: list[asyncio.Task[None]]) -> None:
        for task in tasks:
            if task.done():
                task.result()

    # --- messages of the range ---------------------------------------------------------------------

    async def _receive(self) -> None:
        while True:
            message, blob = await self.client.receive()
            self._heard_ns = self._now_ns()
            await self._obey(message, blob)

    async def _obey(self, message: Message, blob: bytes) -> None:
        kind = message["kind"]
        if kind == "refused":
            value, expected, hint = (str(message[key]) for key in ("value", "expected", "hint"))
            raise InputError.one("node", "join", value, expected, hint)
        if kind == "welcome":
            self.welcome = True
            self.on_word(f"joined {message['name']} as {self.address}; its folder here is {self.root}")
        elif kind == "file":
            write_chunk(self.root, message["name"], int(message["offset"]), blob)
        elif kind == "node":
            config = NodeConfig.from_json(blob.decode())
            self.processes[config.name] = self.system.start_node(self.root, config)
            self._reported.discard(config.name)
            self.on_word(f"started {config.name}")
        elif kind == "answer":
            self._samples.append(ClockSample(int(message["sent_ns"]), int(message["answered_ns"]), self._now_ns()))
        elif kind == "parts":
            names = json.dumps(list_files(self.root / PARTS)).encode()
            await self.client.send("parts", names)
        elif kind == "fetch":
            data = read_chunk(self.root / PARTS, message["name"], int(message["offset"]))
            await self.client.send("chunk", data, name=message["name"], offset=message["offset"])
        elif kind == "over":
            self.over = True

    # --- messages of this machine ------------------------------------------------------------------

    async def _measure_clock(self) -> None:
        """Ask for the time, again and again."""
        while True:
            self._samples.clear()
            for _ in range(_SAMPLES):
                await self.client.send("ask", sent_ns=self._now_ns())
                await asyncio.sleep(_ASK_S / _SAMPLES / 4)
            await asyncio.sleep(_ASK_S)
            if self._samples:
                sample = quickest_sample(self._samples)
                times = {"sent_ns": sample.sent_ns, "answered_ns": sample.answered_ns, "back_ns": sample.received_ns}
                await self.client.send("clock", **times)

    async def _report_ended(self) -> None:
        for name, process in self.processes.items():
            if name not in self._reported and not process.running:
                self._reported.add(name)
                output = process.last_words()
                await self.client.send("ended", node=name, how=process.ended, words=output)
                self.on_word(f"{name} ended: {process.ended}")


def join_range(
    remote: Address, keys: Keys, address: str | None = None, *, wait_s: float = 60.0, on_word: OnWord = print
) -> None:
    """Offer this machine to the range at `remote`, and serve it to its end.

    `address` is where the others reach this machine, as the scenario's `hosts` name it; without it the one from which
    `remote` is reached. `InputError` for keys or versions that do not match, `ComponentError` where no range answers
    or it falls silent; then what was recorded stays, and the error says where.
    """
    system = RealSystem()
    host_address = address or _own_address(remote)
    system.run(serve_range(remote, keys, host_address, wait_s=wait_s, on_word=on_word, system=system))


async def serve_range(
    remote: Address, keys: Keys, address: str, *, wait_s: float, on_word: OnWord, system: System
) -> None:
    """`join_range`, in a running event loop, with the address `address`."""
    root = Path(tempfile.mkdtemp(prefix="skyrange-node-"))
    client = system.control_client(f"{HOST_PREFIX}{address}", remote, keys)
    client.open()
    on_word(f"waiting for a range at {format_address(remote)}")
    try:
        await HostAgent(address, client, root, on_word, system).serve(wait_s)
    except ComponentError as error:
        kept = any((root / PARTS).glob("*/manifest.json"))
        if kept:
            raise ComponentError("node", str(error), f"What was recorded here is in {root / PARTS}") from error
        shutil.rmtree(root, ignore_errors=True)
        raise
    except BaseException:
        shutil.rmtree(root, ignore_errors=True)
        raise
    else:
        shutil.rmtree(root, ignore_errors=True)
    finally:
        client.close()


def _own_address(remote: Address) -> str:
    """The address from which the system would send to `remote`. Nothing is sent."""
    family = socket.AF_INET6 if ":" in remote[0] else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as tried:
        try:
            tried.connect(remote)
        except OSError as error:
            raise ComponentError("node", f"no way to {format_address(remote)}: {error.strerror or error}") from error
        return str(tried.getsockname()[0])
