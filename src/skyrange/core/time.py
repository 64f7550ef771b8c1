"""Simulated time: integer nanoseconds since the scenario's start, and their relation to UTC.

Simulated code reads no clock: time is passed in. Negative times are the pre-roll, in which real engines boot.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import IntEnum
from functools import lru_cache

Time = int
"""A moment or a span in integer nanoseconds of simulated time."""

NS_PER_US = 1_000
NS_PER_MS = 1_000_000
NS_PER_S = 1_000_000_000

GPS_LEAP_S = 18
"""Seconds by which GPS time is ahead of UTC since 2017 (IERS Bulletin C 52)."""

_UNIX = datetime(1970, 1, 1, tzinfo=UTC)

NEVER: Time = 2**63 - 1
"""Later than any time that a run can reach (292 years)."""


class Phase(IntEnum):
    """The order of what happens in one instant."""

    WORLD = 0
    ENGINES = 1
    MEDIUM = 2
    DELIVERY = 3
    WAKEUP = 4
    MONITOR = 5


def from_seconds(seconds: float) -> Time:
    """Nanoseconds nearest to `seconds`; ties to even, exact for multiples of 1 ns below 2**53 ns."""
    return round(seconds * NS_PER_S)


def to_seconds(time: Time) -> float:
    """Seconds as a float, for display and for tables that promise no exactness."""
    return time / NS_PER_S


def ceil_to(time: Time, grid: Time) -> Time:
    """The first multiple of `grid` that is not before `time`; `time` itself where `grid` is 0."""
    return time if grid <= 0 else -(-time // grid) * grid


@lru_cache(maxsize=4_096)
def parse_rfc3339(text: str) -> datetime:
    """A moment in RFC 3339. `ValueError` for other text, for one without offset or Z, and for one that no `Time` holds
    with some time before and after it.
    """
    moment = datetime.fromisoformat(text)
    if moment.utcoffset() is None:
        raise ValueError("an RFC 3339 time carries its offset or Z")
    if not 1970 <= moment.year <= 2200:
        raise ValueError("a time from 1970 to 2200 is needed")
    return moment


@dataclass(frozen=True, slots=True)
class Epoch:
    """UTC of simulated time 0 (leap seconds are ignored, as in Unix time)."""

    unix_ns: int

    @classmethod
    def from_datetime(cls, moment: datetime) -> Epoch:
        """An aware datetime is converted; a naive one is taken as UTC."""
        aware = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
        since = aware - _UNIX
        return cls((since.days * 86_400 + since.seconds) * NS_PER_S + since.microseconds * NS_PER_US)

    def utc_us(self, time: Time) -> int:
        """Microseconds since 1970-01-01T00:00:00Z: the unit of SYSTEM_TIME, tlog and pcapng."""
        return (self.unix_ns + time) // NS_PER_US

    def iso(self, time: Time) -> str:
        """ISO 8601 with milliseconds and Z, as CSV files carry it."""
        moment = _UNIX + timedelta(microseconds=self.utc_us(time))
        return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")

    def rfc3339(self, time: Time, *, up: bool = False) -> str:
        """RFC 3339 with Z, of the microsecond at or before `time`, or at or after it with `up`."""
        moment = _UNIX + timedelta(microseconds=self.utc_us(time + (NS_PER_US - 1 if up else 0)))
        return moment.isoformat(timespec="microseconds").replace("+00:00", "Z")

    def parse(self, text: str) -> Time:
        """The simulated time of a moment in RFC 3339. `ValueError` for other text, and for one without offset or Z."""
        return ((parse_rfc3339(text) - _UNIX) // timedelta(microseconds=1)) * NS_PER_US - self.unix_ns
