"""Blocks of frames of a batch of runs: tables of their links, and the division of a block by run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from skyrange.contracts.components import Sensors, World
from skyrange.contracts.frames import DirectedLinkName, FrameBlock, Ints, LinkTable
from skyrange.core.ids import Port
from skyrange.core.time import Time
from skyrange.kernel.directed_link import DirectedLink


class BatchLinkTable(LinkTable):
    """The directed links of all runs of a batch, in order of run and name."""

    __slots__ = ("_first", "_tables")

    def __init__(
        self, names: Sequence[DirectedLinkName], places: Ints, tables: Sequence[LinkTable], first: Sequence[int]
    ) -> None:
        """`tables` of the links of each run, and the numbers of the `first` of them."""
        super().__init__(names, places)
        self._tables = tables
        self._first = first

    def find(self, port: Port, name: tuple[str, str, str]) -> int:
        """As `LinkTable.find`; the port names the run."""
        number = self._tables[port.run].find(port, name)
        return number if number < 0 else number + self._first[port.run]


class BatchObserver(Protocol):
    """An observer of the blocks and the ticks of all runs of a batch; links are numbered as in the kernel."""

    def on_blocks(self, blocks: Sequence[FrameBlock]) -> None:
        """Blocks that have met their fate."""
        ...

    def on_truth(self, now: Time, world: World, received: Sensors | None) -> None:
        """A tick ended; `received` are the readings that autopilots got, where there are sensor faults."""
        ...


class RunSplitter:
    """Division of blocks into those of each run of a batch, which number the links of their own run only."""

    def __init__(self, links: Sequence[DirectedLink], runs: int) -> None:
        """`links` by number, those of each run one after the other."""
        names = [DirectedLinkName(link.link_name, link.direction, link.src, link.dst) for link in links]
        places = np.array([link.place for link in links], dtype=np.int64)
        self._run_of = np.array([link.run for link in links], dtype=np.int64)
        ends = np.searchsorted(self._run_of, np.arange(runs), side="right").tolist()
        self.first = [0, *ends[:-1]]
        """By run: the number of its first link."""
        ranges = zip(self.first, ends, strict=True)
        self.tables = [LinkTable(names[first:end], places[first:end]) for first, end in ranges]
        """By run: its links alone."""
        self.whole = self.tables[0] if runs == 1 else BatchLinkTable(names, places, self.tables, self.first)
        """All links of the kernel."""

    def split(self, block: FrameBlock) -> Iterator[tuple[int, FrameBlock]]:
        """The rows of each run, in their order."""
        if len(self.tables) == 1:
            yield 0, block
            return
        links = block.link_numbers
        runs = self._run_of[links]
        (steps,) = np.diff(runs).nonzero()
        if len(steps) and (np.diff(runs) < 0).any():
            order = runs.argsort(kind="stable")
            block, runs = block.take(order), runs[order]
            (steps,) = np.diff(runs).nonzero()
        ends = [*(steps + 1).tolist(), len(runs)]
        start = 0
        for end in ends:
            run = runs.item(start)
            yield run, block.of_run(slice(start, end), self.tables[run], self.first[run])
            start = end
