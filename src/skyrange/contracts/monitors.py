"""Monitors, the contract of detectors: passive subscribers at link ends, what they see and raise, how they are made.

A monitor listens at ends of links as somebody does who has put a recorder on that end's network interface: it sees what
arrives there and what is sent from there, with the source and destination that each frame claims. It learns neither who
truly sent a frame, nor what becomes of it elsewhere, nor what it was made of, nor that an attack acted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.alerts import Alert, find_problem
from skyrange.contracts.frames import Ints, Payloads
from skyrange.contracts.plugins.registry import DETECTORS, Plugin
from skyrange.core.arrays import as_read_only
from skyrange.core.errors import ComponentError, InputError, Problem, attribute_error, nearest
from skyrange.core.ids import Port
from skyrange.core.time import Time

if TYPE_CHECKING:
    from skyrange.core.chance import Chance
    from skyrange.core.geodesy import Origin
    from skyrange.core.time import Epoch


class ObservedFrame(NamedTuple):
    """One frame as it was seen at one end of its link."""

    port: Port
    """The end at which it was seen."""
    received: bool
    """Whether it arrived there; else it was sent from there."""
    at: Time
    """When it arrived, or was sent."""
    payload: bytes
    src: str
    """The source that it claims."""
    dst: str
    """The destination that it claims."""


class ObservedFrames(Sequence[ObservedFrame]):
    """Frames seen since a monitor's last service time, as columns of one row each; iterating them gives single frames.

    Rows are in order of time; ties are settled by port, what was sent before what arrived, sender and its count. The
    arrays are read-only, because other monitors are handed the same.
    """

    def __init__(
        self,
        ports: Sequence[Port],
        places: Ints,
        received: NDArray[np.bool_],
        at_ns: Ints,
        *,
        payloads: Payloads,
        names: Sequence[str],
        src: Ints,
        dst: Ints,
    ) -> None:
        self.ports = ports
        """Every end at which the monitor listens, in order of link and endpoint: the same throughout a run."""
        self.places = as_read_only(places)
        """(n,) where each frame was seen: its port's place in `ports`."""
        self.received = as_read_only(received)
        """(n,) whether it arrived there, else it was sent from there."""
        self.at_ns = as_read_only(at_ns)
        """(n,) when it arrived or was sent, in ns."""
        self.payloads = payloads
        """n payloads."""
        self.names = names
        """Endpoints that `src` and `dst` number."""
        self.src = as_read_only(src)
        """(n,) the source that it claims: a place in `names`."""
        self.dst = as_read_only(dst)
        """(n,) the destination that it claims, likewise."""

    def __len__(self) -> int:
        return len(self.places)

    @overload
    def __getitem__(self, index: int) -> ObservedFrame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[ObservedFrame]: ...
    def __getitem__(self, index: int | slice) -> ObservedFrame | Sequence[ObservedFrame]:
        return self._frames[index]

    def __iter__(self) -> Iterator[ObservedFrame]:
        return iter(self._frames)

    def take(self, rows: Ints | NDArray[np.bool_]) -> ObservedFrames:
        """Some of the frames, by (m,) row numbers or an (n,) mask."""
        chosen = np.arange(len(self))[rows]
        return ObservedFrames(
            self.ports,
            self.places[chosen],
            self.received[chosen],
            self.at_ns[chosen],
            payloads=self.payloads.take(chosen),
            names=self.names,
            src=self.src[chosen],
            dst=self.dst[chosen],
        )

    @cached_property
    def _frames(self) -> list[ObservedFrame]:
        ports, names = self.ports, self.names
        columns = (self.places, self.received, self.at_ns, self.src, self.dst)
        rows = zip(*(column.tolist() for column in columns), self.payloads, strict=True)
        return [
            ObservedFrame(ports[place], received, at, payload, names[src], names[dst])
            for place, received, at, src, dst, payload in rows
        ]


class Monitor(Protocol):
    """A passive subscriber: same inputs, same alerts; no clock, no socket, no thread.

    It is served at every multiple of `service_ns` from time 0 to the end of the run, at the end of that instant,
    whether or not anything was seen. In a live range, and there only, a service time may be left out while its process
    stands still; what was seen comes with the next. All its state is deep-copyable data.
    """

    service_ns: Time
    """How often it is served, more than 0."""

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Take in what was seen after the last service time and up to `now`; returns a list or tuple of alerts."""
        ...


@dataclass(frozen=True, slots=True)
class MonitorPlacement:
    """A detector: the monitor that `make` returns, and the link ends at which it listens.

    These are the `side` end of every link that matches one of `links`, which are link names or patterns with `*`, such
    as `gcs:*`; `side` is an endpoint, its role (`gcs`, `companion`) or a pattern of either, `*` for both ends. `id`
    names the detector in the alerts. In a live range each process that has such ends runs a monitor of its own at them.
    """

    id: str
    make: Callable[[], Monitor]
    """Returns a new monitor, all alike: one for each run."""
    links: Sequence[str]
    side: str


def make_monitor(placement: MonitorPlacement) -> Monitor:
    """A new monitor; `InputError` where it declares no service time above 0."""
    monitor = placement.make()
    service = monitor.service_ns
    if isinstance(service, bool) or not isinstance(service, int) or service <= 0:
        where = f"monitors.{placement.id}.service_ns"
        raise InputError.one("wiring", where, repr(service), "a whole number of ns, over 0")
    return monitor


def find_ends(placement: MonitorPlacement, links: Iterable[tuple[str, str, str]]) -> list[Port]:
    """The ends at which a placement listens, in order of link and endpoint; `links` are (name, one end, other end).

    Raises `InputError` for a pattern that no link matches, and for a link that has no such side.
    """
    known = {name: (a, b) for name, a, b in links}
    where = f"monitors.{placement.id}"
    problems: list[Problem] = []
    ports: set[Port] = set()
    for pattern in placement.links:
        names = [name for name in known if fnmatchcase(name, pattern)]
        if not names:
            expected = "a link's name or a pattern that matches some"
            problems.append(Problem(f"{where}.links", pattern, expected, nearest(pattern, known)))
        for name in names:
            ends = [end for end in known[name] if is_side(end, placement.side)]
            if not ends:
                expected = f"an end of {name}: {known[name][0]} or {known[name][1]}"
                problems.append(Problem(f"{where}.side", placement.side, expected))
            ports.update(Port(end, name) for end in ends)
    if problems:
        raise InputError("wiring", problems)
    return sorted(ports, key=_link_first)


def _link_first(port: Port) -> tuple[str, str]:
    return port.link, port.endpoint


def is_side(end: str, side: str) -> bool:
    """Whether `side` means the endpoint `end`: by its name, its role, or a pattern of either."""
    return fnmatchcase(end, side) or fnmatchcase(end.rpartition(".")[2], side)


def serve_monitor(detector: str, monitor: Monitor, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
    """Hand a monitor what it has seen; returns its alerts. Raises `ComponentError` where it breaks its contract."""
    who = f"detector {detector}"
    try:
        alerts = monitor.observe(now, frames)
    except Exception as error:
        raise attribute_error(who, now, error) from error
    if not isinstance(alerts, (list, tuple)) or isinstance(alerts, Alert):
        raise ComponentError(who, f"answered observe with {alerts!r:.160}; a list of alerts was expected")
    for alert in alerts:
        problem = find_problem(now, alert)
        if problem:
            raise ComponentError(who, problem)
    return alerts


@dataclass(frozen=True, slots=True)
class DetectorContext:
    """The context of a detector: data of the scenario, without its attacks."""

    id: str
    """The detector's id, unique among the detectors of the scenario."""
    vehicles: Sequence[str]
    """Every vehicle id of the scenario (`blue/b1`), in order."""
    origin: Origin
    epoch: Epoch
    chance: Chance

    def __post_init__(self) -> None:
        object.__setattr__(self, "vehicles", tuple(self.vehicles))


@dataclass(frozen=True, slots=True)
class DetectorPlugin(Plugin[DetectorContext, Monitor]):
    """A kind of detector. `make` returns a new monitor at each call: one for each run, and each process of it."""

    group: ClassVar[str] = DETECTORS

    reduced: str = field(default="", kw_only=True)
    """What it lacks of the published method that it is named after, such as inputs or a rate; "" for nothing.

    Rankings mark a detector that has it: its place says nothing about the method as published.
    """
