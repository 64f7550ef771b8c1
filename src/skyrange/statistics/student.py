"""Student's t distribution: its quantiles and its tail.

The base installation has no SciPy, so both are computed here; tests compare them with SciPy's.
"""

from __future__ import annotations

import math
from functools import cache


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


def t_tail(t: float, freedom: int) -> float:
    """P(T ≥ t), for whole degrees of freedom ≥ 1, to about 1e-15 absolute."""
    within = _t_within(abs(t), freedom)
    return 0.5 * (1.0 - within) if t >= 0.0 else 0.5 * (1.0 + within)


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
