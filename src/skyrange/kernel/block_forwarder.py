"""Forwarding of blocks: the fast path works out their hops; here they meet time and the frames that travel singly.

A delivery of blocks is an event. Rows whose directed link has single frames waiting continue singly beside those.
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heappush

import numpy as np

from skyrange.contracts.frames.blocks import Causes, FrameBlock
from skyrange.contracts.frames.frame import Fate, Frame
from skyrange.contracts.frames.payloads import Ints, Payloads
from skyrange.contracts.mailboxes import Parents
from skyrange.core.ids import Port
from skyrange.core.time import NEVER, Time
from skyrange.kernel.directed_link import DirectedLink, RouteQueue
from skyrange.kernel.event_heap import (
    DELIVER_BLOCKS,
    DELIVERY,
    RESUME_BLOCKS,
    WAKEUP,
    Event,
    schedule_mailbox,
    schedule_route,
)
from skyrange.kernel.fast_path import BlockDelivery, FastPath, PendingHop, group_rows
from skyrange.kernel.monitors import Monitors


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
        self._fast_path = FastPath([], {})
        self._monitors: Monitors | None = None
        self._events = 0

    def open_paths(self, ports: dict[Port, int], fuse: bool, monitors: Monitors) -> None:
        """Work out the paths of blocks; `ports` has the place of every owned port among its owner's."""
        self._fast_path = FastPath(self._links if fuse else [], ports)
        self._monitors = monitors if monitors.slots else None

    def choose_paths(self, links: Ints, parents: Parents | None) -> tuple[Ints, Ints | None]:
        """(n,) the path of each row, -1 for a row that travels singly; and the directed link of each parent."""
        fast = self._fast_path
        paths = fast.path_of[links] if len(fast.path_of) else np.full(len(links), -1, dtype=np.int64)
        parent_links = fast.find_parent_links(parents) if parents is not None else None
        if parent_links is not None:  # columns know frames of the links' own sources; a tap's frame is none of them
            paths = np.where(np.isin(links, links[parent_links < 0]), -1, paths)  # whole links, to keep their order
        return paths, parent_links

    def send(
        self,
        now: Time,
        path: int,
        links: Ints,
        payloads: Payloads,
        parent_links: Ints | None,
        parent_serials: Ints | None,
        causes: Causes | None = None,
    ) -> None:
        """Send `payloads[i]` from the source of directed link `links[i]`, all of one path."""
        counts = self._links[0].sent_counts
        self._schedule(self._fast_path.send(now, path, links, payloads, parent_links, parent_serials, causes, counts))

    def deliver(self, now: Time, delivery: BlockDelivery) -> None:
        """Put what has arrived into its mailboxes, or have it sent on."""
        for pending in delivery.pending:  # before any route queue of that moment: "" is less than their names
            self._events += 1
            heappush(self._heap, ((pending.sent << 3) | WAKEUP, "", "", self._events, RESUME_BLOCKS, pending))
        if not delivery.to_mailboxes:
            return
        block, fast = delivery.hops[-1], self._fast_path
        owners = fast.mailbox_of[block.link_numbers]
        for owner, rows in group_rows(owners):
            box = fast.mailboxes[owner]
            box.blocks.append(block if rows is None else block.take(rows))
            schedule_mailbox(self._heap, now, box)

    def resume(self, now: Time, pending: PendingHop) -> None:
        """Send blocks on; rows whose link has single frames waiting at this moment wait with them, in their order."""
        busy = {queue.hop.link.number for queue in self._queues.values() if queue.frames}
        if busy:
            links = pending.links
            held = np.isin(links, list(busy))
            if held.any():
                self._queue_singly(now, pending.take(held), links[held])
                pending = pending.take(~held)
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
            if self._monitors is not None:
                self._monitors.take_blocks(delivery.hops)
            self._events += 1  # only so that no two events are equal: the order of deliveries shows nowhere
            heappush(self._heap, ((delivery.arrival << 3) | DELIVERY, "", "", self._events, DELIVER_BLOCKS, delivery))


def cut_off(now: Time, delivery: BlockDelivery) -> list[FrameBlock]:
    """The hops that had begun when the run ended at `now`; those that had not arrived stay in flight."""
    found = [block for block in delivery.hops if block.sent_ns <= now]
    for block in found:
        if block.arrived_ns > now:
            block.arrived_ns = NEVER
            block.fate = Fate.IN_FLIGHT
    return found
