"""Do the lines of a turn of the main loop go out together, and is its last exchange found?"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from skyrange.vehicle.ardupilot.lockstep_fleet import ExchangeBatches


def ints(*values: int) -> NDArray[np.int64]:
    return np.array(values, dtype=np.int64)


class Loop:
    """An autopilot whose loop turns once in `moments`, and first at the moment `last`: new pulses then."""

    def __init__(self, moments: int, last: int) -> None:
        self.moments, self.last, self.at, self.pulses = moments, last, 0, 0

    def answer(self) -> NDArray[np.uint8]:
        if self.at % self.moments == self.last:
            self.pulses += 1
        self.at += 1
        return np.frombuffer(np.full(16, self.pulses, dtype="<u2").tobytes(), dtype=np.uint8)


def flown(batches: ExchangeBatches, loops: list[Loop], ticks: int) -> list[list[tuple[int, int]]]:
    """For each row: in which tick it was sent how many lines."""
    sent: list[list[tuple[int, int]]] = [[] for _ in loops]
    for tick in range(ticks):
        rows = batches.due_rows(tick, np.arange(len(loops)))
        if not len(rows):
            continue
        due, counts = batches.mark_written(rows), batches.pending_lines.copy()
        answers = np.zeros((int(counts.max()), len(loops), 32), dtype=np.uint8)
        for row in due.tolist():
            sent[row].append((tick, int(counts[row])))
            for turn in range(counts[row]):
                answers[turn, row] = loops[row].answer()
        batches.mark_answered(due, counts, answers)
    return sent


@pytest.mark.parametrize("last", [0, 1, 2, 3])
def test_whichever_exchange_is_a_turns_last_batches_soon_end_with_it(last: int) -> None:
    loop = Loop(4, last)
    (sent,) = flown(ExchangeBatches(ints(1), ints(1), ints(4)), [loop], 40)
    ends = [tick for tick, _ in sent]
    assert all(count == 4 for _, count in sent[3:])
    assert {tick % 4 for tick in ends[3:]} == {last}
    assert loop.at == sum(count for _, count in sent)
    assert 40 - loop.at < 4  # all others are sent


def test_each_row_has_its_own_rates_and_its_own_last() -> None:
    loops = [Loop(1, 0), Loop(2, 1), Loop(2, 0), Loop(2, 0)]
    batches = ExchangeBatches(ints(2, 1, 1, 1), ints(1, 1, 1, 2), ints(1, 2, 2, 2))
    full, even, odd, slow = flown(batches, loops, 12)
    assert full == [(tick, 2) for tick in range(12)]
    assert even == [(tick, 2) for tick in (1, 3, 5, 7, 9, 11)]
    assert odd == [(1, 2), (2, 1), *((tick, 2) for tick in (4, 6, 8, 10))]
    assert slow == [(2, 2), (4, 1), (8, 2)]


def test_one_whose_pulses_stand_still_keeps_its_batches() -> None:
    assert flown(ExchangeBatches(ints(1), ints(2), ints(2)), [Loop(1000, 999)], 16) == [
        [(2, 2), (6, 2), (10, 2), (14, 2)]
    ]


def test_lines_that_were_lost_are_not_waited_for() -> None:
    batches = ExchangeBatches(ints(1, 1), ints(1, 1), ints(2, 2))
    rows = ints(0, 1)
    assert batches.mark_written(rows).tolist() == []
    assert batches.mark_written(rows).tolist() == [0, 1]
    batches.mark_answered(rows, ints(2, 0), np.ones((2, 2, 32), dtype=np.uint8))  # the second has restarted
    assert batches.pending_lines.tolist() == [0, 0]
    assert batches.mark_written(rows).tolist() == [0]  # its first answer was new
    assert batches.mark_written(ints(1)).tolist() == [1]  # nothing is known of its turns
