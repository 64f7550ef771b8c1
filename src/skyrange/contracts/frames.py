"""Frames: one protocol unit on one link instance, singly or in blocks, and payloads as columns of bytes.

A block has columns of frames that were sent at one instant and share their times and fate. Telemetry of a fleet leaves
in blocks; a frame that is tapped, jittered or lost on the way is a `Frame` of its own. Whether a frame is in a block
makes a difference only to the time that it takes to handle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import FrozenInstanceError
from enum import StrEnum
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from skyrange.core.arrays import Bytes, Ints, as_read_only
from skyrange.core.compiled import compiled
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, Time

__all__ = [
    "Bytes",
    "Causes",
    "DirectedLinkName",
    "Fate",
    "Frame",
    "FrameBlock",
    "Ints",
    "LinkTable",
    "Payloads",
    "end_journey",
    "take_causes",
]


@compiled
def _gather(data: Bytes, starts: Ints, sizes: Ints, out: Bytes, places: Ints) -> None:
    """Copy each payload to its place in `out`."""
    for row in range(starts.shape[0]):
        start = starts[row]
        place = places[row]
        for offset in range(sizes[row]):
            out[place + offset] = data[start + offset]


class Payloads:
    """Payload `i` is `data[starts[i] : starts[i] + sizes[i]]`. Immutable, so that columns may share a buffer."""

    __slots__ = ("_arrays", "kinds")

    def __init__(self, data: Bytes, starts: Ints, sizes: Ints) -> None:
        self._arrays = data, starts, sizes
        self.kinds: Ints | None = None
        """What `codec.mavlink.message_columns.classify_frames` has found, so that it is found once."""

    @property
    def data(self) -> Bytes:
        """The buffer, read-only."""
        return as_read_only(self._arrays[0])

    @property
    def starts(self) -> Ints:
        """(n,) where each payload begins in the buffer, read-only."""
        return as_read_only(self._arrays[1])

    @property
    def sizes(self) -> Ints:
        """(n,) the bytes of each payload, read-only."""
        return as_read_only(self._arrays[2])

    @property
    def arrays(self) -> tuple[Bytes, Ints, Ints]:
        """Buffer, starts and sizes for kernels, which are compiled for arrays that may be written to; none writes."""
        return self._arrays

    @classmethod
    def of(cls, payloads: Iterable[bytes]) -> Payloads:
        """A column of separate byte strings."""
        parts = list(payloads)
        sizes = np.fromiter(map(len, parts), np.int64, len(parts))
        # a bytearray gives an array that may be written to, as all others are: one version of each kernel serves both
        return cls(np.frombuffer(bytearray().join(parts), dtype=np.uint8), _starts(sizes), sizes)

    @classmethod
    def join(cls, columns: Iterable[Payloads]) -> Payloads:
        """One column of several, in their order, in a buffer that holds nothing else."""
        parts = [column.compact() for column in columns]
        if len(parts) == 1:
            return parts[0]
        sizes = np.concatenate([part._arrays[2] for part in parts]) if parts else np.zeros(0, dtype=np.int64)
        data = np.concatenate([part._arrays[0] for part in parts]) if parts else np.zeros(0, dtype=np.uint8)
        return cls(data, _starts(sizes), sizes)

    def take(self, rows: Ints) -> Payloads:
        """Some of the payloads, in the same buffer."""
        data, starts, sizes = self._arrays
        taken = Payloads(data, starts[rows], sizes[rows])
        if self.kinds is not None:
            taken.kinds = self.kinds[rows]
        return taken

    def compact(self) -> Payloads:
        """The same payloads in a buffer without gaps."""
        data, begin, sizes = self._arrays
        starts = _starts(sizes)
        total = int(starts[-1] + sizes[-1]) if len(self) else 0
        if total == len(data) and np.array_equal(starts, begin):
            return self
        out = np.empty(total, dtype=np.uint8)
        _gather(data, begin, sizes, out, starts)
        return Payloads(out, starts, sizes)

    def __len__(self) -> int:
        return len(self._arrays[1])

    def __getitem__(self, row: int) -> bytes:
        data, starts, sizes = self._arrays
        start = int(starts[row])
        return data[start : start + int(sizes[row])].tobytes()

    def __iter__(self) -> Iterator[bytes]:
        data, starts, sizes = self._arrays
        whole = data.tobytes()
        for start, size in zip(starts.tolist(), sizes.tolist(), strict=True):
            yield whole[start : start + size]


def _starts(sizes: Ints) -> Ints:
    starts = np.zeros(len(sizes), dtype=np.int64)
    np.cumsum(sizes[:-1], out=starts[1:])
    return starts


_tuple = tuple.__new__  # half the cost of FrameId's own constructor, and every hop asks for an id


class Fate(StrEnum):
    """How the journey of a frame over one link ended."""

    DELIVERED = "delivered"
    LOST = "lost"  # the channel's loss took it (datagram links only)
    OVERFLOW = "overflow"  # the bounded queue of the channel, or of the receiver, was full
    DROPPED = "dropped"  # a tap's verdict
    REPLACED = "replaced"  # a tap sent another frame, its child, in its place
    IN_FLIGHT = "in_flight"  # the run ended first


_SLOTS = (
    "link", "direction", "sender", "serial", "src", "dst", "sent_ns", "payload", "parent", "causes", "arrived_ns",
    "fate",
)  # fmt: skip


class _Draft:
    """A frame while it is made; it becomes a `Frame`, whose layout it has."""

    __slots__ = _SLOTS


class Frame:
    """A frame on one link instance.

    `sender` is the endpoint that truly sent it (a tap's own for what the tap injects); `src` and `dst` are what the
    frame claims. `direction` is `"fwd"` from the link's first end to its second, else `"rev"`. `serial` counts the
    sender's frames on this link and direction, from 0. `parent` is the one frame that this one forwards, alters or
    duplicates. `arrived_ns` is set with the fate.

    Taps and agents are handed the frame itself: it cannot be altered. Only `end_journey`, of the kernel and of those
    that take its place, sets the fate.
    """

    __slots__ = _SLOTS

    arrived_ns: Time
    causes: tuple[FrameId, ...]
    direction: str
    dst: str
    fate: Fate
    link: str
    parent: FrameId | None
    payload: bytes
    sender: str
    sent_ns: Time
    serial: int
    src: str

    def __new__(
        cls,
        link: str,
        direction: str,
        sender: str,
        serial: int,
        src: str,
        dst: str,
        *,
        sent_ns: Time,
        payload: bytes,
        parent: FrameId | None = None,
        causes: tuple[FrameId, ...] = (),
    ) -> Frame:
        """A frame that was sent, and has not arrived."""
        draft: Any = _Draft()  # its slots can be set without a call of a descriptor for each
        draft.link = link
        draft.direction = direction
        draft.sender = sender
        draft.serial = serial
        draft.src = src
        draft.dst = dst
        draft.sent_ns = sent_ns
        draft.payload = payload
        draft.parent = parent
        draft.causes = causes
        draft.arrived_ns = NEVER
        draft.fate = Fate.IN_FLIGHT
        draft.__class__ = cls
        return draft  # type: ignore[no-any-return]

    def __setattr__(self, name: str, value: object) -> NoReturn:
        hint = "answer with a verdict, such as Replace(payload)"
        raise FrozenInstanceError(f"{name} of a frame cannot be altered: {hint}")

    def __delattr__(self, name: str) -> NoReturn:
        raise FrozenInstanceError(f"{name} of a frame cannot be deleted")

    def __reduce__(self) -> tuple[Callable[..., Frame], tuple[Any, ...]]:
        return _restore, tuple(getattr(self, name) for name in _SLOTS)

    def __deepcopy__(self, memo: dict[int, Any]) -> Frame:
        twin = memo[id(self)] = _restore(*(getattr(self, name) for name in _SLOTS))  # nothing in it can be altered
        return twin

    @property
    def id(self) -> FrameId:
        """(link, direction, true sender, that sender's serial)."""
        return _tuple(FrameId, (self.link, self.direction, self.sender, self.serial))

    def __repr__(self) -> str:
        return f"<Frame {self.id} {len(self.payload)} B sent {self.sent_ns} {self.fate}>"


_set_fate, _set_arrival = (Frame.__dict__[name].__set__ for name in ("fate", "arrived_ns"))


def end_journey(frame: Frame, fate: Fate, arrived_ns: Time = NEVER) -> None:
    """Set how the journey of a frame ended, and when it arrived if it did."""
    _set_fate(frame, fate)
    _set_arrival(frame, arrived_ns)


def _restore(*values: Any) -> Frame:
    link, direction, sender, serial, src, dst, sent_ns, payload, parent, causes, arrived_ns, fate = values
    frame = Frame(
        link, direction, sender, serial, src, dst, sent_ns=sent_ns, payload=payload, parent=parent, causes=causes
    )
    end_journey(frame, fate, arrived_ns)
    return frame


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
        """Those of a batch of runs may come again, once in each run."""
        self.numbers = {(name.link, name.direction, name.src): number for number, name in enumerate(names)}
        self.ports = [Port(name.dst, name.link) for name in names]
        self.places = places

    def find(self, port: Port, name: tuple[str, str, str]) -> int:
        """The number of the directed link at whose receiving `port` a frame with these first three fields of its id
        arrived; -1 if its sender is not that link's source.
        """
        return self.numbers.get(name, -1)

    def __deepcopy__(self, memo: object) -> LinkTable:
        return self


_ALL = slice(None)


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
        *,
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
            payloads=self.payloads,
            rows=np.arange(len(self.payloads))[rows] if self.rows is None else self.rows[rows],
            parent_link_numbers=self.parent_link_numbers[rows]
            if parents and self.parent_link_numbers is not None
            else None,
            parent_serial=self.parent_serial[rows] if parents and self.parent_serial is not None else None,
            causes=None if self.causes is None else take_causes(self.causes, rows),
        )

    def of_run(self, rows: slice, link_table: LinkTable, first: int) -> FrameBlock:
        """Some of the rows, all of one run of a batch, with the links of that run, which begin at number `first`."""
        if first == 0 and rows == _ALL and link_table is self.link_table:
            return self
        if self.rows is None:
            carried = None if rows == _ALL else np.arange(len(self.payloads))[rows]
        else:
            carried = self.rows[rows]
        parents = self.parent_link_numbers
        if parents is not None:
            parents = parents[rows]
            parents = np.where(parents < 0, parents, parents - first)
        return FrameBlock(
            link_table,
            self.link_numbers[rows] - first,
            self.serial[rows],
            self.sent_ns,
            self.arrived_ns,
            self.fate,
            payloads=self.payloads,
            rows=carried,
            parent_link_numbers=parents,
            parent_serial=None if self.parent_serial is None else self.parent_serial[rows],
            causes=None if self.causes is None else self.causes[rows],
        )

    def own_payloads(self) -> FrameBlock:
        """The same frames with a column of payloads that holds no others."""
        return FrameBlock(
            self.link_table,
            self.link_numbers,
            self.serial,
            self.sent_ns,
            self.arrived_ns,
            self.fate,
            payloads=self.carried(),
            parent_link_numbers=self.parent_link_numbers,
            parent_serial=self.parent_serial,
            causes=self.causes,
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
            frame = Frame(
                link,
                direction,
                src,
                serial,
                src,
                dst,
                sent_ns=self.sent_ns,
                payload=self.payload(row),
                parent=parent,
                causes=causes,
            )
            end_journey(frame, self.fate, self.arrived_ns)
            yield frame


def take_causes(causes: Causes, rows: Ints | NDArray[np.bool_]) -> Causes:
    """The causes of some of the rows."""
    numbers = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
    return [causes[row] for row in numbers.tolist()]
