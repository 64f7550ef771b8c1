"""Acts on frames that many kinds have: a kind with the base `OnLinks` that has one as its `act` needs no method.

Arguments are numbers, or names of parameters that have them. Each act has two forms, which do the same and leave the
kind in the same state: `kind.act(now, frame)` answers a frame, and `kind.act.columns(kind, now, block)` the rows of a
block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.frames import Frame, FrameBlock, Ints
from skyrange.contracts.plugins.form import reads_fields
from skyrange.contracts.verdicts import Delay, Drop, Verdict
from skyrange.core.time import NEVER, NS_PER_US, Time, from_seconds

SHAM_NS: Final = NS_PER_US
"""Delay of a sham."""
_DROP: Final = (Drop(),)


class RowVerdicts(NamedTuple):
    """What an act answers the n rows of a block."""

    dropped: NDArray[np.bool_]
    """(n,)"""
    until_ns: Ints
    """(n,) Until when each is held; `NEVER` where it is not."""
    copies_ns: Ints
    """(n, m) When copies of each are put on the link, which the kind keeps until then; `NEVER` where it has none."""


def drop(probability: str | float = 1.0) -> Any:
    """Drop a frame with a probability: a number, or the name of the parameter that has it.

    The sham drops the same frames, because no benign act takes a frame off a link.
    """

    def act(self: Any, now: Time, frame: Frame) -> Sequence[Verdict]:
        return _DROP if _is_chosen(self, probability, frame) else ()

    def columns(self: Any, now: Time, block: FrameBlock) -> RowVerdicts:
        return _verdicts(block)._replace(dropped=_find_chosen(self, probability, block))

    return _with_columns(act, columns, probability)


def delay(delay_s: str | float, jitter_s: str | float = 0.0) -> Any:
    """Delay a frame by a constant and by a uniform random time from 0 to `jitter_s`, in the order of its direction.

    Both are in seconds: numbers, or names of parameters that have them. The sham delays the same frames by 1 µs.
    """

    def act(self: Any, now: Time, frame: Frame) -> Sequence[Verdict]:
        delay_ns, jitter_ns = _find_times(self, delay_s, jitter_s)
        until = now + delay_ns + (int(self.draw(frame)[0] * jitter_ns) if jitter_ns else 0)
        flow = (frame.link, frame.direction)
        until = max(until, self.delayed_until.get(flow, until))
        self.delayed_until[flow] = until
        return (Delay(until),)

    def columns(self: Any, now: Time, block: FrameBlock) -> RowVerdicts:
        delay_ns, jitter_ns = _find_times(self, delay_s, jitter_s)
        until = np.full(len(block), now + delay_ns, dtype=np.int64)
        if jitter_ns:
            until += (self.draws(block)[:, 0] * jitter_ns).astype(np.int64)
        for flow, rows in _find_ways(block):
            until[rows] = np.maximum.accumulate(np.maximum(until[rows], self.delayed_until.get(flow, now)))
            self.delayed_until[flow] = int(until[rows[-1]])
        return _verdicts(block)._replace(until_ns=until)

    return _with_columns(act, columns, delay_s, jitter_s)


def duplicate(copies: str | int, after_s: str | float, probability: str | float = 1.0) -> Any:
    """Let a frame pass, and with a probability put copies of it on the link, the n-th `n * after_s` later.

    The arguments are numbers, or names of parameters that have them. The sham puts benign frames of the same length in
    place of the copies.
    """

    def act(self: Any, now: Time, frame: Frame) -> Sequence[Verdict]:
        if _is_chosen(self, probability, frame):
            copy = self.copy_of(frame)
            for due in _find_dues(self, now, copies, after_s):
                self.waiting_frames.add(due, copy)
        return ()

    def columns(self: Any, now: Time, block: FrameBlock) -> RowVerdicts:
        chosen = _find_chosen(self, probability, block)
        dues = _find_dues(self, now, copies, after_s)
        for frame in block.take(chosen).frames():
            copy = self.copy_of(frame)
            for due in dues:
                self.waiting_frames.add(due, copy)
        return _verdicts(block)._replace(copies_ns=np.where(chosen[:, None], np.array(dues, dtype=np.int64), NEVER))

    return _with_columns(act, columns, copies, after_s, probability)


def _with_columns(act: Any, columns: Callable[..., RowVerdicts], *arguments: Any) -> Any:
    """The act with its form for blocks."""
    act.columns = columns
    return reads_fields(act, *arguments)


def _value(kind: Any, argument: Any) -> Any:
    """The argument of an act: a parameter of the kind, if it is a name."""
    return getattr(kind, argument) if isinstance(argument, str) else argument


def _is_chosen(kind: Any, probability: str | float, frame: Frame) -> bool:
    share = _value(kind, probability)
    return share >= 1.0 or bool(kind.draw(frame)[0] < share)


def _find_chosen(kind: Any, probability: str | float, block: FrameBlock) -> NDArray[np.bool_]:
    share = _value(kind, probability)
    return np.ones(len(block), dtype=np.bool_) if share >= 1.0 else kind.draws(block)[:, 0] < share


def _find_times(kind: Any, delay_s: str | float, jitter_s: str | float) -> tuple[Time, Time]:
    """Constant delay and range of the random one in nanoseconds."""
    return (SHAM_NS, 0) if kind.sham else (from_seconds(_value(kind, delay_s)), from_seconds(_value(kind, jitter_s)))


def _find_dues(kind: Any, now: Time, copies: str | int, after_s: str | float) -> list[Time]:
    """When the copies of a frame are due that passes at `now`."""
    after_ns = from_seconds(_value(kind, after_s))
    return [now + turn * after_ns for turn in range(1, _value(kind, copies) + 1)]


def _find_ways(block: FrameBlock) -> Iterator[tuple[tuple[str, str], Ints]]:
    """Link and direction of the rows of a block, with these rows in order."""
    numbers, places = np.unique(block.link_numbers, return_inverse=True)
    ways = [block.link_table.names[number][:2] for number in numbers.tolist()]
    first = {flow: place for place, flow in reversed(list(enumerate(ways)))}
    of_row = np.array([first[flow] for flow in ways], dtype=np.int64)[places]
    order = np.argsort(of_row, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(of_row[order])) + 1):
        if len(rows):
            yield ways[int(of_row[rows[0]])], rows


def _verdicts(block: FrameBlock) -> RowVerdicts:
    """All rows pass."""
    count = len(block)
    return RowVerdicts(np.zeros(count, dtype=np.bool_), np.full(count, NEVER), np.empty((count, 0), dtype=np.int64))
