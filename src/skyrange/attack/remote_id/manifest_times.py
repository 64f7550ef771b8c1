"""Manifests over Wi-Fi: which packs have one, and the period after which those of a sender repeat (RFC 9575)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from skyrange.codec.drip import SamType
from skyrange.codec.f3411 import MessageType
from skyrange.codec.f3411.encode import PACK_HEADER
from skyrange.core.time import NS_PER_S, NS_PER_US, Time

LONGEST_NS: Final = 12 * NS_PER_S
"""How long Manifests are remembered: RFC 9575, section 6.3, has one in 5 s at least."""
SHORTEST_NS: Final = NS_PER_S // 2
"""Shortest period that is believed: the recommended one is a second. Frames that come at once have none."""
LONG_NS: Final = 2 * NS_PER_S
ENOUGH: Final = 2
ENOUGH_SHORT: Final = 6
"""Manifests that have to come a period after another one, of periods of at least `LONG_NS` and of shorter ones."""
TOLERANCE_NS: Final = 100 * NS_PER_US
"""Of times that are expected: less than a pack of signatures takes."""
MAX_SURPRISES: Final = 3
"""Manifests out of their times in a row: fewer are late because the channel was busy."""
_DATA_AT: Final = 8
"""Where the authentication data begin in page 0 (F3411-22a, Authentication message)."""


@dataclass(slots=True)
class Rhythm:
    """The times of one sender's Manifests over Wi-Fi, and the period after which they repeat."""

    heard: list[Time] = field(default_factory=list)
    """Starts of the last ones."""
    period_ns: Time | None = None
    unheard: int = 0
    """Manifests expected since any frame of the sender was heard."""
    surprises: int = 0
    """Manifests heard since the last one that came when it was expected."""

    def hear(self, start_ns: Time, is_expected: bool) -> list[Time]:
        """Learn from a Manifest that was heard; the times of those to come, if the period is known only now."""
        self.surprises = 0 if is_expected else self.surprises + 1
        if self.surprises > MAX_SURPRISES:
            self.period_ns = None  # the sender has changed its times
        self.heard = [one for one in self.heard if start_ns - one <= LONGEST_NS] + [start_ns]
        if self.period_ns is not None:
            return []
        self.period_ns = find_period(self.heard)
        if self.period_ns is None:
            return []
        self.surprises = 0
        return [one + self.period_ns for one in self.heard if one + self.period_ns > start_ns]


def find_period(starts: Sequence[Time]) -> Time | None:
    """The shortest period with which all of these times repeat; `None` while they show none.

    A sender whose program polls slower than it broadcasts has several gaps in turn, and a period that is their sum.
    """
    for first in reversed(starts[:-1]):
        period_ns = starts[-1] - first
        if period_ns < SHORTEST_NS:
            continue
        again = [one for one in starts if one - period_ns >= starts[0] - TOLERANCE_NS]
        if len(again) >= (ENOUGH if period_ns >= LONG_NS else ENOUGH_SHORT) and all(
            any(abs(one - period_ns - other) <= TOLERANCE_NS for other in starts) for one in again
        ):
            return period_ns
    return None


def carries_manifest(body: bytes) -> bool:
    """Whether a pack begins with the first page of a DRIP Manifest, as its first bytes tell."""
    at = PACK_HEADER + _DATA_AT
    return (
        len(body) > at
        and body[0] >> 4 == MessageType.MESSAGE_PACK
        and body[PACK_HEADER] >> 4 == MessageType.AUTHENTICATION
        and body[PACK_HEADER + 1] & 0x0F == 0
        and body[at] == SamType.MANIFEST  # the first byte of the authentication data
    )
