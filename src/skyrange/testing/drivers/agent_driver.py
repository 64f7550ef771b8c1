"""Driver of a single agent, as a kernel drives it: mail at service times, wake-ups when due."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from skyrange.contracts.components import Agent, Tap
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.core.time import NS_PER_S, Time, ceil_to
from skyrange.testing.drivers.outbox_form import Said, said
from skyrange.testing.drivers.purity import Call, plainly
from skyrange.testing.rules import Broken, short

MAX_WAKEUPS_PER_S = 20_000
"""Steps without mail in a simulated second that still count as progress (a radio slot is 50 µs)."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Step:
    """One step: when, with how many arrivals, the outbox, its contents at that moment, and the next wake-up."""

    now: Time
    arrivals: int
    outbox: Outbox
    said: Said
    wakeup: Time | None


Row = tuple[Time, int, Said, Time | None]


def rows(steps: Sequence[Step]) -> list[Row]:
    """Steps as values that can be compared."""
    return [(step.now, step.arrivals, step.said, step.wakeup) for step in steps]


def drive(
    agent: Agent, arrivals: Sequence[Arrival], begin: Time, until: Time, *, call: Call = plainly, lag_ns: Time = 0
) -> list[Step]:
    """Every step after `begin`, up to `until`, each `lag_ns` late.

    `arrivals` are in order; those up to `begin` have been delivered. Raises `Broken` where the agent
    raises, answers with something else than a whole outbox, or does not progress.
    """
    steps: list[Step] = []
    waiting = [arrival for arrival in arrivals if arrival.at > begin]
    delivered = unprompted = 0
    now = begin
    requested_ns = wakeup(agent, None, call)
    allowed = MAX_WAKEUPS_PER_S * (1 + (until - begin) // NS_PER_S)
    while True:
        due = [] if requested_ns is None else [ceil_to(max(requested_ns, now + 1), agent.service_ns)]
        if delivered < len(waiting):
            due.append(ceil_to(max(waiting[delivered].at, now + 1), agent.service_ns))
        if not due or min(due) > until:
            return steps
        now = min(due) + lag_ns
        first = delivered
        while delivered < len(waiting) and waiting[delivered].at <= now:
            delivered += 1
        unprompted += first == delivered
        if unprompted > allowed:
            raise Broken(f"woke {unprompted} times by {now} ns", f"at most {MAX_WAKEUPS_PER_S} a second", "wakeups")
        inbox = Inbox(waiting[first:delivered])
        try:
            outbox = call(agent.step, now, inbox)
        except Broken:
            raise
        except Exception as error:
            payloads = short(inbox.payloads)
            raise Broken(f"step({now}) with mail {payloads} raised {error!r}", "an Outbox, whatever arrived") from error
        contents = said(outbox, tuple(agent.ports))
        requested_ns = wakeup(agent, now, call)
        steps.append(Step(now, delivered - first, outbox, contents, requested_ns))


def wakeup(component: Agent | Tap, now: Time | None, call: Call) -> Time | None:
    """What an agent or tap answers, twice alike, to `next_wakeup` after it acted at `now`; `Broken` (rule `wakeups`).

    `now` is `None` where an overdue wish may still stand: only a wake-up has to move a tap's on.
    """
    try:
        requested_ns, again = call(component.next_wakeup), call(component.next_wakeup)
    except Broken:
        raise
    except Exception as error:
        raise Broken(f"next_wakeup() raised {error!r}", "a time or None", "wakeups") from error
    _check_wakeup(requested_ns, again, now)
    return requested_ns


def _check_wakeup(requested_ns: object, again: object, now: Time | None) -> None:
    """`Broken` (rule `wakeups`) unless `requested_ns` is `None` or an `int` after `now`, and the same as `again`."""
    proper = requested_ns is None or (isinstance(requested_ns, int) and not isinstance(requested_ns, bool))
    if not proper:
        raise Broken(f"next_wakeup() is {short(requested_ns)}", "a Python int of nanoseconds, or None", "wakeups")
    if requested_ns != again:
        raise Broken(
            f"next_wakeup() is {requested_ns} and, asked again, {again}", "a question that changes nothing", "wakeups"
        )
    if now is not None and isinstance(requested_ns, int) and requested_ns <= now:
        raise Broken(f"next_wakeup() after {now} is {requested_ns}", "a later time, or None", "wakeups")


def copied(thing: T) -> T:
    """A deep copy; `Broken` where there is none."""
    try:
        return copy.deepcopy(thing)
    except Exception as error:
        raise Broken(
            f"copy.deepcopy raised {error!r}", "state of plain data: no generators, handles, locks or threads"
        ) from error
