"""Batches of exchanges: those of one iteration of ArduPilot's main loop are sent together.

Its loop sets the motors once per iteration and reads its gyros about twice. So the pulse widths of all exchanges but
the last are known already, the world can advance with them, and a process that gets all lines of an iteration at once
wakes up half as often. Its answers show which exchange is the last of an iteration.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.world.airframes import MOTORS

Ints = NDArray[np.int64]


class ExchangeBatches:
    """The batches of all aircraft of a fleet. A moment is a tick with exchanges, whose lines are
    always sent together.
    """

    def __init__(self, per_tick: Ints, ticks: Ints, moments: Ints) -> None:
        """Arrays (n,): exchanges per tick and ticks per exchange, as `parameters.exchange_steps`; `moments` per
        iteration.
        """
        self.pending_lines: Ints = np.zeros(len(ticks), dtype=np.int64)
        """(n,) how many lines are written and not answered."""
        self._per_tick, self._ticks, self._moments = per_tick, ticks, moments
        self._all_at_once = not (ticks > 1).any()
        self._wanted: Ints = moments.copy()
        """Number of moments in the next batch."""
        self._pulses: NDArray[np.uint8] = np.zeros((len(ticks), 2 * MOTORS), dtype=np.uint8)

    def due_rows(self, number: int, rows: Ints) -> Ints:
        """Those of `rows` that have a moment in the tick with this number."""
        return rows if self._all_at_once else _at(number, self._ticks, rows)

    def mark_written(self, rows: Ints) -> Ints:
        """Count the lines of a moment as written for `rows`; returns the rows whose batch is complete and has to be
        sent.
        """
        return _written(rows, self._per_tick, self._wanted, self.pending_lines)

    def mark_answered(self, rows: Ints, taken: Ints, answers: NDArray[np.uint8]) -> None:
        """Take in that `rows` have answered all their lines, or are lost: of `answers` (k, n, bytes) the first `taken`
        (n,).
        """
        _answered(rows, taken, answers, self._per_tick, self._moments, self._pulses, self._wanted, self.pending_lines)


@compiled
def _at(number: int, ticks: Ints, rows: Ints) -> Ints:
    there = np.empty_like(rows)
    count = 0
    for row in rows:
        if number % ticks[row] == 0:
            there[count] = row
            count += 1
    return there[:count]


@compiled
def _written(rows: Ints, per_tick: Ints, wanted: Ints, lines: Ints) -> Ints:
    due = np.empty_like(rows)
    count = 0
    for row in rows:
        lines[row] += per_tick[row]
        if lines[row] >= wanted[row] * per_tick[row]:
            due[count] = row
            count += 1
    return due[:count]


@compiled
def _answered(
    rows: Ints,
    taken: Ints,
    answers: NDArray[np.uint8],
    per_tick: Ints,
    moments: Ints,
    pulses: NDArray[np.uint8],
    wanted: Ints,
    lines: Ints,
) -> None:
    for row in rows:
        last = lines[row] // per_tick[row] - 1
        changed = last
        for turn in range(taken[row] if moments[row] > 1 else 0):
            new = False
            for k in range(pulses.shape[1]):
                new |= answers[turn, row, k] != pulses[row, k]
                pulses[row, k] = answers[turn, row, k]
            if new:
                changed = min(changed, turn // per_tick[row])
        # an iteration ends where the pulses change; if that was not the last moment, the next batch ends there
        wanted[row] = changed + 1 if changed < last else moments[row]
        lines[row] = 0
