"""How are a fleet's frames numbered? One rolling sequence number per aircraft, for frames made singly and in bulk."""

from __future__ import annotations

from skyrange.agent.payloads import Ints
from skyrange.codec.mavlink import Packer
from skyrange.core.compiled import kernel


class RowPacker(Packer):
    """A `Packer` whose sequence number is one row of an array that all of a fleet share."""

    __slots__ = ("_row", "sequences")

    sequences: Ints
    """(n,) the next numbers of the whole fleet."""

    def __init__(self, system: int, component: int, sequences: Ints, row: int) -> None:
        self.sequences = sequences
        self._row = row
        super().__init__(system, component)

    @property
    def sequence(self) -> int:
        """The number of the next frame."""
        return int(self.sequences[self._row])

    @sequence.setter
    def sequence(self, value: int) -> None:
        self.sequences[self._row] = value


@kernel
def number(rows: Ints, sequences: Ints, out: Ints) -> None:
    """Number frames in the order given: `rows` names the aircraft of each; `sequences` moves on."""
    for place in range(rows.shape[0]):
        row = rows[place]
        out[place] = sequences[row]
        sequences[row] = (sequences[row] + 1) & 0xFF
