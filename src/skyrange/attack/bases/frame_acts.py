"""Acts on frames that many kinds have: a kind whose class has one as its `act` needs no method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.verdicts import Delay, Drop, Verdict
from skyrange.core.time import NS_PER_US, Time

SHAM_NS: Final = NS_PER_US
"""Delay of a sham."""
_DROP: Final = (Drop(),)


def drop(probability: str | float = 1.0) -> Any:
    """Drop a frame with a probability: a number, or the name of the parameter that has it.

    The sham drops the same frames, because no benign act takes a frame off a link.
    """

    def act(self: Any, now: Time, frame: Frame) -> Sequence[Verdict]:
        share = getattr(self, probability) if isinstance(probability, str) else probability
        return _DROP if share >= 1.0 or self.draw(frame)[0] < share else ()

    return act


def delay(delay_ns: str, jitter_ns: str) -> Any:
    """Delay a frame by a constant and by a uniform random time, in the order of its direction.

    The arguments name fields with times in ns, which `prepare` sets. The kind has the state
    `last: dict[str, Time] = state(dict)`: until when the last frame of each direction is held.
    """

    def act(self: Any, now: Time, frame: Frame) -> Sequence[Verdict]:
        until, range_ns = now + getattr(self, delay_ns), getattr(self, jitter_ns)
        if range_ns:
            until += int(self.draw(frame)[0] * range_ns)
        until = max(until, self.last.get(frame.direction, until))
        self.last[frame.direction] = until
        return (Delay(until),)

    return act
