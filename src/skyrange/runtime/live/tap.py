"""How does a program of anybody's come to stand on a link? A process between it and the link's node, lines both ways.

`skyrange tap` finds the node by the run's folder, and listens for the program at an address of the loopback. The
node holds the frames and their times: this process may die, and so may the program.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import ComponentError, Fault, InputError, nearest
from skyrange.record.folder import PARTS
from skyrange.record.manifest import MANIFEST
from skyrange.runtime.live.plan import LOOPBACK
from skyrange.runtime.live.tap_door import DOOR, LINE_BYTES, WAITING_BYTES, line, short
from skyrange.runtime.live.tapping import Terms

ORDERS: Final = "orders.json"
"""What a node is told, in its folder."""
AGAIN_S: Final = 0.1
Said = Callable[[str], None]


@dataclass(slots=True)
class Tapping:
    """A tap's process: on which terms, where its program calls, and what came of it."""

    terms: Terms
    listen: tuple[str, int]
    """Port 0 takes any that is free."""
    run: Path
    wait_s: float = 60.0
    """So long it waits for the range to be there."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """As the node has them at the end; empty where it ended otherwise."""
    _program: asyncio.StreamWriter | None = None
    _hello: bytes = b""

    def serve(self, say: Said) -> None:
        """Until the range ends. `InputError` for a link that is not there or an address that cannot be had."""
        asyncio.run(self.run_until_the_end(say))

    async def run_until_the_end(self, say: Said) -> None:
        """The same within an event loop."""
        reader, door = await self._enter()
        try:
            server = await asyncio.start_server(lambda r, w: self._meet(r, w, door), *self.listen, limit=LINE_BYTES)
        except OSError as error:
            door.close()
            where = f"{self.listen[0]}:{self.listen[1]}"
            raise InputError.one("tap", "--listen", where, f"an address that is free ({error.strerror})") from error
        host, port = server.sockets[0].getsockname()[:2]
        say(f"{self.terms.link} is tapped; a program may call {host}:{port}")
        try:
            while said := await reader.readline():
                self._forward(said)
        except (OSError, ValueError) as error:
            raise ComponentError("tap", f"the range broke off: {error}") from error
        finally:
            server.close()
            door.close()
            if self._program is not None:
                self._program.close()

    async def _enter(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Through the door of the link's node, once it is there."""
        deadline = time.monotonic() + self.wait_s
        while True:
            folder = node_of(self.run, self.terms.link)
            if folder is not None:
                try:
                    with short(folder) as name:
                        reader, door = await asyncio.open_unix_connection(name, limit=LINE_BYTES)
                    break
                except OSError:
                    pass
            if time.monotonic() > deadline:
                raise InputError.one("tap", "--run", str(self.run), "the folder of a live range that flies")
            await asyncio.sleep(AGAIN_S)
        door.write(line(self.terms.model_dump()))
        said = await reader.readline()
        answer = json.loads(said) if said else {"error": "the range has ended"}
        if "error" in answer:
            door.close()
            raise InputError.one("tap", "LINK", self.terms.link, str(answer["error"]))
        self._hello = said
        return reader, door

    async def _meet(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, door: asyncio.StreamWriter
    ) -> None:
        """A program calls: one at a time, and none is turned away silently."""
        if self._program is not None:
            writer.write(line({"error": "a program is there already"}))
            writer.close()
            return
        self._program = writer
        writer.write(self._hello)
        door.write(line({"program": True}))
        try:
            while said := await reader.readline():
                door.write(said if said.endswith(b"\n") else said + b"\n")
                await door.drain()
        except (OSError, ValueError):  # it has gone, or said a line that is too long
            pass
        finally:
            self._program = None
            door.write(line({"program": False}))
            writer.close()

    def _forward(self, said: bytes) -> None:
        if said.startswith(b'{"end":'):
            self.counts = json.loads(said)["end"]
        program = self._program
        # one that does not read loses frames: the node deals with them as with those that get no answer
        if program is not None and program.transport.get_write_buffer_size() < WAITING_BYTES:
            program.write(said)


def node_of(run: Path, link: str) -> Path | None:
    """The folder with the door of the node at whose socket a link is tapped; `None` before it is there.

    That is the end which listens, or the other where that one is no process of the range. `InputError` for a link
    that does not cross between processes, and for a range that has ended.
    """
    found: dict[str, Path] = {}
    folders = [path.parent for path in sorted((run / PARTS).glob(f"*.program/{ORDERS}"))]
    for folder in folders:
        orders = _read(folder / ORDERS)
        if orders is None:
            return None
        for crossing in orders["crossings"]:
            if crossing["listener"] in orders["endpoints"] or crossing["link"]["name"] not in found:
                found[crossing["link"]["name"]] = folder
    if link in found:
        return found[link] if (found[link] / DOOR).exists() else None
    if folders and all((folder / DOOR).exists() for folder in folders):
        hint = f"{nearest(link, found)} One within a process has no socket: --group component gives each its own. "
        hint += "One between other machines is tapped on one of those."
        raise InputError("tap", [Fault("LINK", link, "a link that crosses between processes", hint)])
    status = (_read(run / MANIFEST) or {}).get("status", "running")
    if status != "running":
        raise InputError.one("tap", "--run", f"{run} ({status})", "a live range that flies")
    return None


def _read(path: Path) -> dict[str, Any] | None:
    """A JSON object, `None` while there is none, or half of one."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def loopback(address: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`, `InputError` unless it is the loopback's: a tap has no keys."""
    host, _, port = address.rpartition(":")
    if host not in (LOOPBACK, "localhost", "") or not port.isdecimal() or int(port) > 65_535:
        hint = "From another machine let ssh carry it: ssh -L."
        raise InputError("tap", [Fault("--listen", address, f"a port of the loopback, such as {LOOPBACK}:7000", hint)])
    return LOOPBACK, int(port)
