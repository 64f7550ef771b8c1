"""Which exchanges go out together? Those of a turn of ArduPilot's main loop: it answers nothing new in between.

Its loop sets the motors once a turn, and reads its gyros about twice. So the pulse widths of the exchanges before the
last are known already, the world can go on by them, and a process that gets all lines of a turn at once wakes up half
as often. Which exchange is a turn's last, its answers tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyrange.world.airframes import MOTORS

Ints = NDArray[np.int64]


class Batches:
    """Of all aircraft of a fleet. A moment is a tick with exchanges, whose lines go out together in any case."""

    def __init__(self, per_tick: Ints, ticks: Ints, moments: Ints) -> None:
        """Arrays (n,): exchanges per tick and ticks per exchange, as `parameters.steps_of`, `moments` per turn."""
        self._per_tick, self._ticks, self._moments = per_tick, ticks, moments
        self._all_at_once = not (ticks > 1).any()
        self._each_alone = not (moments > 1).any()
        self._waiting: Ints = np.zeros(len(ticks), dtype=np.int64)
        """Moments whose lines are written and not sent."""
        self._wanted: Ints = moments.copy()
        """How many go out together next."""
        self._changed: Ints = np.zeros(len(ticks), dtype=np.int64)
        """In which moment of those that were sent the pulses changed; the last where they did not."""
        self._pulses: NDArray[np.uint8] = np.zeros((len(ticks), 2 * MOTORS), dtype=np.uint8)

    @property
    def lines(self) -> Ints:
        """(n,) how many are written and not answered."""
        return self._waiting * self._per_tick

    def at(self, number: int, rows: Ints) -> Ints:
        """Those of `rows` that have a moment in the tick of this number."""
        return rows if self._all_at_once else rows[number % self._ticks[rows] == 0]

    def written(self, rows: Ints) -> Ints:
        """The lines of a moment are written for `rows`; returns those of them whose lines are to be sent now."""
        self._waiting[rows] += 1
        if self._each_alone:
            return rows
        due: Ints = rows[self._waiting[rows] >= self._wanted[rows]]
        self._changed[due] = self._waiting[due] - 1
        return due

    def answered(self, rows: Ints, turn: int, answers: NDArray[np.uint8]) -> None:
        """`rows` have answered the line of this number, (n, bytes)."""
        if self._each_alone:
            return
        pulses = answers[rows, : 2 * MOTORS]
        moment = turn // self._per_tick[rows]
        new = (pulses != self._pulses[rows]).any(axis=1) & (moment < self._changed[rows])
        self._changed[rows[new]] = moment[new]
        self._pulses[rows] = pulses

    def done(self, rows: Ints) -> None:
        """All lines of `rows` are answered, or lost."""
        if not self._each_alone:
            # a turn ends where the pulses change; where that is not its last moment the next batch ends with it
            early = self._changed[rows] < self._waiting[rows] - 1
            self._wanted[rows] = np.where(early, self._changed[rows] + 1, self._moments[rows])
        self._waiting[rows] = 0
