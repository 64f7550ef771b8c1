"""Events of a kernel's heap, and how agents, routes and monitors are scheduled in it."""

from __future__ import annotations

from enum import IntEnum
from heapq import heapify, heappush
from typing import Any

from skyrange.core.time import Phase, Time, ceil_to
from skyrange.kernel.directed_link import Mailbox, RouteQueue

DELIVERY = int(Phase.DELIVERY)
WAKEUP = int(Phase.WAKEUP)
MONITOR = int(Phase.MONITOR)


class Code(IntEnum):
    """What an event of the heap does."""

    ARRIVE = 0  # a frame comes out of its channel, or of a receiver-side delay
    RESUME = 1  # a frame leaves a sender-side delay
    REPORT = 2  # frames that ended on a fused route are reported
    FORWARD = 3  # an endpoint's route sends on what waits
    TAP = 4  # a tap acts on its own initiative
    STEP = 5  # an agent is stepped
    DELIVER_BLOCKS = 6  # blocks come out of the last channel of their path
    RESUME_BLOCKS = 7  # an endpoint's route sends on blocks that have arrived
    SERVE = 8  # a monitor is handed what it has seen
    PROCESS = 9  # an endpoint has spent its time on a frame
    HEAR = 10  # a radio of an attacker has decoded a frame


# Plain ints: enum look-ups cost more than the events they name.
(
    ARRIVE, RESUME, REPORT, FORWARD, TAP, STEP, DELIVER_BLOCKS, RESUME_BLOCKS, SERVE, PROCESS, HEAR
) = (int(code) for code in Code)  # fmt: skip

Event = tuple[int, str, str, int, int, Any]
"""(time << 3 | phase, directed link or group, sender or owner, that sender's serial, code, what the code needs)."""


def schedule_mailbox(heap: list[Event], now: Time, box: Mailbox) -> None:
    """Have an agent stepped at its next service time from `now` on."""
    if box.polled:  # an engine's: its ticks collect the mail
        return
    due = ceil_to(now, box.service_ns)
    if box.due is None or due < box.due:
        box.due = due
        heappush(heap, ((due << 3) | WAKEUP, "agent", box.order, 0, STEP, box))


def schedule_route(heap: list[Event], due: Time, queue: RouteQueue) -> None:
    """Have what waits at a route sent on at `due`."""
    if queue.due != due:
        queue.due = due
        heappush(heap, ((due << 3) | WAKEUP, "", queue.hop.order, 0, FORWARD, queue))


def postpone_events(heap: list[Event], until: Time) -> None:
    """Have all that was due before `until` happen then, in its order.

    An agent that was due several times is stepped once, and a monitor served once. For a kernel without fused routes.
    """
    kept = []
    for key, link, sender, serial, code, data in heap:
        at = key >> 3
        if at < until:
            if code in (STEP, TAP, FORWARD, SERVE):
                if data.due != at:
                    continue  # it has happened, or was put off
                at = data.due = ceil_to(until, data.service_ns) if code in (STEP, SERVE) else until
            key = (max(at, until) << 3) | (key & 7)
        kept.append((key, link, sender, serial, code, data))
    heap[:] = kept
    heapify(heap)
