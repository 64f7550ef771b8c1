"""What time is it in the range? Nanoseconds since its time 0, by this machine's monotonic clock.

All processes of a machine share that clock (`CLOCK_MONOTONIC`), so between them there is nothing to measure. Another
machine's is another clock: it began elsewhere, and runs faster or slower by some millionths. Its offset is measured as
NTP does (RFC 5905, section 8): a question and its answer, of which the quickest tells most.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

JUMP_NS: Final[Time] = 100 * NS_PER_MS
"""A clock that moved by more than this, and than is uncertain, did not drift: it was set, or stood still."""
PHI: Final = 15e-6
"""How much faster or slower a clock is taken to be able to run: RFC 5905, section 7.2, PHI."""
_PPM: Final = 1e6


@dataclass(slots=True)
class RangeClock:
    """A clock that is 0 at `zero_ns` of `time.monotonic_ns`; that may be set anew as the offset is measured again."""

    zero_ns: int

    def now(self) -> Time:
        """The range's time."""
        return time.monotonic_ns() - self.zero_ns


@dataclass(frozen=True, slots=True)
class Echo:
    """A question and its answer: sent and back by the asking machine's clock, answered by the range's, in ns."""

    sent_ns: int
    answered_ns: int
    back_ns: int

    @property
    def offset_ns(self) -> int:
        """What the asking machine's clock shows more than the range's, if both ways took as long."""
        return (self.sent_ns + self.back_ns) // 2 - self.answered_ns

    @property
    def uncertainty_ns(self) -> int:
        """How far off that can be at most, however unequal the ways: half of the time until the answer was back."""
        return -(-(self.back_ns - self.sent_ns) // 2)


def best(echoes: Sequence[Echo]) -> Echo:
    """The one that tells most: the quickest."""
    return min(echoes, key=lambda echo: echo.uncertainty_ns)


@dataclass(slots=True)
class Offset:
    """One machine's clock against the range's: what it shows more, how sure that is, how it drifts, when it jumped."""

    offset_ns: int = 0
    uncertainty_ns: int = 0
    measured: int = 0
    jumps: list[dict[str, Any]] = field(default_factory=list)
    _echoes: list[Echo] = field(default_factory=list)
    """All since the last jump."""

    def take(self, echo: Echo, zero_ns: int) -> None:
        """One more measurement; `zero_ns` is the range's zero on its own clock, 0 before that is told.

        One that took long says less than what was known, until that has grown old.
        """
        moved = abs(echo.offset_ns - self.offset_ns)
        known_ns = self.uncertainty_ns
        if self._echoes:
            known_ns += round(PHI * (echo.answered_ns - self._echoes[-1].answered_ns))
        jumped = bool(self._echoes) and moved > JUMP_NS + echo.uncertainty_ns + known_ns
        if jumped:
            self._echoes.clear()
            if zero_ns:
                at_s, by_s = (echo.answered_ns - zero_ns) / NS_PER_S, (echo.offset_ns - self.offset_ns) / NS_PER_S
                self.jumps.append({"at_s": round(at_s, 3), "by_s": round(by_s, 3)})
        apart = moved > echo.uncertainty_ns + known_ns
        if not self._echoes or apart or echo.uncertainty_ns <= known_ns:
            self.offset_ns, self.uncertainty_ns = echo.offset_ns, echo.uncertainty_ns
        else:
            self.uncertainty_ns = known_ns
        self._echoes.append(echo)
        self.measured += 1

    @property
    def drift_ppm(self) -> tuple[float, float] | None:
        """By how many millionths it is fast, and how uncertain that is; `None` before it was measured three times.

        A line through all measurements since the last jump, each weighted by its uncertainty as if that were a
        standard deviation.
        """
        if len(self._echoes) < 3:
            return None
        at, offset, sigma = (
            np.array([getattr(echo, name) for echo in self._echoes], np.float64)
            for name in ("answered_ns", "offset_ns", "uncertainty_ns")
        )
        weight = np.maximum(sigma, 1.0) ** -2
        from_mean = at - np.average(at, weights=weight)
        spread = float((weight * from_mean**2).sum())
        if spread == 0.0:
            return None
        slope = float((weight * from_mean * (offset - self.offset_ns)).sum()) / spread
        return _PPM * slope, _PPM * spread**-0.5

    @property
    def told(self) -> dict[str, Any]:
        """For the manifest, in seconds and ppm."""
        drift = self.drift_ppm
        return {
            "offset_s": round(self.offset_ns / NS_PER_S, 9),
            "uncertainty_s": round(self.uncertainty_ns / NS_PER_S, 9),
            "drift_ppm": None if drift is None else round(drift[0], 2),
            "drift_uncertainty_ppm": None if drift is None else round(drift[1], 2),
            "measured": self.measured,
            "jumps": list(self.jumps),
        }
