"""Recording rates of truth, sensors and features in Hz, and their periods."""

from __future__ import annotations

from math import gcd

from skyrange.core.errors import InputError, Problem
from skyrange.core.time import NEVER, Time, from_seconds, to_seconds


def check_rates(truth_hz: float, sensors_hz: float, features_hz: float) -> None:
    """Raise `InputError` for a rate outside 0 to 1000 Hz; features cannot be left out by a rate of 0."""
    rates = {"record.truth_hz": truth_hz, "record.sensors_hz": sensors_hz}
    expected = "a rate in Hz from 0 (not recorded) to 1000"
    problems = [Problem(where, repr(rate), expected) for where, rate in rates.items() if not 0 <= rate <= 1000]
    if not 0 < features_hz <= 1000:
        problems.append(Problem("record.features_hz", repr(features_hz), "a rate in Hz above 0, up to 1000"))
    if problems:
        raise InputError("recorder", problems)


def common_period_ns(truth_ns: Time, sensors_ns: Time) -> Time:
    """The longest period whose multiples include those of both; a period of `NEVER` (not recorded) is ignored."""
    wanted = [period for period in (truth_ns, sensors_ns) if period != NEVER]
    return gcd(*wanted) if wanted else NEVER


def period_ns(rate_hz: float) -> Time:
    """The period of a rate in Hz; `NEVER` for 0."""
    return min(from_seconds(min(1.0 / rate_hz, to_seconds(NEVER))), NEVER) if rate_hz else NEVER
