"""What do exchanges make of answers that are usual, said again, a stranger's, a new one's, or not there?"""

from __future__ import annotations

import socket
import struct
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from skyrange.io.ardupilot import batch_exchange as exchanges
from skyrange.io.ardupilot.batch_exchange import BatchExchange
from skyrange.io.ardupilot.sitl import HEAD, LOOPBACK, LockstepSitl, wall_s


class Process(LockstepSitl):
    """Our end of a process that there is not: the test speaks for it by `line`."""

    def __init__(self) -> None:
        self.strangers = self.restarts = 0
        self.count, self.peer = -1, None
        self.program: Any = SimpleNamespace(running=True)
        self._physics = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._physics.bind((LOOPBACK, 0))
        self._physics.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", 0, 50_000))
        self.line = self.another()
        self.says(0)
        assert self.servos(wall_s() + 1.0) is not None

    def another(self) -> socket.socket:
        """A socket that speaks to us."""
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.bind((LOOPBACK, 0))
        made.connect(self._physics.getsockname())
        made.settimeout(1.0)
        return made

    def says(self, count: int, first: int = 1000, line: socket.socket | None = None) -> None:
        (line or self.line).send(packet(count, first))


def packet(count: int, first: int, magic: int = 18458) -> bytes:
    widths = [first, *range(1001, 1016)] if magic == 18458 else [first, *range(1001, 1032)]
    return struct.pack(f"<HHI{len(widths)}H", magic, 400, count, *widths)


@pytest.fixture(params=["compiled", "plain"])
def fleet(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> tuple[list[Process], BatchExchange]:
    if request.param == "plain":
        monkeypatch.setattr(sys, "platform", "plan9")
    processes = [Process() for _ in range(3)]
    return processes, BatchExchange(processes, 2)


def written(lines: list[list[bytes]]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Text and lengths of lines by turn and process."""
    shape = len(lines), len(lines[0])
    text, lengths = np.zeros((*shape, 64), dtype=np.uint8), np.zeros(shape, dtype=np.int64)
    for turn, row in np.ndindex(shape):
        lengths[turn, row] = len(lines[turn][row])
        text[turn, row, : lengths[turn, row]] = np.frombuffer(lines[turn][row], dtype=np.uint8)
    return text, lengths


def taken(held: BatchExchange, rows: list[int], within_s: float = 0.2, count: int = 1) -> list[int]:
    """The first width of the last of so many answers of each, -1 where one was not taken."""
    held.taken[:] = 0  # as when lines are sent
    lost = set()
    for row in held.take(np.array(rows), np.full(3, count)):
        while held.taken[row] < count:
            if not held.take_late(row, wall_s() + within_s):
                lost.add(row)
                break
    widths = held.answers[count - 1, :, :2].copy().view("<u2").ravel().tolist()
    return [-1 if row in lost else widths[row] for row in rows]


def test_lines_go_to_each_and_answers_come_from_each(fleet: tuple[list[Process], BatchExchange]) -> None:
    processes, held = fleet
    lines = [[b"first", b"of no matter", b"third, once"], [b"first again", b"nor this", b"third again"]]
    held.send(np.array([0, 2]), np.array([1, 2, 2]), *written(lines))
    assert [processes[row].line.recv(100) for row in (0, 2)] == [b"first", b"third, once"]
    assert processes[2].line.recv(100) == b"third again"
    for one in processes[:2]:
        one.line.settimeout(0.05)
        with pytest.raises(TimeoutError):
            one.line.recv(100)
    for row, process in enumerate(processes):
        process.says(1, 1100 + row)
        process.line.send(packet(2, 1200 + row, 29569))  # of 32 channels
    assert taken(held, [0, 1, 2]) == [1100, 1101, 1102]
    assert taken(held, [2, 0]) == [1202, 1200]
    assert held.answers[0, 0, 2 * 31 : 2 * 32].tobytes() == (1031).to_bytes(2, "little")
    assert held.answers.shape == (2, 3, exchanges.BYTES - HEAD)


def test_lines_of_several_lengths_are_datagrams_of_their_own(fleet: tuple[list[Process], BatchExchange]) -> None:
    processes, held = fleet
    held.send(np.array([0, 1, 2]), np.array([2, 2, 1]), *written([[b"1", b"222", b"3"], [b"4444", b"5", b"66"]]))
    heard = [[processes[row].line.recv(100) for _ in range(count)] for row, count in enumerate((2, 2, 1))]
    assert heard == [[b"1", b"4444"], [b"222", b"5"], [b"3"]]


@pytest.mark.parametrize("together", [True, False])
def test_one_alone_gets_its_lines_by_one_call_where_there_is_one(
    together: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not together:
        monkeypatch.setattr(exchanges, "_segments", lambda: False)
    elif not exchanges._segments():
        pytest.skip("UDP_SEGMENT is not there")
    process = Process()
    held = BatchExchange([process], 3)
    for lines in ([b"1", b"4444"], [b"222", b"5"], [b"1", b"22", b"1"], [b"1"]):
        held.send(np.array([0]), np.array([len(lines)]), *written([[line] for line in lines]))
        heard = [process.line.recv(100) for _ in lines]
        # by one call, each datagram but the last is as long as the longest
        assert heard == [line.ljust(max(map(len, lines)) if together else 0) for line in lines[:-1]] + lines[-1:]


def test_all_answers_to_the_lines_of_a_turn_are_taken_at_once(fleet: tuple[list[Process], BatchExchange]) -> None:
    processes, held = fleet
    for row, process in enumerate(processes):
        process.says(1, 1100 + row)
        if row == 1:
            process.line.send(b"no servo packet")
        process.says(2, 1200 + row)
    assert taken(held, [0, 1, 2], count=2) == [1200, 1201, 1202]
    assert held.answers[0, :, :2].copy().view("<u2").ravel().tolist() == [1100, 1101, 1102]
    assert (held.taken.tolist(), processes[1].strangers) == ([2, 2, 2], 1)
    processes[0].says(3, 1300)
    processes[2].says(3, 1302)
    processes[2].says(4, 1402)
    assert taken(held, [0, 1, 2], count=2) == [-1, -1, 1402]
    assert held.taken.tolist() == [1, 0, 2]
    text, lengths = np.full((1, 3, 4), 65, dtype=np.uint8), np.full((1, 3), 4)
    held.send(np.array([0]), np.ones(3, dtype=np.int64), text, lengths)
    assert held.taken.tolist() == [0, 0, 2]


def test_what_was_said_again_is_passed_over_and_strangers_are_counted(
    fleet: tuple[list[Process], BatchExchange],
) -> None:
    processes, held = fleet
    one = processes[1]
    one.says(1, 1500)
    assert taken(held, [1]) == [1500]
    one.says(1, 1600)  # said again
    for junk in (b"", b"x", packet(2, 1600)[:-1], packet(2, 1600, 4242), bytes(250), bytes(2000)):
        one.line.send(junk)
    stranger = one.another()
    one.says(2, 1700, stranger)
    one.says(2, 1800)
    assert taken(held, [1]) == [1800]
    assert (one.strangers, one.restarts) == (7, 0)
    one.says(3, 1900)
    assert taken(held, [1]) == [1900]


def test_one_that_began_anew_is_followed(fleet: tuple[list[Process], BatchExchange]) -> None:
    processes, held = fleet
    one = processes[2]
    one.says(1, 1100)
    assert taken(held, [2]) == [1100]
    old, one.line = one.line, one.another()
    one.says(0, 1200)
    assert taken(held, [2]) == [1200]
    assert one.restarts == 1
    one.says(2, 1300, old)
    one.says(1, 1400)
    assert taken(held, [2]) == [1400]
    assert one.strangers == 1
    held.send(np.array([2]), np.ones(3, dtype=np.int64), np.full((1, 3, 4), 65, dtype=np.uint8), np.array([[4, 4, 4]]))
    assert one.line.recv(10) == b"AAAA"


def test_one_that_is_slow_is_waited_for_and_one_that_is_gone_is_not(fleet: tuple[list[Process], BatchExchange]) -> None:
    processes, held = fleet
    processes[0].says(1, 1100)
    processes[2].says(1, 1300)
    processes[1].program.running = False
    began = wall_s()
    assert taken(held, [0, 1, 2], within_s=5.0) == [1100, -1, 1300]
    assert wall_s() - began < 1.0
    processes[1].program.running = True
    assert taken(held, [1]) == [-1]  # not by the deadline
