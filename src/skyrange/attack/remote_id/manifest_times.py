"""Manifests over Wi-Fi: which packs have one, after what period those of a sender repeat, and when the next come.

They are those of RFC 9575.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
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
MAX_SENDERS: Final = 256
MAX_UNHEARD: Final = 60
"""Predictions without any frame of the sender heard; then it is forgotten."""
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


@dataclass(slots=True)
class ManifestTimes:
    """The Manifests to come over Wi-Fi, of all senders."""

    rhythms: dict[bytes, Rhythm] = field(default_factory=dict)
    """By address of the sender."""
    _expected: list[tuple[Time, bytes]] = field(default_factory=list)
    """Heap of those to come, with the addresses of their senders."""
    _recent: dict[bytes, Time] = field(default_factory=dict)
    """The last time at which one was expected, by sender."""

    @property
    def next_ns(self) -> Time | None:
        """When the next one is expected."""
        return self._expected[0][0] if self._expected else None

    def hear_frame(self, address: bytes) -> None:
        """Note that a sender is still there."""
        if address in self.rhythms:
            self.rhythms[address].unheard = 0

    def hear_manifest(self, address: bytes, start_ns: Time) -> None:
        """Learn from a Manifest."""
        rhythm = self.rhythms.get(address)
        if rhythm is None:
            while len(self.rhythms) >= MAX_SENDERS:
                self._forget(next(iter(self.rhythms)))
            rhythm = self.rhythms[address] = Rhythm()
        is_expected = abs(start_ns - self._recent.get(address, 0)) <= TOLERANCE_NS
        coming = rhythm.hear(start_ns, is_expected)
        if rhythm.period_ns is None or coming:
            self._expect_none_of(address)
        for at_ns in coming:
            heappush(self._expected, (at_ns, address))

    def take(self, now: Time) -> list[Time]:
        """The times of those that are expected until `now`; each is taken once."""
        taken = []
        while self._expected and self._expected[0][0] <= now:
            at_ns, address = heappop(self._expected)
            rhythm = self.rhythms.get(address)
            if rhythm is None or rhythm.period_ns is None:
                continue
            rhythm.unheard += 1
            if rhythm.unheard > MAX_UNHEARD:
                self._forget(address)
                continue
            heappush(self._expected, (at_ns + rhythm.period_ns, address))
            self._recent[address] = at_ns
            taken.append(at_ns)
        return taken

    def _forget(self, address: bytes) -> None:
        del self.rhythms[address]
        self._recent.pop(address, None)
        self._expect_none_of(address)

    def _expect_none_of(self, address: bytes) -> None:
        self._expected = [one for one in self._expected if one[1] != address]
        heapify(self._expected)


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
