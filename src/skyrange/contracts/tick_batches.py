"""Batches of ticks: what a kernel asks of an engine that can run several ticks of a world in one call.

Most ticks only move bodies and run control loops: nobody has mail, and no timer is due. Each call from the kernel costs
more than the work for one aircraft, so an engine that is the only one of its world may offer to run such ticks at once.
What cannot be done in a batch is left to the kernel, which is told how far the last tick has come.
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


class TickProgress(IntEnum):
    """How far the last tick of a batch has come: what remains of it is for the kernel to do."""

    COMPLETE = 0
    """Nothing remains."""
    MOVED = 1
    """The bodies have moved and something happened to them: the rest of the world's part remains, and the engine's."""
    ENGINE_BEGUN = 2
    """The engine has begun, and has something to report: a call of its `finish` remains."""
    WORLD_ADVANCED = 3
    """The tick begins a period, and the world's part is complete: the engine's part remains."""


class TickBatch(Protocol):
    """The ticks of a world and its only engine. After a batch their state is that after single ticks, to the bit."""

    period_ns: Time
    """Of a tick that is the first at or after a multiple of this, a batch runs the part of the world at most."""

    def run(self, first: Time, count: int, *, service: bool) -> tuple[int, TickProgress]:
        """Run at most `count` ticks from `first` on, and with `service` the world's part of the one after them, which
        begins a period; returns how many were begun, and how far the last of them has come.

        0 ticks mean that the next one has to be run singly.
        """
        ...

    def complete_world_tick(self) -> Sequence[Note]:
        """After `TickProgress.MOVED`: do what `World.advance` does after the bodies have moved."""
        ...

    def complete_world_tick_runs(self) -> Sequence[tuple[int, Note]]:
        """The same, with the run of each note, where the world has those of a batch."""
        ...


class BatchWorld(World, Protocol):
    """A world that has the bodies of several runs, numbered from 0. Bodies of different runs never meet."""

    def advance_runs(self, now: Time) -> Sequence[tuple[int, Note]]:
        """As `World.advance`, with the run of each note."""
        ...

    def rows_of(self, run: int) -> slice:
        """The rows of a run's bodies."""
        ...


@runtime_checkable
class BatchingEngine(Engine, Protocol):
    """An engine that may run ticks in batches, where it is the only one of a world."""

    def batch_ticks(self, world: World, rows: slice | NDArray[np.int64]) -> TickBatch | None:
        """The ticks of `world`, whose `rows` it flies; `None` where each has to be run singly."""
        ...
