"""Blocks of frames: columns of frames that were sent at one instant and share their times and fate.

Telemetry of a fleet leaves in blocks; a frame that is tapped, jittered or lost on the way is a `Frame` of its own.
Whether a frame is in a block makes a difference only to the time that it takes to handle.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.frames import Fate, Frame
from skyrange.agent.payloads import Ints, Payloads
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import Time


class LaneName(NamedTuple):
    """One direction of one link: what all frames have in common that its own source sent."""

    link: str
    direction: str
    src: str
    dst: str


class Lanes:
    """The directed links of one kernel by number, in order of their names. Immutable, so copies share it."""

    __slots__ = ("names", "numbers", "places", "ports")

    def __init__(self, names: Sequence[LaneName], places: Ints) -> None:
        """`places` (n,): the place of each link's receiving port among its owner's `ports`, -1 without an owner."""
        self.names = names
        self.numbers = {(name.link, name.direction, name.src): number for number, name in enumerate(names)}
        self.ports = [Port(name.dst, name.link) for name in names]
        self.places = places

    def __deepcopy__(self, memo: object) -> Lanes:
        return self


class FrameBlock:
    """Frames that directed links' own sources sent at `sent_ns`, one row each; `arrived_ns` and `fate` as in `Frame`.

    Row `i` is frame `serial[i]` of directed link `lane[i]`. It carries payload `rows[i]` of `payloads`, or
    payload `i` where `rows` is None. Its parent, the frame that it forwards, is frame `parent_serial[i]` of
    directed link `parent_lane[i]`; both are None where no row has a parent.
    """

    __slots__ = (
        "arrived_ns",
        "fate",
        "lane",
        "lanes",
        "parent_lane",
        "parent_serial",
        "payloads",
        "rows",
        "sent_ns",
        "serial",
    )

    def __init__(
        self,
        lanes: Lanes,
        lane: Ints,
        serial: Ints,
        sent_ns: Time,
        arrived_ns: Time,
        fate: Fate,
        payloads: Payloads,
        rows: Ints | None = None,
        parent_lane: Ints | None = None,
        parent_serial: Ints | None = None,
    ) -> None:
        self.lanes = lanes
        self.lane = lane
        self.serial = serial
        self.sent_ns = sent_ns
        self.arrived_ns = arrived_ns
        self.fate = fate
        self.payloads = payloads
        self.rows = rows
        self.parent_lane = parent_lane
        self.parent_serial = parent_serial

    def __len__(self) -> int:
        return len(self.lane)

    def take(self, rows: Ints | NDArray[np.bool_]) -> FrameBlock:
        """Some of the rows."""
        parents = self.parent_lane is not None and self.parent_serial is not None
        return FrameBlock(
            self.lanes,
            self.lane[rows],
            self.serial[rows],
            self.sent_ns,
            self.arrived_ns,
            self.fate,
            self.payloads,
            np.arange(len(self.payloads))[rows] if self.rows is None else self.rows[rows],
            self.parent_lane[rows] if parents and self.parent_lane is not None else None,
            self.parent_serial[rows] if parents and self.parent_serial is not None else None,
        )

    def carried(self) -> Payloads:
        """The payloads, row by row."""
        return self.payloads if self.rows is None else self.payloads.take(self.rows)

    def payload(self, row: int) -> bytes:
        """The bytes of one row."""
        return self.payloads[row if self.rows is None else int(self.rows[row])]

    def id(self, row: int) -> FrameId:
        """The id of one row's frame."""
        name = self.lanes.names[int(self.lane[row])]
        return FrameId(name.link, name.direction, name.src, int(self.serial[row]))

    def frames(self) -> Iterator[Frame]:
        """The rows as single frames, with times and fate."""
        names = self.lanes.names
        for row in range(len(self)):
            link, direction, src, dst = names[int(self.lane[row])]
            parent = None
            if self.parent_lane is not None and self.parent_serial is not None:
                above = names[int(self.parent_lane[row])]
                parent = FrameId(above.link, above.direction, above.src, int(self.parent_serial[row]))
            serial = int(self.serial[row])
            frame = Frame(link, direction, src, serial, src, dst, self.sent_ns, self.payload(row), parent)
            frame.arrived_ns = self.arrived_ns
            frame.fate = self.fate
            yield frame
