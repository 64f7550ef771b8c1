"""Executors of blocks: processes of this machine, or tasks of a Ray cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

from skyrange.study.sweep.block_files import BlockResult
from skyrange.study.sweep.design.blocks import Block


class WorkerFailure(str):
    """Why a block has no result: its worker was killed, or took too long."""

    __slots__ = ()


Outcome = BlockResult | WorkerFailure
FlyBlock = Callable[[Block], BlockResult]


class Executor(Protocol):
    """Flies blocks, several at a time."""

    jobs: int
    """How many at a time."""

    def run(
        self, blocks: Sequence[Block], fly: FlyBlock, limit_s: float, stop: Callable[[], bool]
    ) -> Iterator[tuple[Block, Outcome]]:
        """Fly blocks, in any order, and yield what became of each as it ends.

        A block that takes longer than `limit_s` is given up. Once `stop` returns true no further block is begun, and
        those under way are given up where they are: they are not yielded.
        """
        ...
