"""What does an event in the heap say, and how are agents and routes woken by one?"""

from __future__ import annotations

from enum import IntEnum
from heapq import heapify, heappush
from typing import Any

from skyrange.core.time import Phase, Time, ceil_to
from skyrange.kernel.lane import Forwarder, Mailbox

DELIVERY = int(Phase.DELIVERY)
WAKEUP = int(Phase.WAKEUP)
MONITOR = int(Phase.MONITOR)


class Code(IntEnum):
    """What an event in the heap does."""

    ARRIVE = 0  # a frame comes out of its channel, or of a receiver-side delay
    RESUME = 1  # a frame leaves a sender-side delay
    CLOSE = 2  # frames whose journey ended on the way are recorded
    FORWARD = 3  # an endpoint's route sends on what waits
    TAP = 4  # a tap acts on its own initiative
    STEP = 5  # an agent is stepped
    LAND = 6  # blocks come out of the last channel of their express
    GO_ON = 7  # an endpoint's route sends on blocks that have come
    SERVE = 8  # a monitor is handed what it has seen


# Plain ints: enum look-ups cost more than the events they name.
ARRIVE, RESUME, CLOSE, FORWARD, TAP, STEP, LAND, GO_ON, SERVE = (int(code) for code in Code)

Event = tuple[int, str, str, int, int, Any]
"""(time << 3 | phase, lane or group, sender or owner, that sender's serial, code, what the code needs)."""


def wake_box(heap: list[Event], now: Time, box: Mailbox) -> None:
    """See to it that an agent is stepped at its next service time from `now` on."""
    if box.polled:  # an engine's: its ticks collect the mail
        return
    due = ceil_to(now, box.service_ns)
    if box.due is None or due < box.due:
        box.due = due
        heappush(heap, ((due << 3) | WAKEUP, "agent", box.name, 0, STEP, box))


def wake_forwarder(heap: list[Event], due: Time, forwarder: Forwarder) -> None:
    """See to it that what waits at a route is sent on at `due`."""
    if forwarder.due != due:
        forwarder.due = due
        heappush(heap, ((due << 3) | WAKEUP, "", forwarder.forward.name, 0, FORWARD, forwarder))


def held_up(heap: list[Event], until: Time) -> None:
    """Have all that was due before `until` happen then, in its order: an agent that was due several times steps once.

    So is a monitor served once. For a kernel without fused routes.
    """
    kept = []
    for key, lane, sender, serial, code, data in heap:
        at = key >> 3
        if at < until:
            if code in (STEP, TAP, FORWARD, SERVE):
                if data.due != at:
                    continue  # it has happened, or was put off
                at = data.due = ceil_to(until, data.service_ns) if code in (STEP, SERVE) else until
            key = (max(at, until) << 3) | (key & 7)
        kept.append((key, lane, sender, serial, code, data))
    heap[:] = kept
    heapify(heap)
