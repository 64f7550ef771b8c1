"""Attacks of a scenario that exclude each other: they alter the same thing at times that overlap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from skyrange.attack.exclusive import Exclusive, common
from skyrange.core.errors import Problem
from skyrange.core.time import NEVER, Time, from_seconds, to_seconds
from skyrange.scenario.model.attacks import ActTable

Acting = tuple[str, ActTable, Sequence[Exclusive]]
"""Where an attack is declared, its table, and what it alters as the only one."""
Window = tuple[Time, Time]
"""Start and end in nanoseconds; the end does not belong to it."""


def find_exclusions(acting: Sequence[Acting], duration_ns: Time) -> Iterator[Problem]:
    """A problem for each two attacks that alter the same at the same time. A muted one alters nothing."""
    heard = [
        (where, window, exclusive)
        for where, table, exclusive in acting
        if exclusive and not table.muted and (window := window_of(table, duration_ns))[0] < window[1]
    ]
    for (first, mine, one), (second, others, other) in combinations(heard, 2):
        if max(mine[0], others[0]) >= min(mine[1], others[1]):
            continue
        what = common(one, other)
        if what:
            yield Problem(
                second,
                f"alters {what} {_words(others)}",
                f"an attack that does not alter what {first} alters {_words(mine)}",
                "Choose times that do not overlap, or other aircraft or links.",
            )


def window_of(table: ActTable, duration_ns: Time) -> Window:
    """The time in which an attack may act; one with a condition may start at any time until it stops."""
    start = from_seconds(table.start_s)
    stop = min(duration_ns, NEVER if table.stop_s is None else from_seconds(table.stop_s))
    if table.for_s is not None and table.when is None:
        stop = min(stop, start + from_seconds(table.for_s))
    return start, stop


def _words(window: Window) -> str:
    return f"from {to_seconds(window[0]):g} s to {to_seconds(window[1]):g} s"
