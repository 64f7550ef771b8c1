"""Confidence interval of a mean over seeds, by Student's t distribution at 95 %.

Each seed is one independent sample. The averaged quantity is the difference of two runs of the same seed, so this is a
paired comparison. With n samples, mean m and standard deviation s (n − 1 in the denominator), the interval is
m ± t s/√n, where t is the 0.975 quantile with n − 1 degrees of freedom. The mean is assumed to be about normal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

CONFIDENCE = 0.95


class Interval(NamedTuple):
    """A mean and its confidence interval; `low` and `high` are `None` with fewer than two samples."""

    n: int
    mean: float
    low: float | None
    high: float | None

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low is not None and self.high is not None and (self.low > 0.0 or self.high < 0.0)


def interval(samples: Sequence[float]) -> Interval | None:
    """The mean of `samples` and its 95 % interval; `None` without samples."""
    n = len(samples)
    if n == 0:
        return None
    mean = math.fsum(samples) / n
    if n == 1:
        return Interval(1, mean, None, None)
    deviation = math.sqrt(math.fsum((x - mean) ** 2 for x in samples) / (n - 1))
    half = t_quantile(0.5 + CONFIDENCE / 2, n - 1) * deviation / math.sqrt(n)
    return Interval(n, mean, mean - half, mean + half)


@cache
def t_quantile(p: float, freedom: int) -> float:
    """The t with P(T ≤ t) = p, for 0.5 < p < 1 and whole degrees of freedom ≥ 1; by bisection, to 1e-12 relative."""
    low, high = 0.0, 1.0
    while _t_within(high, freedom) < 2 * p - 1:
        low, high = high, 2 * high
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        if _t_within(middle, freedom) < 2 * p - 1:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _t_within(t: float, freedom: int) -> float:
    """P(|T| ≤ t): Abramowitz & Stegun, "Handbook of Mathematical Functions", 26.7.3 (odd) and 26.7.4 (even)."""
    angle = math.atan(t / math.sqrt(freedom))
    cos_squared = math.cos(angle) ** 2
    even = freedom % 2 == 0
    term = 1.0 if even else math.cos(angle)
    total = 0.0
    for step in range(2 if even else 3, freedom + 1, 2):
        total += term
        term *= (step - 1) / step * cos_squared
    if even:
        return math.sin(angle) * total
    return 2.0 / math.pi * (angle + math.sin(angle) * total)
