"""Where do tap processes reach a node? A Unix socket in its folder of the run; who may write there may tap.

One connection is one link's tap: first the terms, then frames out and answers in, a line of JSON each. A line of
`{"program": true}` or `false` says whether anybody is there to answer.
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

from skyrange.agent.frames import Frame
from skyrange.core.errors import nearest
from skyrange.core.time import NEVER, Time
from skyrange.runtime.live.addresses import Crossing
from skyrange.runtime.live.tapping import OutsideTap, Record, Terms

DOOR: Final = "tap.sock"
LINE_BYTES: Final = 4 << 20
"""The longest line: what ground receivers heard in a step, in hexadecimal, is the longest payload."""
WAITING_BYTES: Final = 4 << 20
"""What may wait for a tap process that does not read; then its frames are dealt with as if nobody were there."""


def line(said: Mapping[str, Any]) -> bytes:
    """A line of JSON."""
    return json.dumps(said, separators=(",", ":")).encode() + b"\n"


@contextlib.contextmanager
def short(folder: Path) -> Iterator[str]:
    """A name of the door in `folder` that a Unix socket can have: paths over 107 bytes are none (unix(7))."""
    path = str(folder / DOOR)
    if len(os.fsencode(path)) < 104 or not Path("/proc/self/fd").is_dir():
        yield path
        return
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{held}/{DOOR}"
    finally:
        os.close(held)


class Taps:
    """All taps at one node's border."""

    def __init__(self, crossings: Sequence[Crossing], own: frozenset[str], record: Record) -> None:
        """`own` are the node's endpoints; `crossings` those of its links."""
        self._crossings = {one.link.name: one for one in crossings}
        self._own = own
        self._record = record
        self._taps: dict[str, OutsideTap] = {}
        self._lines: dict[str, asyncio.StreamWriter] = {}
        self._serials: dict[str, dict[str, int]] = {}
        self._server: asyncio.Server | None = None
        self._talks: set[asyncio.Task[None]] = set()
        self._now: Callable[[], Time | None] = _never
        self._awake = _nothing

    async def open(self, folder: Path, now: Callable[[], Time | None], awake: Callable[[], None]) -> None:
        """Let tap processes in. `now` is the range's time, None before it is known; `awake` is called for `turn`."""
        self._now, self._awake = now, awake
        with short(folder) as name:
            before = os.umask(0o177)
            try:
                self._server = await asyncio.start_unix_server(self._meet, name, limit=LINE_BYTES)
            finally:
                os.umask(before)

    @property
    def due(self) -> Time:
        """When `turn` has something to do."""
        return min((0 if tap.ready else tap.due for tap in self._taps.values()), default=NEVER)

    def holds(self, link: str) -> bool:
        """Whether the frames of a link are to be shown to a tap."""
        return link in self._taps

    def take(self, now: Time, frame: Frame, *, outgoing: bool) -> None:
        """A frame of a link that is tapped."""
        tap = self._taps[frame.link]
        writer = self._lines.get(frame.link)
        deaf = writer is None or writer.transport.get_write_buffer_size() > WAITING_BYTES
        asked = tap.take(now, frame, outgoing, deaf=deaf)
        if asked is not None and writer is not None:
            writer.write(line(asked))

    def turn(self, now: Time) -> list[tuple[Frame, bool]]:
        """What is to go on now, and whether it leaves this node."""
        going: list[tuple[Frame, bool]] = []
        for tap in self._taps.values():
            tap.turn(now)
            if tap.ready:
                going += tap.ready
                tap.ready = []
        return going

    def close(self, now: Time) -> None:
        """The run is over here."""
        if self._server is not None:
            self._server.close()
        for talk in self._talks:
            talk.cancel()
        for name, writer in self._lines.items():
            writer.write(line({"end": asdict(self._taps[name].counts)}))
            writer.close()
        for tap in self._taps.values():
            tap.end(now)

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        talk = asyncio.current_task()
        assert talk is not None
        self._talks.add(talk)
        try:
            await self._talk(reader, writer)
        except (OSError, ValueError):  # it has gone, or said a line that is too long
            pass
        finally:
            self._talks.discard(talk)
            writer.close()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        tap = self._attached(await reader.readline())
        if isinstance(tap, str):
            writer.write(line({"error": tap}))
            await writer.drain()
            return
        name = tap.spec.name
        self._lines[name] = writer
        writer.write(line(tap.hello))
        tap.note(self._at(), "attached")
        try:
            while said := await reader.readline():
                wrong = self._heard(tap, said)
                if wrong:
                    writer.write(line({"error": wrong}))
                if writer.transport.get_write_buffer_size() > WAITING_BYTES:
                    return
                self._awake()
        finally:
            if self._lines.get(name) is writer and not self._closed:
                del self._lines[name]
                tap.come(self._at(), False)
                tap.note(self._at(), "detached")
                self._awake()

    @property
    def _closed(self) -> bool:
        return self._server is not None and not self._server.is_serving()

    def _heard(self, tap: OutsideTap, said: bytes) -> str:
        if said.strip() in (b'{"program":true}', b'{"program":false}'):
            tap.come(self._at(), b"true" in said)
            return ""
        if self._now() is None:
            return "the range does not fly yet"
        return tap.answer(self._at(), said)

    def _attached(self, said: bytes) -> OutsideTap | str:
        """A new tap on the terms that were said, or why there is none."""
        try:
            terms = Terms.model_validate_json(said)
        except ValidationError as error:
            return str(error.errors(include_url=False, include_input=False)[0]["msg"])
        crossing = self._crossings.get(terms.link)
        if crossing is None:
            hint = nearest(terms.link, self._crossings)
            return f"{terms.link} does not come out of this process{f'; {hint}' if hint else ''}"
        if terms.link in self._lines:
            return f"{terms.link} is tapped already"
        side = next(end for end in (crossing.link.a, crossing.link.b) if end in self._own)
        units = crossing.transport in ("udp", "tcp")
        serials = self._serials.setdefault(f"{terms.name}@{terms.link}", {})
        tap = OutsideTap(terms, crossing.link, side, units, self._record, serials)
        before = self._taps.get(terms.link)
        if before is not None:
            tap.succeed(before)
        self._taps[terms.link] = tap
        return tap

    def _at(self) -> Time:
        now = self._now()
        return 0 if now is None else max(now, 0)


def _never() -> Time | None:
    return None


def _nothing() -> None:
    return
