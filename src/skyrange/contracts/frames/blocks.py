"""Blocks of frames: columns of frames that were sent at one instant and share their times and fate.

Telemetry of a fleet leaves in blocks; a frame that is tapped, jittered or lost on the way is a `Frame` of its own.
Whether a frame is in a block makes a difference only to the time that it takes to handle.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.frames.frame import Fate, Frame, end_journey
from skyrange.contracts.frames.payloads import Ints, Payloads
from skyrange.core.arrays import as_read_only
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import Time

Causes = Sequence[tuple[FrameId, ...]]


class DirectedLinkName(NamedTuple):
    """One direction of one link: what all frames have in common that its own source sent."""

    link: str
    direction: str
    src: str
    dst: str


class LinkTable:
    """The directed links of one kernel by number, in order of their names. Immutable, so copies share it."""

    __slots__ = ("names", "numbers", "places", "ports")

    def __init__(self, names: Sequence[DirectedLinkName], places: Ints) -> None:
        """`places` (n,): the place of each link's receiving port among its owner's `ports`, -1 without an owner."""
        self.names = names
        self.numbers = {(name.link, name.direction, name.src): number for number, name in enumerate(names)}
        self.ports = [Port(name.dst, name.link) for name in names]
        self.places = places

    def __deepcopy__(self, memo: object) -> LinkTable:
        return self


class FrameBlock:
    """Frames that directed links' own sources sent at `sent_ns`, one row each; `arrived_ns` and `fate` as in `Frame`.

    Row `i` is frame `serial[i]` of directed link `link_numbers[i]`. It carries payload `rows[i]` of `payloads`, or
    payload `i` where `rows` is None. Its parent, the frame that it forwards, is frame `parent_serial[i]` of
    directed link `parent_link_numbers[i]`; both are None where no row has a parent. `causes[i]` names the frames that
    commanded it; None where none has any.
    """

    __slots__ = (
        "arrived_ns",
        "causes",
        "fate",
        "link_numbers",
        "link_table",
        "parent_link_numbers",
        "parent_serial",
        "payloads",
        "rows",
        "sent_ns",
        "serial",
    )

    def __init__(
        self,
        link_table: LinkTable,
        link_numbers: Ints,
        serial: Ints,
        sent_ns: Time,
        arrived_ns: Time,
        fate: Fate,
        payloads: Payloads,
        rows: Ints | None = None,
        parent_link_numbers: Ints | None = None,
        parent_serial: Ints | None = None,
        causes: Causes | None = None,
    ) -> None:
        self.link_table = link_table
        self.link_numbers = as_read_only(link_numbers)
        self.serial = as_read_only(serial)
        self.sent_ns = sent_ns
        self.arrived_ns = arrived_ns
        self.fate = fate
        self.payloads = payloads
        self.rows = rows
        self.parent_link_numbers = parent_link_numbers
        self.parent_serial = parent_serial
        self.causes = causes

    def __len__(self) -> int:
        return len(self.link_numbers)

    def take(self, rows: Ints | NDArray[np.bool_]) -> FrameBlock:
        """Some of the rows."""
        parents = self.parent_link_numbers is not None and self.parent_serial is not None
        return FrameBlock(
            self.link_table,
            self.link_numbers[rows],
            self.serial[rows],
            self.sent_ns,
            self.arrived_ns,
            self.fate,
            self.payloads,
            np.arange(len(self.payloads))[rows] if self.rows is None else self.rows[rows],
            self.parent_link_numbers[rows] if parents and self.parent_link_numbers is not None else None,
            self.parent_serial[rows] if parents and self.parent_serial is not None else None,
            None if self.causes is None else take_causes(self.causes, rows),
        )

    def carried(self) -> Payloads:
        """The payloads, row by row."""
        return self.payloads if self.rows is None else self.payloads.take(self.rows)

    def payload(self, row: int) -> bytes:
        """The bytes of one row."""
        return self.payloads[row if self.rows is None else int(self.rows[row])]

    def id(self, row: int) -> FrameId:
        """The id of one row's frame."""
        name = self.link_table.names[int(self.link_numbers[row])]
        return FrameId(name.link, name.direction, name.src, int(self.serial[row]))

    def frames(self) -> Iterator[Frame]:
        """The rows as single frames, with times and fate."""
        names = self.link_table.names
        for row in range(len(self)):
            link, direction, src, dst = names[int(self.link_numbers[row])]
            parent = None
            if self.parent_link_numbers is not None and self.parent_serial is not None:
                above = names[int(self.parent_link_numbers[row])]
                parent = FrameId(above.link, above.direction, above.src, int(self.parent_serial[row]))
            serial, causes = int(self.serial[row]), () if self.causes is None else self.causes[row]
            frame = Frame(link, direction, src, serial, src, dst, self.sent_ns, self.payload(row), parent, causes)
            end_journey(frame, self.fate, self.arrived_ns)
            yield frame


def take_causes(causes: Causes, rows: Ints | NDArray[np.bool_]) -> Causes:
    """The causes of some of the rows."""
    numbers = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
    return [causes[row] for row in numbers.tolist()]
