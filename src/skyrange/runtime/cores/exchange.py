"""Exchange of bytes among the processes of a run through shared memory, in rounds in which all take part.

Every process writes its part of a round, and reads the parts of all others when all have written. Each has two areas,
used in turn: it writes to one again only after all have begun the next round, that is, have read the last. A byte in a
pipe for each pair of processes says that a part is written; if a process ends, its pipes close, and the others notice.
"""

from __future__ import annotations

import mmap
import os
import struct
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from skyrange.core.errors import ComponentError

_HEADER: Final = struct.Struct("<qqq")  # what the round is for, simulated time, size of the whole part
_FAILED: Final = -1
AREA_BYTES: Final = 1 << 20
"""Size of one area; a longer part is exchanged in pieces."""


class CoreFailedError(ComponentError):
    """Another process of the run failed, or was ended; the one that failed has the reason too."""


class Exchange:
    """Shared memory and pipes of `count` processes. Make it before they are forked; each then calls `join`."""

    def __init__(self, count: int, area_bytes: int = AREA_BYTES) -> None:
        self.count = count
        self.area_bytes = area_bytes
        self._memory = mmap.mmap(-1, count * 2 * (_HEADER.size + area_bytes))
        self._pipes = {(a, b): os.pipe() for a in range(count) for b in range(count) if a != b}

    def join(self, member: int) -> Member:
        """Take part as process `member` of 0 … `count` - 1: the ends of pipes that belong to others are closed."""
        readers, writers = {}, {}
        for (source, target), (reader, writer) in self._pipes.items():
            if target == member:
                readers[source] = reader
            else:
                os.close(reader)
            if source == member:
                writers[target] = writer
            else:
                os.close(writer)
        self._pipes = {}
        return Member(member, self, memoryview(self._memory), readers, writers)


class Member:
    """A process's part in an exchange."""

    def __init__(
        self, number: int, exchange: Exchange, memory: memoryview, readers: dict[int, int], writers: dict[int, int]
    ) -> None:
        """Use `Exchange.join`."""
        self.number = number
        self.count = exchange.count
        self._area_bytes = exchange.area_bytes
        self._memory = memory
        self._readers = readers
        self._writers = writers
        self._round = 0
        self.waited_s = 0.0
        """Wall seconds for which it has waited for others."""

    def gather(self, purpose: int, now: int, part: bytes) -> list[bytes]:
        """Exchange `part` for those of all others; returns all in order of their processes, the own among them.

        `purpose` and `now` are equal in all processes in a round, or they are out of step. Raises `CoreFailedError`
        if another process has failed or ended.
        """
        sizes = self._write_and_read(purpose, now, len(part), part[: self._area_bytes])
        whole = [bytearray() for _ in range(self.count)]
        for begin in range(0, max(*sizes, 1), self._area_bytes):
            if begin:
                self._write_and_read(purpose, now, len(part), part[begin : begin + self._area_bytes])
            for member, size in enumerate(sizes):
                piece = min(max(size - begin, 0), self._area_bytes)
                if piece and member != self.number:
                    at = self._place(member, self._round - 1) + _HEADER.size
                    whole[member] += self._memory[at : at + piece]
        return [part if member == self.number else bytes(got) for member, got in enumerate(whole)]

    def fail(self, reason: str) -> None:
        """Tell all others, in place of the next round, that this process has failed."""
        data = reason.encode()[: self._area_bytes]
        self._write(_FAILED, 0, len(data), data)
        for target in self._writers:
            self._post(target)

    def close(self) -> None:
        """Leave: close the pipes. Again does nothing."""
        for end in (*self._readers.values(), *self._writers.values()):
            os.close(end)
        self._readers, self._writers = {}, {}

    def _write_and_read(self, purpose: int, now: int, size: int, piece: bytes) -> Sequence[int]:
        """One round: write a piece, wait for all others, and return the sizes of all parts."""
        self._write(purpose, now, size, piece)
        for target in self._writers:
            self._post(target)
        began = time.perf_counter()
        for source, reader in self._readers.items():
            if not os.read(reader, 1):
                raise CoreFailedError(f"core {source}", "its process ended unexpectedly")
        self.waited_s += time.perf_counter() - began
        sizes = []
        for member in range(self.count):
            at = self._place(member, self._round)
            theirs, then, found = _HEADER.unpack(self._memory[at : at + _HEADER.size])
            if theirs == _FAILED:
                start = at + _HEADER.size
                raise CoreFailedError(f"core {member}", bytes(self._memory[start : start + found]).decode())
            if (theirs, then) != (purpose, now):
                raise ComponentError(
                    "cores",
                    f"out of step: core {self.number} is at {(purpose, now)}, core {member} at {(theirs, then)}",
                )
            sizes.append(found)
        self._round += 1
        return sizes

    def _write(self, purpose: int, now: int, size: int, piece: bytes) -> None:
        at = self._place(self.number, self._round)
        start = at + _HEADER.size
        self._memory[start : start + len(piece)] = piece
        self._memory[at:start] = _HEADER.pack(purpose, now, size)

    def _post(self, target: int) -> None:
        with suppress(BrokenPipeError):  # what was left in the other pipe tells why it ended
            os.write(self._writers[target], b"\0")

    def _place(self, member: int, number: int) -> int:
        """Where the area of a process for a round begins."""
        return (2 * member + number % 2) * (_HEADER.size + self._area_bytes)
