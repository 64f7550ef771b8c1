"""Exchange of bytes among the processes of a run through shared memory, in rounds in which all take part.

Rounds have topics, each with an order of its own. In a round every process posts its part, and collects the
parts of all when it needs them, at the latest before it posts the second part after it: so a process may be a round
ahead of the others, and need not wait for each of them each time. An area of a topic is written to again when all have
read it. A byte in a pipe for each pair of processes says on which topic a part was posted; if a process ends,
its pipes close, and the others notice.
"""

from __future__ import annotations

import mmap
import os
import struct
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from enum import IntEnum
from typing import Final

from skyrange.core.errors import ComponentError

_HEADER: Final = struct.Struct("<qq")  # simulated time, size of the whole part
AREA_BYTES: Final = 1 << 20
"""Size of one area; a longer part is exchanged in pieces."""
MAX_AHEAD: Final = 1
"""Rounds of a topic that a process may have posted beside the one that it is to collect next."""
_AREAS: Final = 2 * (MAX_AHEAD + 1)
"""Areas of a process for a topic. One that posts round p has collected p - 1 - MAX_AHEAD, for which the others posted
it, so they had collected p - 2 - 2 MAX_AHEAD: what they have not read yet is in the areas after that one."""
_FAILED: Final = 255
_READ_BYTES: Final = 256


class Topic(IntEnum):
    """What rounds are for."""

    START = 0
    BARRIER = 1
    RADIO = 2
    END = 3
    PIECES = 4
    """The rest of parts that are longer than an area; used by the exchange itself."""
    SCANS = 5


class CoreFailedError(ComponentError):
    """Another process of the run failed, or was ended; the one that failed has the reason too."""


class Exchange:
    """Shared memory and pipes of `count` processes. Make it before they are forked; each then calls `join`."""

    def __init__(self, count: int, area_bytes: int = AREA_BYTES) -> None:
        self.count = count
        self.area_bytes = area_bytes
        areas = len(Topic) * _AREAS + 1  # the last for the reason of a failure
        self._memory = mmap.mmap(-1, count * areas * (_HEADER.size + area_bytes))  # pages are there once written to
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
        self._posted: list[deque[bytes]] = [deque() for _ in Topic]
        """Own parts that are not collected yet, by topic."""
        self._collected = [0] * len(Topic)
        self._arrived = {source: [0] * len(Topic) for source in readers}
        """Rounds of each topic that other processes have posted."""
        self._failed: set[int] = set()
        self.waited_s = 0.0
        """Wall seconds for which it has waited for others."""

    def post(self, topic: Topic, now: int, part: bytes) -> None:
        """Give `part` to all others in the next round of a topic, without waiting for theirs."""
        waiting = self._posted[topic]
        if len(waiting) > MAX_AHEAD:
            raise ValueError(f"{len(waiting)} rounds of topic {topic.name} were posted and not collected")
        at = self._place(self.number, topic, self._collected[topic] + len(waiting))
        start = at + _HEADER.size
        piece = part[: self._area_bytes]
        self._memory[start : start + len(piece)] = piece
        self._memory[at:start] = _HEADER.pack(now, len(part))
        waiting.append(part)
        self._signal(topic)

    def collect(self, topic: Topic, now: int) -> list[bytes]:
        """The parts of the oldest round that was not collected yet, in order of the processes, the own among them.

        Waits until all have posted it. `now` is what it was posted with, and equal in all processes, or they are out of
        step: `ComponentError`. Raises `CoreFailedError` if another process has failed or ended.
        """
        number = self._collected[topic]
        self._wait(topic, number + 1)
        own_part = self._posted[topic].popleft()
        self._collected[topic] += 1
        parts: list[bytes] = []
        sizes = []
        for member in range(self.count):
            at = self._place(member, topic, number)
            start = at + _HEADER.size
            then, size = _HEADER.unpack(self._memory[at:start])
            if then != now:
                raise ComponentError(
                    "cores",
                    f"out of step at topic {topic.name}: core {self.number} is at {now} ns, core {member} at {then} ns",
                )
            sizes.append(size)
            is_own = member == self.number
            parts.append(own_part if is_own else bytes(self._memory[start : start + min(size, self._area_bytes)]))
        return self._collect_rest(now, parts, sizes) if max(sizes) > self._area_bytes else parts

    def gather(self, topic: Topic, now: int, part: bytes) -> list[bytes]:
        """Post a part and collect those of all at once."""
        self.post(topic, now, part)
        return self.collect(topic, now)

    def fail(self, reason: str) -> None:
        """Tell all others, in place of the next round, that this process has failed."""
        data = reason.encode()[: self._area_bytes]
        at = self._place_of_reason(self.number)
        start = at + _HEADER.size
        self._memory[start : start + len(data)] = data
        self._memory[at:start] = _HEADER.pack(0, len(data))
        self._signal(_FAILED)

    def close(self) -> None:
        """Leave: close the pipes. Again does nothing."""
        for end in (*self._readers.values(), *self._writers.values()):
            os.close(end)
        self._readers, self._writers = {}, {}

    def _collect_rest(self, now: int, parts: list[bytes], sizes: Sequence[int]) -> list[bytes]:
        """Whole parts, of which the first areas are there; all know the sizes, so all do this in the same round."""
        own_part = parts[self.number]
        whole = [bytearray(part) for part in parts]
        for begin in range(self._area_bytes, max(sizes), self._area_bytes):
            pieces = self.gather(Topic.PIECES, now, own_part[begin : begin + self._area_bytes])
            for member, piece in enumerate(pieces):
                if member != self.number:
                    whole[member] += piece
        return [own_part if member == self.number else bytes(part) for member, part in enumerate(whole)]

    def _wait(self, topic: Topic, rounds: int) -> None:
        """Wait until all others have posted so many rounds of a topic."""
        began = time.perf_counter()
        for source, arrived in self._arrived.items():
            while arrived[topic] < rounds:
                if source in self._failed:
                    self._raise_failure(source)
                signals = os.read(self._readers[source], _READ_BYTES)
                if not signals:
                    raise CoreFailedError(f"core {source}", "its process ended unexpectedly")
                for signal in signals:
                    if signal == _FAILED:
                        self._failed.add(source)
                    else:
                        arrived[signal] += 1
        self.waited_s += time.perf_counter() - began

    def _raise_failure(self, source: int) -> None:
        at = self._place_of_reason(source)
        start = at + _HEADER.size
        _, size = _HEADER.unpack(self._memory[at:start])
        raise CoreFailedError(f"core {source}", bytes(self._memory[start : start + size]).decode(errors="replace"))

    def _signal(self, signal: int) -> None:
        for writer in self._writers.values():
            with suppress(BrokenPipeError):  # what was left in the other pipe tells why it ended
                os.write(writer, bytes((signal,)))

    def _place(self, member: int, topic: Topic, number: int) -> int:
        """Where the area of a process for a round of a topic begins."""
        area = (member * len(Topic) + topic) * _AREAS + number % _AREAS
        return area * (_HEADER.size + self._area_bytes)

    def _place_of_reason(self, member: int) -> int:
        return (self.count * len(Topic) * _AREAS + member) * (_HEADER.size + self._area_bytes)
