"""Inboxes, outboxes and turns: what agents and engines receive, send and note.

Both are containers: iterate them frame by frame, or handle many frames as columns. Payloads are always bytes; nothing
here depends on MAVLink.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, overload

import numpy as np

from skyrange.contracts.alerts import Alert, Scalar
from skyrange.contracts.frames import FrameBlock, Ints, Payloads
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import Time

End = Literal["station", "aircraft"]
"""The end of the access point, or that of the aircraft."""


class ChannelOrder(NamedTuple):
    """An order of one end to its radio."""

    link: str
    end: End
    channel: int
    announcements: int = 0
    """Of an access point: in how many beacons it announces the change before it changes; 0: at once and silently."""
    retune_ns: Time = 0
    """How long the radio neither sends nor receives while it changes."""
    action: str = "channel"
    """Name of the act in the record."""


_SERIAL_BITS = 40
"""Bound of a sender's serials: a million frames a second for twelve days."""


class Arrival(NamedTuple):
    """One frame as its receiver sees it.

    `port` is the receiver's own end, `at` the time of arrival (not later than the step's `now`), `src` the *claimed*
    sender. `ref` is a token to quote in `causes`; an agent never reads what it is made of.
    """

    port: Port
    at: Time
    payload: bytes
    src: str
    ref: FrameId


class Departure(NamedTuple):
    """One frame to send from `port`. `causes` names the frames that commanded it; telemetry has none."""

    port: Port
    payload: bytes
    causes: tuple[FrameId, ...] = ()


class Note(NamedTuple):
    """A decision or an event to be recorded: `kind` is `decision.…` or `event.…`, `about` an id it is about.

    That is the id of a vehicle, operator or endpoint. `data` has scalars only. Decisions name the frames that caused
    them.
    """

    kind: str
    about: str
    data: Mapping[str, Scalar]
    causes: tuple[FrameId, ...] = ()


class Parents(NamedTuple):
    """The frame of which each frame of a block is made: frame `serials[i]` of name `names[numbers[i]]`."""

    names: Sequence[tuple[str, str, str]]
    """(link, direction, sender): the first three fields of a `FrameId`."""
    numbers: Ints
    serials: Ints

    def id(self, row: int) -> FrameId:
        """The parent of one row."""
        return FrameId(*self.names[self.numbers.item(row)], self.serials.item(row))


class Block(NamedTuple):
    """Many frames to send, none of them commanded: row `i` leaves from the agent's `ports[places[i]]`."""

    places: Ints
    payloads: Payloads
    parents: Parents | None = None


class Columns(NamedTuple):
    """Frames of an inbox as columns, in order: place of the port, time of arrival in ns and payload of each row."""

    places: Ints
    at_ns: Ints
    payloads: Payloads
    order: Ints
    """Row → its number in the inbox, as `Inbox.arrival` takes it."""

    def take(self, rows: Ints) -> Columns:
        """Some of the frames, in the order of `rows`."""
        return Columns(self.places[rows], self.at_ns[rows], self.payloads.take(rows), self.order[rows])


class Inbox(Sequence[Arrival]):
    """Frames that arrived since the agent's last step, in order of (time, directed link, sender, serial)."""

    def __init__(self, arrivals: Sequence[Arrival] = (), blocks: Sequence[FrameBlock] = ()) -> None:
        """`arrivals` are in order; `blocks` need not be."""
        self._singles = arrivals
        self._blocks = blocks
        self._count = len(arrivals) + sum(map(len, blocks))

    def __len__(self) -> int:
        return self._count

    @property
    def singles(self) -> Sequence[Arrival]:
        """Frames that arrived singly: numbers 0… of `Columns.order`."""
        return self._singles

    @property
    def blocks(self) -> Sequence[FrameBlock]:
        """Frames that arrived in blocks: the numbers after the singles, row by row."""
        return self._blocks

    @overload
    def __getitem__(self, index: int) -> Arrival: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Arrival]: ...
    def __getitem__(self, index: int | slice) -> Arrival | Sequence[Arrival]:
        return self._arrivals[index]

    def __iter__(self) -> Iterator[Arrival]:
        return iter(self._arrivals)

    @property
    def payloads(self) -> list[bytes]:
        """The payload column."""
        return [arrival.payload for arrival in self._arrivals]

    def columns(self, places: Mapping[Port, int]) -> Columns:
        """The frames as columns; `places` has the place of each of the agent's ports among them."""
        singles, blocks = self._singles, self._blocks
        if not singles and len(blocks) == 1 and len(blocks[0]) == 1:  # what a station of one aircraft gets most of all
            (block,) = blocks
            return Columns(block.link_table.places[block.link_numbers], self._at_ns, block.carried(), self._order)
        order = self._order
        parts = [block.carried() for block in blocks]
        ports = [block.link_table.places[block.link_numbers] for block in blocks]
        if singles or not blocks:
            parts.insert(0, Payloads.of([arrival.payload for arrival in singles]))
            ports.insert(0, np.array([places[arrival.port] for arrival in singles], dtype=np.int64))
        payloads = parts[0] if len(parts) == 1 else Payloads.join(parts)
        return Columns(_concatenate(ports)[order], self._at_ns[order], payloads.take(order), order)

    def arrival(self, number: int) -> Arrival:
        """One arrival by its number in `Columns.order`."""
        if number < len(self._singles):
            return self._singles[number]
        number -= len(self._singles)
        for block in self._blocks:
            if number < len(block):
                link = int(block.link_numbers[number])
                name = block.link_table.names[link]
                return Arrival(
                    block.link_table.ports[link], block.arrived_ns, block.payload(number), name.src, block.id(number)
                )
            number -= len(block)
        raise IndexError(number)

    def arrivals(self, numbers: Ints) -> Sequence[Arrival]:
        """Arrivals by their numbers in `Columns.order`, in the order of `numbers`."""
        if not len(numbers):
            return []
        singles = self._singles
        if not self._blocks:
            return [singles[number] for number in numbers.tolist()]
        arrivals_by_number: dict[int, Arrival] = {
            number: singles[number] for number in numbers[numbers < len(singles)].tolist()
        }
        begin = len(singles)
        for block in self._blocks:
            end = begin + len(block)
            chosen = numbers[(numbers >= begin) & (numbers < end)]
            if chosen.size:
                arrivals_by_number.update(zip(chosen.tolist(), _arrivals_of(block, chosen - begin), strict=True))
            begin = end
        return [arrivals_by_number[number] for number in numbers.tolist()]

    @cached_property
    def _arrivals(self) -> Sequence[Arrival]:
        return self._singles if not self._blocks else self.arrivals(self._order)

    @cached_property
    def _at_ns(self) -> Ints:
        """When each arrived, by its number."""
        times = [np.full(len(block), block.arrived_ns, dtype=np.int64) for block in self._blocks]
        if self._singles or not times:
            times.insert(0, np.array([arrival.at for arrival in self._singles], dtype=np.int64))
        return _concatenate(times)

    @cached_property
    def _order(self) -> Ints:
        """Numbers of the arrivals in their order; singles count first, then the blocks' rows."""
        if not self._blocks:
            return np.arange(len(self._singles), dtype=np.int64)
        block = self._blocks[0]
        if self._count == 1:
            return np.zeros(1, dtype=np.int64)
        numbers = [block.link_table.find(arrival.port, arrival.ref[:3]) for arrival in self._singles]
        if min(numbers, default=0) >= 0:  # directed links are numbered in order of their names
            keys = [block.link_numbers << _SERIAL_BITS | block.serial for block in self._blocks]
            if not self._singles and len(keys) == 1:  # of one time
                return keys[0].argsort(kind="stable")
            serials = np.array([arrival.ref.serial for arrival in self._singles], dtype=np.int64)
            keys.insert(0, np.array(numbers, dtype=np.int64) << _SERIAL_BITS | serials)
            return np.lexsort((np.concatenate(keys), self._at_ns))
        # a tap's frames are among them, whose sender is no link's source
        named = [_key(arrival) for arrival in self._singles]
        for block in self._blocks:
            for row in range(len(block)):
                id_ = block.id(row)
                named.append((block.arrived_ns, f"{id_.link}:{id_.direction}", id_.sender, id_.serial))
        return np.array(sorted(range(len(named)), key=named.__getitem__), dtype=np.int64)


def _concatenate(parts: Sequence[Ints]) -> Ints:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _arrivals_of(block: FrameBlock, rows: Ints) -> list[Arrival]:
    """Some rows of a block as their receivers see them."""
    table, at = block.link_table, block.arrived_ns
    links, serials = block.link_numbers[rows].tolist(), block.serial[rows].tolist()
    arrivals = []
    for link, serial, payload in zip(links, serials, block.carried().take(rows), strict=True):
        name = table.names[link]
        ref = FrameId(name.link, name.direction, name.src, serial)
        arrivals.append(Arrival(table.ports[link], at, payload, name.src, ref))
    return arrivals


def _key(arrival: Arrival) -> tuple[Time, str, str, int]:
    ref = arrival.ref
    return arrival.at, f"{ref.link}:{ref.direction}", ref.sender, ref.serial


EMPTY_INBOX = Inbox()


class Outbox:
    """Frames, notes and acts of an agent in one step, in order; blocks leave after single frames."""

    __slots__ = ("acts", "blocks", "departures", "notes")

    def __init__(self) -> None:
        self.departures: list[Departure] = []
        self.blocks: list[Block] = []
        self.notes: list[Note] = []
        self.acts: list[ChannelOrder | Alert] = []
        """Of a defence's agent only: orders to radios, and alerts."""

    def send(self, port: Port, payload: bytes, causes: tuple[FrameId, ...] = ()) -> None:
        """Send `payload` from `port`."""
        self.departures.append(Departure(port, payload, causes))

    def send_block(self, places: Ints, payloads: Payloads, parents: Parents | None = None) -> None:
        """Send every `payloads[i]` from the agent's `ports[places[i]]`, after what is sent singly.

        `parents` names the frames of which these are made, where an agent alters or passes on what it received.
        """
        self.blocks.append(Block(places, payloads, parents))

    def each(self, ports: Sequence[Port]) -> Iterator[Departure]:
        """All frames, singly; `ports` are the agent's."""
        yield from self.departures
        for places, payloads, _ in self.blocks:
            for place, payload in zip(places.tolist(), payloads, strict=True):
                yield Departure(ports[place], payload)

    def note(
        self, kind: str, about: str, data: Mapping[str, Scalar] | None = None, causes: tuple[FrameId, ...] = ()
    ) -> None:
        """Record a decision or an event."""
        self.notes.append(Note(kind, about, data or {}, causes))


@dataclass(slots=True)
class Turn:
    """What an agent does in one step because of some frames: what it sends and notes here names them as its causes."""

    now: Time
    out: Outbox
    causes: tuple[FrameId, ...] = ()

    def caused_by(self, *causes: FrameId) -> Turn:
        """The same step, with other causes, or with none."""
        return Turn(self.now, self.out, causes)

    def send(self, port: Port, payload: bytes) -> None:
        """Send `payload` from `port`."""
        self.out.send(port, payload, self.causes)

    def note(self, kind: str, about: str, data: Mapping[str, Scalar] | None = None) -> None:
        """Record a decision or an event."""
        self.out.note(kind, about, data, self.causes)
