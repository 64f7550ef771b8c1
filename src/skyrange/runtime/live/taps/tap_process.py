"""Tap process: connects a user's program with the node at whose end of a link it stands, by lines of JSON.

`skyrange tap` finds the node by the run's folder, and listens for the program at an address of the loopback. The
node holds the frames and their times, so this process may die, and so may the program.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import ComponentError, InputError, Problem, nearest
from skyrange.core.time import NS_PER_S
from skyrange.core.whole_numbers import parse_whole
from skyrange.io.limited_listener import listen, stream_factory
from skyrange.record.folder import PARTS
from skyrange.record.manifest import MANIFEST
from skyrange.runtime.live.clock import Clock, MonotonicClock
from skyrange.runtime.live.config import CONFIG_FILE
from skyrange.runtime.live.deployment import LOOPBACK
from skyrange.runtime.live.taps.external_tap import TapTerms
from skyrange.runtime.live.taps.tap_server import MAX_LINE_BYTES, MAX_WAITING_BYTES, SOCKET, line_of, socket_path

RETRY_S: Final = 0.1
"""Between two attempts to reach the node."""
END_S: Final = 1.0
"""How long a program's connection may take to end after the range."""
OnWord = Callable[[str], None]
"""Called with a line for the user."""


@dataclass(slots=True)
class TapProcess:
    """A tap's process: its terms, the address for its program, and the counts of what happened."""

    terms: TapTerms
    listen: tuple[str, int]
    """Port 0 takes any that is free."""
    run: Path
    wait_s: float = 60.0
    """How long it waits for the range to be there."""
    clock: Clock = field(default_factory=MonotonicClock)
    counts: Mapping[str, int] = field(default_factory=dict)
    """The node's counts at the end; empty where the range broke off."""
    _program: asyncio.StreamWriter | None = None
    _hello: bytes = b""
    _serving: set[asyncio.Task[Any]] = field(default_factory=set)

    def serve(self, on_word: OnWord) -> None:
        """Serve until the range ends. `InputError` for a link that is not there or an address that cannot be had."""
        asyncio.run(self.relay(on_word))

    async def relay(self, on_word: OnWord) -> None:
        """`serve`, in a running event loop."""
        reader, node = await self._attach()
        try:
            listener = await listen(
                stream_factory(lambda r, w: self._serve_program(r, w, node), MAX_LINE_BYTES), *self.listen
            )
        except OSError as error:
            node.close()
            where = f"{self.listen[0]}:{self.listen[1]}"
            raise InputError.one("tap", "--listen", where, f"an address that is free ({error.strerror})") from error
        host, port = listener.address[:2]
        on_word(f"{self.terms.link} is tapped; a program may call {host}:{port}")
        try:
            while line := await reader.readline():
                self._forward(line)
        except (OSError, ValueError) as error:
            raise ComponentError("tap", f"the range broke off: {error}") from error
        finally:
            listener.close()
            if self._program is not None:
                self._program.close()
            await self._end_serving()
            node.close()

    async def _end_serving(self) -> None:
        """Let the tasks that serve programs end, because a task that the loop cancels is reported as an error."""
        if self._serving:
            await asyncio.wait(self._serving, timeout=END_S)
        for task in self._serving:
            task.cancel()

    async def _attach(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Connect to the tap socket of the link's node, once it is there."""
        deadline_ns = self.clock.monotonic_ns() + self.wait_s * NS_PER_S
        while True:
            folder = find_node_folder(self.run, self.terms.link)
            if folder is not None:
                try:
                    with socket_path(folder) as path:
                        reader, node = await asyncio.open_unix_connection(path, limit=MAX_LINE_BYTES)
                    break
                except OSError:
                    pass
            if self.clock.monotonic_ns() > deadline_ns:
                raise InputError.one("tap", "--run", str(self.run), "the folder of a live range that flies")
            await asyncio.sleep(RETRY_S)
        node.write(line_of(self.terms.model_dump()))
        hello = await reader.readline()
        answer = json.loads(hello) if hello else {"error": "the range has ended"}
        if "error" in answer:
            node.close()
            raise InputError.one("tap", "LINK", self.terms.link, str(answer["error"]))
        self._hello = hello
        return reader, node

    async def _serve_program(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, node: asyncio.StreamWriter
    ) -> None:
        """Serve a program that has connected: one at a time, and none is turned away silently."""
        if self._program is not None:
            writer.write(line_of({"error": "a program is there already"}))
            writer.close()
            return
        self._program = writer
        task = asyncio.current_task()
        assert task is not None
        self._serving.add(task)
        writer.write(self._hello)
        node.write(line_of({"program": True}))
        try:
            while line := await reader.readline():
                node.write(line if line.endswith(b"\n") else line + b"\n")
                await node.drain()
        except (OSError, ValueError):  # it has gone, or sent a line that is too long
            pass
        except asyncio.CancelledError:  # the range has ended, and the program did not read on
            pass
        finally:
            self._serving.discard(task)
            self._program = None
            node.write(line_of({"program": False}))
            writer.close()

    def _forward(self, line: bytes) -> None:
        """Pass a line of the node on to the program."""
        if line.startswith(b'{"end":'):
            self.counts = json.loads(line)["end"]
        program = self._program
        # a program that does not read loses frames: the node deals with them as with those that get no answer
        if program is not None and program.transport.get_write_buffer_size() < MAX_WAITING_BYTES:
            program.write(line)


def find_node_folder(run: Path, link: str) -> Path | None:
    """The folder with the tap socket of the node at which a link is tapped; `None` before it is there.

    That is the node of the listening end, or the other where that end is no process of the range. `InputError` for a
    link that does not cross between processes, and for a range that has ended.
    """
    folder_by_link: dict[str, Path] = {}
    folders = [path.parent for path in sorted((run / PARTS).glob(f"*.program/{CONFIG_FILE}"))]
    for folder in folders:
        config = _read_json(folder / CONFIG_FILE)
        if config is None:
            return None
        for crossing in config["crossings"]:
            if crossing["listener"] in config["endpoints"] or crossing["link"]["name"] not in folder_by_link:
                folder_by_link[crossing["link"]["name"]] = folder
    if link in folder_by_link:
        return folder_by_link[link] if (folder_by_link[link] / SOCKET).exists() else None
    if folders and all((folder / SOCKET).exists() for folder in folders):
        hint = f"{nearest(link, folder_by_link)} One within a process has no socket: --group component gives each its "
        hint += "own. One between other machines is tapped on one of those."
        raise InputError("tap", [Problem("LINK", link, "a link that crosses between processes", hint)])
    status = (_read_json(run / MANIFEST) or {}).get("status", "running")
    if status != "running":
        raise InputError.one("tap", "--run", f"{run} ({status})", "a live range that flies")
    return None


def _read_json(path: Path) -> dict[str, Any] | None:
    """The JSON object in a file; `None` while there is none, or half of one."""
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def parse_loopback(address: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`; `InputError` unless it is on the loopback, since a tap has no keys."""
    host, _, port = address.rpartition(":")
    number = parse_whole(port)
    if host not in (LOOPBACK, "localhost", "") or number is None or number > 65_535:
        hint = "From another machine let ssh carry it: ssh -L."
        raise InputError(
            "tap", [Problem("--listen", address, f"a port of the loopback, such as {LOOPBACK}:7000", hint)]
        )
    return LOOPBACK, number
