"""Sequence numbers of a fleet's MAVLink frames: one rolling number per aircraft, shared by single and batch packing."""

from __future__ import annotations

from skyrange.codec.mavlink.frames import Packer
from skyrange.contracts.frames import Ints
from skyrange.core.compiled import compiled


class FleetPacker(Packer):
    """A `Packer` whose sequence number is one element of an array that the whole fleet shares."""

    __slots__ = ("_row", "sequences")

    sequences: Ints
    """(n,) the next sequence number of each aircraft."""

    def __init__(self, system: int, component: int, sequences: Ints, row: int) -> None:
        self.sequences = sequences
        self._row = row
        super().__init__(system, component)

    @property
    def sequence(self) -> int:
        """The sequence number of the next frame."""
        return int(self.sequences[self._row])

    @sequence.setter
    def sequence(self, value: int) -> None:
        self.sequences[self._row] = value


@compiled
def assign_sequence_numbers(rows: Ints, sequences: Ints, out: Ints) -> None:
    """Assign sequence numbers to frames in the order given: `rows` names the aircraft of each; advances `sequences`."""
    for place in range(rows.shape[0]):
        row = rows[place]
        out[place] = sequences[row]
        sequences[row] = (sequences[row] + 1) & 0xFF
