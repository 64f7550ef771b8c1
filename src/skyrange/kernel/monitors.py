"""Monitors at link ends: which frames each is handed, when it is served, and the alerts that it raises.

What is seen is collected where frames are sent and where they arrive, on the slow and on the fast path alike; frames on
fused routes are known ahead of their time and wait here until the service time that follows it. So a monitor neither
un-fuses a route nor can tell that one is fused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heappush

import numpy as np

from skyrange.contracts.frames import Frame, FrameBlock, Ints, Payloads
from skyrange.contracts.links import LinkSpec
from skyrange.contracts.monitors import (
    Monitor,
    MonitorPlacement,
    ObservedFrames,
    find_ends,
    make_monitor,
    serve_monitor,
)
from skyrange.core.ids import Port
from skyrange.core.time import Time
from skyrange.kernel.directed_link import DirectedLink
from skyrange.kernel.event_heap import MONITOR, SERVE, Event
from skyrange.kernel.observers import ObserverList


class FrameCollector:
    """What is observed at some ends of links between two service times, for all monitors that listen at these ends and
    are served at the same times.
    """

    __slots__ = (
        "_blocks", "_collected_ns", "_dst", "_frames", "_names", "_numbers", "_places", "_shared", "_singles", "_src",
        "ports",
    )  # fmt: skip

    def __init__(self, ports: Sequence[Port], links: Sequence[DirectedLink], *, shared: bool) -> None:
        """`ports` are the ends of some of `links`, in order of run, link and endpoint.

        `links` are by number: those of one run, or where it is `shared` those of all runs of a batch, which the run of
        a port tells apart.
        """
        self.ports = ports
        self._shared = shared
        number = {port: place for place, port in enumerate(ports)}
        runs = [link.run if shared else 0 for link in links]
        sent = [number.get(Port(link.src, link.link_name, run), -1) for link, run in zip(links, runs, strict=True)]
        arrived = [number.get(Port(link.dst, link.link_name, run), -1) for link, run in zip(links, runs, strict=True)]
        self._places = np.array([sent, arrived], dtype=np.int64).reshape(2, -1)
        """(2, links): the place of a link's sending end and of its receiving end in `ports`, -1 where it is none."""
        self._names = sorted({name for link in links for name in (link.src, link.dst)})
        self._numbers = {name: place for place, name in enumerate(self._names)}
        self._src = np.array([self._numbers[link.src] for link in links], dtype=np.int64)
        self._dst = np.array([self._numbers[link.dst] for link in links], dtype=np.int64)
        self._blocks: list[tuple[Time, int, FrameBlock]] = []
        self._singles: list[tuple[Time, int, int, Frame]] = []
        self._collected_ns: Time | None = None
        self._frames: ObservedFrames | None = None
        """What was collected last."""

    def listens(self, link: DirectedLink, *, received: bool) -> bool:
        """Whether it listens at the receiving end of a link, or at its sending end."""
        return bool(self._places[int(received), link.number if self._shared else link.own_number] >= 0)

    def take_frame(self, at: Time, link: DirectedLink, frame: Frame, *, received: bool) -> None:
        """Keep a frame that is sent from, or arrives at, an end at which it listens; `at` may be in the future."""
        self._singles.append((at, link.number if self._shared else link.own_number, int(received), frame))

    def take_block(self, block: FrameBlock) -> None:
        """Keep those frames of a block that are sent from, or arrive at, an end at which it listens."""
        for received, at in enumerate((block.sent_ns, block.arrived_ns)):
            if self._places[received][block.link_numbers].max(initial=-1) >= 0:
                self._blocks.append((at, received, block))

    def collect(self, now: Time) -> ObservedFrames:
        """What was seen after the last service time and up to `now`: the same for each monitor that asks at `now`."""
        if self._frames is None or self._collected_ns != now:
            self._collected_ns, self._frames = now, self._collect(now)
        return self._frames

    def _collect(self, now: Time) -> ObservedFrames:
        singles = [entry for entry in self._singles if entry[0] <= now]
        blocks = [entry for entry in self._blocks if entry[0] <= now]
        self._singles = [entry for entry in self._singles if entry[0] > now]
        self._blocks = [entry for entry in self._blocks if entry[0] > now]
        columns = [(np.zeros(0, dtype=np.int64),) * 6]
        payloads: list[Payloads] = []
        names: Sequence[str] = self._names
        if singles:
            frames = [frame for *_, frame in singles]
            when = np.array([entry[:3] for entry in singles], dtype=np.int64)
            names, src, dst = self._number_claims(frames)
            serials = np.array([frame.serial for frame in frames], dtype=np.int64)
            columns.append((when[:, 0], when[:, 1], when[:, 2], serials, src, dst))
            payloads.append(Payloads.of([frame.payload for frame in frames]))
        for at, is_received, block in blocks:
            rows = np.flatnonzero(self._places[is_received][block.link_numbers] >= 0)
            link, carried = block.link_numbers[rows], block.carried()
            same = (np.full(len(rows), at, dtype=np.int64), link, np.full(len(rows), is_received, dtype=np.int64))
            columns.append((*same, block.serial[rows], self._src[link], self._dst[link]))
            payloads.append(carried if len(rows) == len(block) else carried.take(rows))
        at_ns, links, received, serial, src, dst = (np.concatenate(parts) for parts in zip(*columns, strict=True))
        places = self._places[received, links]
        rank = self._rank_senders([frame.sender for *_, frame in singles], links)
        order = np.lexsort((serial, rank, received, places, at_ns))
        every = Payloads.join(payloads).take(order)
        return ObservedFrames(
            self.ports,
            places[order],
            received[order] > 0,
            at_ns[order],
            payloads=every,
            names=names,
            src=src[order],
            dst=dst[order],
        )

    def _number_claims(self, frames: Sequence[Frame]) -> tuple[Sequence[str], Ints, Ints]:
        """All names, and which of them each frame claims as its source and destination."""
        numbers, strange = self._numbers, dict[str, int]()
        claimed = np.empty((2, len(frames)), dtype=np.int64)
        for row, frame in enumerate(frames):
            for side, name in enumerate((frame.src, frame.dst)):
                number = numbers.get(name)
                claimed[side, row] = strange.setdefault(name, len(numbers) + len(strange)) if number is None else number
        return [*self._names, *strange] if strange else self._names, claimed[0], claimed[1]

    def _rank_senders(self, senders: Sequence[str], links: Ints) -> Ints:
        """(n,) numbers in the order of the true senders' names: `senders` first, then their links' own."""
        ranks = self._src[links]
        numbers = [self._numbers.get(sender, -1) for sender in senders]
        if min(numbers, default=0) >= 0:  # numbered in order of their names
            ranks[: len(senders)] = numbers
            return ranks
        every = sorted({*self._names, *senders})
        place = {name: number for number, name in enumerate(every)}
        ranks = np.array([place[name] for name in self._names], dtype=np.int64)[ranks]
        ranks[: len(senders)] = [place[sender] for sender in senders]
        return ranks


class MonitorSlot:
    """A placed monitor: where it listens, and when it is next served."""

    __slots__ = ("collector", "due", "id", "monitor", "order", "owner")

    def __init__(self, id_: str, monitor: Monitor, collector: FrameCollector, owner: Monitors, prefix: str) -> None:
        self.id = id_
        self.order = f"{prefix}{id_}"
        self.owner = owner
        self.monitor = monitor
        self.collector = collector
        self.due: Time = 0

    @property
    def service_ns(self) -> Time:
        """How often it is served."""
        return self.monitor.service_ns


class Monitors:
    """All monitors of one run, or those that listen in all runs of a batch."""

    def __init__(
        self,
        placements: Sequence[MonitorPlacement],
        runs: Sequence[tuple[Sequence[LinkSpec], Mapping[str, DirectedLink]]],
        heap: list[Event],
        observers: ObserverList,
        prefix: str = "",
    ) -> None:
        """Place monitors at ends of the links of `runs`, which are numbered.

        `prefix` has the number of the run, where it is one of a batch. Raises `InputError` for a placement that matches
        no end of a link.
        """
        self._heap = heap
        self._observers = observers
        self.slots: list[MonitorSlot] = []
        collectors: dict[tuple[tuple[Port, ...], Time], FrameCollector] = {}
        numbered = sorted((link for _, directed in runs for link in directed.values()), key=_number_of)
        here = {(link.run, link.dst, link.link_name) for link in numbered if link.local}
        shared = len(runs) > 1
        for placement in sorted(placements, key=_id_of):
            local = [
                port._replace(run=run) if shared else port
                for run, (links, directed) in enumerate(runs)
                for port in find_ends(placement, [(spec.name, spec.a, spec.b) for spec in links])
                if (next(iter(directed.values())).run, port.endpoint, port.link) in here
            ]
            if local:
                monitor = make_monitor(placement)
                key = tuple(local), monitor.service_ns
                if key not in collectors:
                    collectors[key] = FrameCollector(local, numbered, shared=shared)
                self.slots.append(MonitorSlot(placement.id, monitor, collectors[key], self, prefix))
        self._collectors = list(collectors.values())
        for link in numbered:
            sent = [one for one in self._collectors if one.listens(link, received=False)]
            arrived = [one for one in self._collectors if one.listens(link, received=True)]
            link.send_monitors = (*link.send_monitors, *sent)
            link.arrival_monitors = (*link.arrival_monitors, *arrived)

    def begin(self) -> None:
        """Have each served at time 0 first."""
        for slot in self.slots:
            self._schedule(slot, 0)

    def take_block(self, block: FrameBlock) -> None:
        """Show a block that is sent, with the time at which it arrives."""
        for collector in self._collectors:
            collector.take_block(block)

    def serve(self, now: Time, slot: MonitorSlot) -> None:
        """Hand a monitor what it has seen, and report its alerts. `ComponentError` where it breaks its contract."""
        for alert in serve_monitor(slot.id, slot.monitor, now, slot.collector.collect(now)):
            self._observers.report_alert(now, slot.id, alert)
        self._schedule(slot, now + slot.service_ns)

    def _schedule(self, slot: MonitorSlot, due: Time) -> None:
        slot.due = due
        heappush(self._heap, ((due << 3) | MONITOR, "monitor", slot.order, 0, SERVE, slot))


def _number_of(link: DirectedLink) -> int:
    return link.number


def _id_of(placement: MonitorPlacement) -> str:
    return placement.id
