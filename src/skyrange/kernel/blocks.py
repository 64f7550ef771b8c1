"""Blocks of frames: the fast path over fused routes, and where it meets time and the frames that travel singly.

A directed link begins a *path* when everything on the way is declared, untapped and steady. Then all frames that leave
at one instant have the same times on every hop, and only their serials differ. The wiring decides which links share a
path; frames on all others travel singly, and the record does not tell which it was. On a *staged* hop an agent sends
beside what is forwarded: there blocks wait until their time before they continue.

A delivery of blocks is an event. Rows whose directed link has single frames waiting continue singly beside those.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from heapq import heappush
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.frames import Causes, Fate, Frame, FrameBlock, Ints, LinkTable, Payloads
from skyrange.contracts.links import RowFilter
from skyrange.contracts.mailboxes import Parents
from skyrange.core.compiled import compiled
from skyrange.core.time import NEVER, Time, ceil_to
from skyrange.kernel.batch_blocks import BatchObserver, RunSplitter
from skyrange.kernel.directed_link import DirectedLink, Mailbox, RouteQueue
from skyrange.kernel.event_heap import (
    DELIVER_BLOCKS,
    DELIVERY,
    RESUME_BLOCKS,
    WAKEUP,
    Event,
    schedule_mailbox,
    schedule_route,
)
from skyrange.kernel.monitors import Monitors
from skyrange.kernel.observers import ObserverList

Select = Callable[[bytes], bool]


@compiled
def _take_serials(links: Ints, sent_counts: Ints) -> Ints:
    """Each row's serial on its directed link, counting them up."""
    out = np.empty_like(links)
    for row in range(links.shape[0]):
        link = links[row]
        out[row] = sent_counts[link]
        sent_counts[link] += 1
    return out


class _Hop:
    """One hop of a path: which directed link it is for every link that begins the path."""

    __slots__ = ("boxed", "latency_ns", "link_of", "next", "select_rows", "service_ns", "staged")

    def __init__(
        self, latency_ns: Time, service_ns: Time, *, select: Select | None, boxed: bool, staged: bool, size: int
    ) -> None:
        self.latency_ns = latency_ns
        self.service_ns = service_ns
        self.select_rows = None if select is None else _select_rows_by(select)
        self.boxed = boxed
        self.staged = staged
        """Whether the hops behind it begin only when the blocks have arrived here."""
        self.link_of = np.full(size, -1, dtype=np.int64)
        self.next: list[_Hop] = []


class BlockDelivery:
    """Blocks at the end of their path: the hops before the last, and the last, for the mailboxes or for `pending`."""

    __slots__ = ("arrival", "hops", "pending", "to_mailboxes")

    def __init__(self, arrival: Time, hops: list[FrameBlock], *, to_mailboxes: bool, pending: list[PendingHop]) -> None:
        self.arrival = arrival
        self.hops = hops
        self.to_mailboxes = to_mailboxes
        self.pending = pending


class PendingHop:
    """Rows of a block that has arrived, to be sent on along one route at `sent`."""

    __slots__ = ("block", "hop", "rows", "sent", "starts")

    def __init__(self, sent: Time, hop: _Hop, starts: Ints, block: FrameBlock, rows: Ints) -> None:
        self.sent = sent
        self.hop = hop
        self.starts = starts
        self.block = block
        self.rows = rows

    @property
    def links(self) -> Ints:
        """(n,) the numbers of the directed links on which they are sent on."""
        return self.hop.link_of[self.starts]

    def take(self, keep: NDArray[np.bool_]) -> PendingHop:
        """Some of the rows."""
        return PendingHop(self.sent, self.hop, self.starts[keep], self.block, self.rows[keep])


_NONE = np.zeros(0, dtype=np.int64)


class FastPath:
    """The directed links of a kernel by number, and the paths that blocks take over them."""

    def __init__(self, links: Sequence[DirectedLink], link_table: LinkTable) -> None:
        """`links` by number, wired."""
        self.link_table = link_table
        self.path_of = np.full(len(links), -1, dtype=np.int64)
        """Directed link → its path, -1 for none."""
        self.mailboxes: list[Mailbox] = []
        self.mailbox_of = np.full(len(links), -1, dtype=np.int64)
        self._names: Sequence[tuple[str, str, str]] = ()
        self._named = _NONE
        """The directed link of each name of the last table of parents, -1 for none."""
        self._paths: list[_Hop] = []
        known: dict[Any, int] = {}
        numbers: dict[str, int] = {}
        for link in links:
            if link.mailbox is not None:
                number = numbers.get(link.mailbox.order)
                if number is None:
                    number = numbers[link.mailbox.order] = len(self.mailboxes)
                    self.mailboxes.append(link.mailbox)
                self.mailbox_of[link.number] = number
            shape = _path_shape(link)
            if shape is None:
                continue
            if shape not in known:
                known[shape] = len(self._paths)
                self._paths.append(_build_hop(link, 0, None, len(links)))
            self.path_of[link.number] = known[shape]
            _add_start(self._paths[known[shape]], link.number, link)

    def find_parent_links(self, parents: Parents, table: LinkTable, first: int) -> Ints:
        """(n,) the number of each parent's directed link, -1 where the parent's sender is not that link's source.

        `table` has the links of the parents' run, and `first` is the number of the first of them.
        """
        names, known = parents.names, self._named
        if names is not self._names:  # another agent's table
            self._names, known = names, _NONE
        if len(known) < len(names):  # a table only grows
            numbers = np.array([table.numbers.get(name, -1) for name in names[len(known) :]], dtype=np.int64)
            known = np.concatenate([known, np.where(numbers < 0, numbers, numbers + first)])
        self._named = known
        return known[parents.numbers]

    def send(
        self,
        now: Time,
        path: int,
        links: Ints,
        payloads: Payloads,
        *,
        parent_links: Ints | None,
        parent_serials: Ints | None,
        causes: Causes | None,
        sent_counts: Ints,
    ) -> list[BlockDelivery]:
        """Send `payloads` on `links` (numbers, all of one path); returns where and when each of them comes out."""
        traversal = _Traversal(self.link_table, sent_counts, [])
        cargo = _Cargo(links, payloads, None, parent_links, parent_serials, causes)
        _follow(traversal, self._paths[path], now, cargo, [])
        return traversal.deliveries

    def resume(self, pending: PendingHop, sent_counts: Ints) -> list[BlockDelivery]:
        """Send on what has waited until its time."""
        traversal = _Traversal(self.link_table, sent_counts, [])
        block, rows = pending.block, pending.rows
        payload_rows = rows if block.rows is None else block.rows[rows]
        cargo = _Cargo(pending.starts, block.payloads, payload_rows, block.link_numbers[rows], block.serial[rows])
        _follow(traversal, pending.hop, pending.sent, cargo, [])
        return traversal.deliveries


class _Traversal(NamedTuple):
    """What all hops of one sending share: the links, how many frames each has sent, and where the blocks come out."""

    table: LinkTable
    sent_counts: Ints
    deliveries: list[BlockDelivery]


class _Cargo(NamedTuple):
    """Frames that begin a hop at one instant, one row each, as in `FrameBlock`."""

    starts: Ints
    """(n,) the directed link that begins each frame's path."""
    payloads: Payloads
    rows: Ints | None
    parent_links: Ints | None
    parent_serials: Ints | None
    causes: Causes | None = None
    """Of the first hop of a path only."""


def _follow(traversal: _Traversal, hop: _Hop, now: Time, cargo: _Cargo, hops: list[FrameBlock]) -> None:
    """Send frames over a hop and, where they need not wait, over all hops behind it; `hops` are those before it."""
    starts, payloads, rows = cargo.starts, cargo.payloads, cargo.rows
    link = hop.link_of[starts]
    serial = _take_serials(link, traversal.sent_counts)
    arrival = now + hop.latency_ns
    block = FrameBlock(
        traversal.table,
        link,
        serial,
        now,
        arrival,
        Fate.DELIVERED,
        payloads=payloads,
        rows=rows,
        parent_link_numbers=cargo.parent_links,
        parent_serial=cargo.parent_serials,
        causes=cargo.causes,
    )
    hops.append(block)
    if hop.staged:
        pending = []
        for onward in hop.next:
            chosen = np.arange(len(link))
            if onward.select_rows is not None:
                (chosen,) = onward.select_rows(block.carried()).nonzero()
            if len(chosen):
                sent = ceil_to(arrival, onward.service_ns)
                pending.append(PendingHop(sent, onward, starts[chosen], block, chosen))
        traversal.deliveries.append(BlockDelivery(arrival, hops, to_mailboxes=False, pending=pending))
        return
    branched = False
    for onward in hop.next:
        sent = ceil_to(arrival, onward.service_ns)
        if onward.select_rows is None:
            _follow(traversal, onward, sent, _Cargo(starts, payloads, rows, link, serial), hops)
        else:
            (chosen,) = onward.select_rows(block.carried()).nonzero()
            if len(chosen) == 0:
                continue
            payload_rows = chosen if rows is None else rows[chosen]
            _follow(
                traversal,
                onward,
                sent,
                _Cargo(starts[chosen], payloads, payload_rows, link[chosen], serial[chosen]),
                hops,
            )
        branched = True
        hops = []  # the first branch reports the hops before it
    if not branched:
        traversal.deliveries.append(BlockDelivery(arrival, hops, to_mailboxes=hop.boxed, pending=[]))


def _select_rows_by(select: Select) -> Callable[[Payloads], NDArray[np.bool_]]:
    """The function that decides as `select` does, on many payloads at once."""
    if isinstance(select, RowFilter):
        return select.rows
    return partial(_select_each, select)


def _select_each(select: Select, payloads: Payloads) -> NDArray[np.bool_]:
    return np.fromiter(map(select, payloads), np.bool_, len(payloads))


def group_rows(values: Ints) -> Iterator[tuple[int, Ints | None]]:
    """Each of some values, in ascending order, and the rows that have it: None where all rows do."""
    if len(values) and (values == values[0]).all():
        yield values.item(0), None
        return
    for value in np.unique(values).tolist():
        yield value, (values == value).nonzero()[0]


def _path_shape(link: DirectedLink) -> Any:
    """What two directed links must have in common to share a path; `None` where blocks cannot travel."""
    if not link.local or link.sender_taps or link.receiver_taps or link.processing is not None:
        return None
    if not link.channel.steady:
        return None
    latency_ns = link.channel.latency_ns
    if not link.routes:
        return (latency_ns, link.mailbox is not None)
    if link.mailbox is not None or (link.fused is None and link.staged is None):
        return None
    onward = []
    for route, target in link.fused or link.staged or ():
        target_shape = _path_shape(target)
        if target_shape is None:
            return None
        onward.append((route.service_ns, route.select, target_shape))
    return (latency_ns, link.staged is not None, tuple(onward))


def _build_hop(link: DirectedLink, service_ns: Time, select: Select | None, size: int) -> _Hop:
    boxed, staged = link.mailbox is not None, link.staged is not None
    hop = _Hop(link.channel.latency_ns, service_ns, select=select, boxed=boxed, staged=staged, size=size)
    hop.next = [
        _build_hop(target, route.service_ns, route.select, size) for route, target in link.fused or link.staged or ()
    ]
    return hop


def _add_start(hop: _Hop, start: int, link: DirectedLink) -> None:
    """Enter the directed links of a path that begins at `start`."""
    hop.link_of[start] = link.number
    for next_hop, (_, target) in zip(hop.next, link.fused or link.staged or (), strict=True):
        _add_start(next_hop, start, target)


def _arrival_order(frame: Frame) -> tuple[Time, str, int]:
    """The order in which frames come out of one channel."""
    return frame.arrived_ns, frame.sender, frame.serial


class BlockForwarder:
    """All blocks under way in one kernel."""

    def __init__(self, heap: list[Event], links: Sequence[DirectedLink], queues: dict[str, RouteQueue]) -> None:
        """`links` by number; `heap` and `queues`, the frames that wait at routes by name, are those of single frames.

        Call `open_paths` once the links are wired.
        """
        self._heap = heap
        self._links = links
        self._queues = queues
        self._splitter = RunSplitter([], 1)
        self._fast_path = FastPath([], self._splitter.whole)
        self._monitors: Sequence[Monitors | None] = ()
        self._shared_monitors: Monitors | None = None
        self._observers: Sequence[ObserverList] = ()
        self._observer: BatchObserver | None = None
        self._events = 0

    def open_paths(
        self, observers: Sequence[ObserverList], monitors: Sequence[Monitors], shared: Monitors | None, *, fuse: bool
    ) -> None:
        """Work out the paths of blocks; `observers` and `monitors` are those of each run, `shared` those of all."""
        self._splitter = RunSplitter(self._links if fuse else [], len(monitors))
        self._fast_path = FastPath(self._links if fuse else [], self._splitter.whole)
        self._observers = observers
        self._monitors = [each if each.slots else None for each in monitors] if any(m.slots for m in monitors) else ()
        self._shared_monitors = shared

    def choose_paths(self, links: Ints, parents: Parents | None, run: int) -> tuple[Ints, Ints | None]:
        """(n,) the path of each row, -1 for a row that travels singly; and the directed link of each parent, which is a
        frame of the run with number `run`.
        """
        fast, splitter = self._fast_path, self._splitter
        paths = fast.path_of[links] if len(fast.path_of) else np.full(len(links), -1, dtype=np.int64)
        parent_links = None
        if parents is not None:
            parent_links = fast.find_parent_links(parents, splitter.tables[run], splitter.first[run])
        if parent_links is not None:  # columns know frames of the links' own sources; a tap's frame is none of them
            paths = np.where(np.isin(links, links[parent_links < 0]), -1, paths)  # whole links, to keep their order
        return paths, parent_links

    def observe(self, observer: BatchObserver | None) -> None:
        """Have one observer see the blocks of all runs, instead of those of each."""
        self._observer = observer

    def report(self, blocks: Sequence[FrameBlock]) -> None:
        """Report blocks that have met their fate to the observers of their runs."""
        if self._observer is not None:
            self._observer.on_blocks(blocks)
            return
        if len(self._observers) == 1:
            self._observers[0].report_blocks(blocks)
            return
        for block in blocks:
            for run, rows in self._splitter.split(block):
                self._observers[run].report_blocks([rows.own_payloads()])

    def send(
        self,
        now: Time,
        path: int,
        links: Ints,
        payloads: Payloads,
        *,
        parent_links: Ints | None = None,
        parent_serials: Ints | None = None,
        causes: Causes | None = None,
    ) -> None:
        """Send `payloads[i]` from the source of directed link `links[i]`, all of one path."""
        counts = self._links[0].sent_counts
        deliveries = self._fast_path.send(
            now,
            path,
            links,
            payloads,
            parent_links=parent_links,
            parent_serials=parent_serials,
            causes=causes,
            sent_counts=counts,
        )
        self._schedule(deliveries)

    def deliver(self, now: Time, delivery: BlockDelivery) -> None:
        """Report what has arrived, and put it into its mailboxes or have it sent on."""
        self.report(delivery.hops)
        for pending in delivery.pending:  # before any route queue of that moment: "" is less than their names
            self._events += 1
            heappush(self._heap, ((pending.sent << 3) | WAKEUP, "", "", self._events, RESUME_BLOCKS, pending))
        if not delivery.to_mailboxes:
            return
        block, fast_path = delivery.hops[-1], self._fast_path
        owners = fast_path.mailbox_of[block.link_numbers]
        if len(self._observers) > 1:
            self._deliver_batch(now, block, owners)
            return
        for owner, rows in group_rows(owners):
            box = fast_path.mailboxes[owner]
            box.blocks.append(block if rows is None else block.take(rows))
            schedule_mailbox(self._heap, now, box)

    def _deliver_batch(self, now: Time, block: FrameBlock, owners: Ints) -> None:
        """Put rows into the mailboxes `owners`, each as the run of its owner sees them."""
        steps = np.diff(owners)
        if (steps < 0).any():
            order = owners.argsort(kind="stable")
            block, owners = block.take(order), owners[order]
            steps = np.diff(owners)
        numbers = owners.tolist()
        start = 0
        for end in [*(steps.nonzero()[0] + 1).tolist(), len(numbers)]:
            box, rows = self._fast_path.mailboxes[numbers[start]], slice(start, end)
            tables = self._splitter
            if box.run is None:
                box.blocks.append(block.take(np.arange(start, end)))
            else:
                box.blocks.append(block.of_run(rows, tables.tables[box.run], tables.first[box.run]))
            schedule_mailbox(self._heap, now, box)
            start = end

    def resume(self, now: Time, pending: PendingHop) -> None:
        """Send blocks on; rows whose link has single frames waiting at this moment wait with them, in their order."""
        busy = {queue.hop.link.number for queue in self._queues.values() if queue.frames}
        if busy:
            links = pending.links
            is_held = np.isin(links, list(busy))
            if is_held.any():
                self._queue_singly(now, pending.take(is_held), links[is_held])
                pending = pending.take(~is_held)
        if len(pending.rows):
            self._schedule(self._fast_path.resume(pending, self._links[0].sent_counts))

    def _queue_singly(self, now: Time, pending: PendingHop, links: Ints) -> None:
        """Have rows of a block wait as single frames beside those that wait already."""
        queues = {queue.hop.link.number: queue for queue in self._queues.values()}
        frames = pending.block.take(pending.rows).frames()
        for link, frame in zip(links.tolist(), frames, strict=True):
            queue = queues[link]
            queue.frames.append(frame)
            queue.frames.sort(key=_arrival_order)
            schedule_route(self._heap, now, queue)

    def _schedule(self, deliveries: Sequence[BlockDelivery]) -> None:
        for delivery in deliveries:
            if self._monitors:
                self._show(delivery.hops)
            if self._shared_monitors is not None:
                for block in delivery.hops:
                    self._shared_monitors.take_block(block)
            self._events += 1  # only so that no two events are equal: the order of deliveries shows nowhere
            heappush(self._heap, ((delivery.arrival << 3) | DELIVERY, "", "", self._events, DELIVER_BLOCKS, delivery))

    def _show(self, blocks: Sequence[FrameBlock]) -> None:
        """Show blocks that are sent to the monitors of their runs."""
        for block in blocks:
            for run, rows in self._splitter.split(block):
                monitors = self._monitors[run]
                if monitors is not None:
                    monitors.take_block(rows)


def cut_off(now: Time, delivery: BlockDelivery) -> list[FrameBlock]:
    """The hops that had begun when the run ended at `now`; those that had not arrived stay in flight."""
    begun = [block for block in delivery.hops if block.sent_ns <= now]
    for block in begun:
        if block.arrived_ns > now:
            block.arrived_ns = NEVER
            block.fate = Fate.IN_FLIGHT
    return begun
