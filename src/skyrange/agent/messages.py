"""What goes into an agent and what comes out of it?

Both boxes are containers: iterate them frame by frame today, read them as columns where a batch
serves. Payloads are bytes always; nothing here knows MAVLink.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, overload

from skyrange.core.ids import FrameId, Port
from skyrange.core.time import Time

Scalar = str | int | float | bool | None


class Arrival(NamedTuple):
    """One frame as its receiver sees it.

    `port` is the receiver's own end, `at` the time it arrived (not later than the step's `now`),
    `src` the *claimed* sender. `ref` is a token to quote in `causes`; an agent never looks inside it.
    """

    port: Port
    at: Time
    payload: bytes
    src: str
    ref: FrameId


class Departure(NamedTuple):
    """One frame to send from `port`. `causes` names what commanded it; telemetry has none."""

    port: Port
    payload: bytes
    causes: tuple[FrameId, ...] = ()


class Note(NamedTuple):
    """Something worth a row: `kind` is `decision.…` or `event.…`, `about` a vehicle, operator or endpoint id.

    `data` holds scalars only. Decisions quote the frames that caused them.
    """

    kind: str
    about: str
    data: Mapping[str, Scalar]
    causes: tuple[FrameId, ...] = ()


class Inbox(Sequence[Arrival]):
    """What arrived since the agent's last step, in (time, link, sender, serial) order."""

    __slots__ = ("_arrivals",)

    def __init__(self, arrivals: Sequence[Arrival] = ()) -> None:
        self._arrivals = arrivals

    def __len__(self) -> int:
        return len(self._arrivals)

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


EMPTY_INBOX = Inbox()


class Outbox:
    """What an agent sends and says in one step, in the order it says it."""

    __slots__ = ("departures", "notes")

    def __init__(self) -> None:
        self.departures: list[Departure] = []
        self.notes: list[Note] = []

    def send(self, port: Port, payload: bytes, causes: tuple[FrameId, ...] = ()) -> None:
        """Send `payload` from `port`."""
        self.departures.append(Departure(port, payload, causes))

    def note(
        self, kind: str, about: str, data: Mapping[str, Scalar] | None = None, causes: tuple[FrameId, ...] = ()
    ) -> None:
        """Record a decision or an event."""
        self.notes.append(Note(kind, about, data or {}, causes))
