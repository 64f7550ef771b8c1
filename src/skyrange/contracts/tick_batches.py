"""Protocols of tick batches: several ticks of a world and its only engine in one call.

Between two multiples of 10 ms the builtin engine has neither mail nor timers: most ticks only move bodies and run
control loops. In a batch they cost a fraction of single ticks, because each call of a compiled function costs more than
its work for one aircraft.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import Engine, World
from skyrange.contracts.mailboxes import Note
from skyrange.core.time import Time


class BatchStop(IntEnum):
    """Why a batch of ticks ended."""

    COMPLETE = 0
    """All its ticks are complete."""
    WORLD = 1
    """In its last tick the bodies have moved and something happened to them; the rest of that tick is to be done."""
    ENGINE = 2
    """In its last tick the engine has something to report; what remains of that tick is to call `finish`."""
    SERVICE = 3
    """In its last tick, which begins a period, the world's part is complete; the rest is to be done."""


class TickBatch(Protocol):
    """The ticks of a world and its only engine. After a batch their state is that after single ticks, to the bit."""

    period_ns: Time
    """Of a tick that is the first at or after a multiple of this, a batch runs the part of the world at most."""

    def run(self, first: Time, count: int, *, service: bool) -> tuple[int, BatchStop]:
        """Run at most `count` ticks from `first` on, and with `service` the world's part of the one after them, which
        begins a period; returns how many were begun, and why the batch ended.

        0 ticks mean that the next one has to be run singly.
        """
        ...

    def complete_world_tick(self) -> Sequence[Note]:
        """After `BatchStop.WORLD`: do what `World.advance` does after the bodies have moved."""
        ...


@runtime_checkable
class BatchingEngine(Engine, Protocol):
    """An engine that may run ticks in batches."""

    def batch_ticks(self, world: World, rows: slice | NDArray[np.int64]) -> TickBatch | None:
        """The ticks of `world`, whose `rows` it flies; `None` where each has to be run singly."""
        ...
