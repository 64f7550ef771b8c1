"""References to frames as columns: two numbers for each frame instead of an object.

A `FrameId` is three names and a serial. The names are few: a table numbers them, and state that outlives a step keeps
(number, serial) in its columns. The id is made again when it is quoted in `causes`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skyrange.contracts.frames import Ints, LinkTable
from skyrange.contracts.mailboxes import Inbox, Parents
from skyrange.core.ids import FrameId

NO_REF = -1
"""Stands for no frame."""


class FrameRefTable:
    """The names of the frames that an agent received, numbered in order of first arrival. Deep-copyable."""

    __slots__ = ("_names", "_numbers", "_of_link", "_table")

    def __init__(self) -> None:
        self._names: list[tuple[str, str, str]] = []
        self._numbers: dict[tuple[str, str, str], int] = {}
        self._table: LinkTable | None = None
        self._of_link = np.zeros(0, dtype=np.int64)

    def read(self, inbox: Inbox, order: Ints) -> tuple[Ints, Ints]:
        """(n,) numbers and (n,) serials of the arrivals `order`, as `Columns.order` numbers them."""
        singles, blocks = inbox.singles, inbox.blocks
        count = len(singles) + sum(map(len, blocks))
        numbers, serials = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
        for place, arrival in enumerate(singles):
            numbers[place], serials[place] = self._number(arrival.ref[:3]), arrival.ref.serial
        at = len(singles)
        for block in blocks:
            part = slice(at, at + len(block))
            numbers[part], serials[part] = self._number_links(block.link_table, block.link_numbers), block.serial
            at += len(block)
        return numbers[order], serials[order]

    @property
    def names(self) -> Sequence[tuple[str, str, str]]:
        """(link, direction, sender) by number."""
        return self._names

    def parents(self, numbers: Ints, serials: Ints) -> Parents:
        """The same frames as parents of a block; none of them may be `NO_REF`."""
        return Parents(self._names, numbers, serials)

    def id(self, number: int, serial: int) -> FrameId | None:
        """The frame, `None` for `NO_REF`."""
        return None if number == NO_REF else FrameId(*self._names[number], serial)

    def _number(self, name: tuple[str, str, str]) -> int:
        number = self._numbers.get(name)
        if number is None:
            number = self._numbers[name] = len(self._names)
            self._names.append(name)
        return number

    def _number_links(self, table: LinkTable, links: Ints) -> Ints:
        if self._table is not table:
            self._table = table
            self._of_link = np.full(len(table.names), NO_REF, dtype=np.int64)
        numbers = self._of_link[links]
        for new in np.unique(links[numbers == NO_REF]).tolist():
            self._of_link[new] = self._number(table.names[new][:3])
        return self._of_link[links]
