"""Tap server of a node: a Unix socket in the node's folder of the run; whoever may write there may tap.

One connection is one link's tap: first its terms, then frames out and verdicts in, a line of JSON each. The line
`{"program": true}` or `false` says whether a program is there to answer.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from skyrange.contracts.frames import Frame
from skyrange.core.errors import nearest
from skyrange.core.time import NEVER, Time
from skyrange.io.limited_listener import LimitedListener, listen_unix, stream_factory
from skyrange.runtime.live.taps.external_tap import ExternalTap, Record, TapTerms
from skyrange.runtime.live.transport.addresses import Crossing

SOCKET: Final = "tap.sock"
MAX_LINE_BYTES: Final = 4 << 20
"""Longest line: what ground receivers received in a step, in hexadecimal, is the longest payload."""
HELLO_S: Final = 5.0
"""Seconds in which a tap process has to send its terms."""
MAX_CONNECTIONS: Final = 64
"""Tap processes at one node at a time."""
MAX_WAITING_BYTES: Final = 4 << 20
"""What may wait for a tap process that does not read; then its frames are dealt with as if no program were there."""


def line_of(message: Mapping[str, Any]) -> bytes:
    """A message as a line of JSON."""
    return json.dumps(message, separators=(",", ":")).encode() + b"\n"


@contextlib.contextmanager
def socket_path(folder: Path) -> Iterator[str]:
    """A path of the socket in `folder` that a Unix socket can have: at most 107 bytes long (unix(7))."""
    path = str(folder / SOCKET)
    if len(os.fsencode(path)) < 104 or not Path("/proc/self/fd").is_dir():
        yield path
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{descriptor}/{SOCKET}"
    finally:
        os.close(descriptor)


class TapServer:
    """All taps on the links that leave one node."""

    def __init__(self, crossings: Sequence[Crossing], endpoints: frozenset[str], record: Record) -> None:
        """`endpoints` are the node's endpoints; `crossings` those of its links."""
        self._crossings = {crossing.link.name: crossing for crossing in crossings}
        self._own = endpoints
        self._record = record
        self._taps: dict[str, ExternalTap] = {}
        self._writers: dict[str, asyncio.StreamWriter] = {}
        self._serials: dict[str, dict[str, int]] = {}
        self._listener: LimitedListener | None = None
        self._closed = False
        self._connections: set[asyncio.Task[None]] = set()
        self._now: Callable[[], Time | None] = _no_time
        self._wake = _do_nothing

    async def open(self, folder: Path, now: Callable[[], Time | None], wake: Callable[[], None]) -> None:
        """Let tap processes in. `now` is the range's time, None before it is known; `wake` is called for `turn`."""
        self._now, self._wake = now, wake
        with socket_path(folder) as path:
            self._listener = listen_unix(stream_factory(self._accept, MAX_LINE_BYTES), path, most=MAX_CONNECTIONS)

    @property
    def due(self) -> Time:
        """When `turn` has something to do."""
        return min((0 if tap.ready else tap.due for tap in self._taps.values()), default=NEVER)

    def holds(self, link: str) -> bool:
        """Whether the frames of a link go through a tap."""
        return link in self._taps

    def take(self, now: Time, frame: Frame, *, outgoing: bool) -> None:
        """Hand a frame of a link that is tapped to its tap."""
        tap = self._taps[frame.link]
        writer = self._writers.get(frame.link)
        deaf = writer is None or writer.transport.get_write_buffer_size() > MAX_WAITING_BYTES
        message = tap.take(now, frame, outgoing=outgoing, deaf=deaf)
        if message is not None and writer is not None:
            writer.write(line_of(message))

    def turn(self, now: Time) -> list[tuple[Frame, bool]]:
        """Frames that go on now, and whether each leaves this node."""
        going: list[tuple[Frame, bool]] = []
        for tap in self._taps.values():
            tap.turn(now)
            if tap.ready:
                going += tap.ready
                tap.ready = []
        return going

    def close(self, now: Time) -> None:
        """End all taps: the run is over here."""
        self._closed = True
        if self._listener is not None:
            self._listener.close()
        for connection in self._connections:
            connection.cancel()
        for name, writer in self._writers.items():
            writer.write(line_of({"end": asdict(self._taps[name].counts)}))
            writer.close()
        for tap in self._taps.values():
            tap.end(now)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connection = asyncio.current_task()
        assert connection is not None
        self._connections.add(connection)
        try:
            await self._serve(reader, writer)
        except (OSError, ValueError):  # it has gone, or sent a line that is too long
            pass
        except asyncio.CancelledError:
            if not self._closed:  # by `close`: asyncio would report the end of the range as an error
                raise
        finally:
            self._connections.discard(connection)
            writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async with asyncio.timeout(HELLO_S):
            hello = await reader.readline()
        tap = self._attach(hello)
        if isinstance(tap, str):
            writer.write(line_of({"error": tap}))
            await writer.drain()
            return
        name = tap.spec.name
        self._writers[name] = writer
        writer.write(line_of(tap.hello))
        tap.note(self._at(), "attached")
        try:
            while line := await reader.readline():
                problem = self._handle_line(tap, line)
                if problem:
                    writer.write(line_of({"error": problem}))
                if writer.transport.get_write_buffer_size() > MAX_WAITING_BYTES:
                    return
                self._wake()
        finally:
            if self._writers.get(name) is writer and not self._closed:
                del self._writers[name]
                tap.set_present(self._at(), there=False)
                tap.note(self._at(), "detached")
                self._wake()

    def _handle_line(self, tap: ExternalTap, line: bytes) -> str:
        """Act on a line of a tap process; what is wrong with it, "" for nothing."""
        if line.strip() in (b'{"program":true}', b'{"program":false}'):
            tap.set_present(self._at(), there=b"true" in line)
            return ""
        if self._now() is None:
            return "the range does not fly yet"
        return tap.answer(self._at(), line)

    def _attach(self, line: bytes) -> ExternalTap | str:
        """A new tap on the terms in `line`, or why there is none."""
        try:
            terms = TapTerms.model_validate_json(line)
        except ValidationError as error:
            return str(error.errors(include_url=False, include_input=False)[0]["msg"])
        crossing = self._crossings.get(terms.link)
        if crossing is None:
            hint = nearest(terms.link, self._crossings)
            return f"{terms.link} does not come out of this process{f'; {hint}' if hint else ''}"
        if terms.link in self._writers:
            return f"{terms.link} is tapped already"
        side = next(end for end in (crossing.link.a, crossing.link.b) if end in self._own)
        units = crossing.transport in ("udp", "tcp")
        serials = self._serials.setdefault(f"{terms.name}@{terms.link}", {})
        tap = ExternalTap(terms, crossing.link, side, units, self._record, serials)
        before = self._taps.get(terms.link)
        if before is not None:
            tap.succeed(before)
        self._taps[terms.link] = tap
        return tap

    def _at(self) -> Time:
        now = self._now()
        return 0 if now is None else max(now, 0)


def _no_time() -> Time | None:
    return None


def _do_nothing() -> None:
    return
