"""Limits of a rate that differs between clusters: events of one come more often than those of another.

Garwood's interval takes one rate for all flights. Where that of a cluster is itself drawn, from a gamma distribution
with a coefficient of variation c, the number of events is negative binomial (Greenwood & Yule, "An inquiry into the
nature of frequency distributions representative of multiple happenings", Journal of the Royal Statistical Society 83
(1920) 255-279), and the limits are quantiles of it. With c = 0 they are Garwood's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from skyrange.statistics.exact_intervals import Limits, load_special, rate_interval


def clustered_rate_interval(
    counts: Sequence[float], hours: Sequence[float], variation: float, confidence: float
) -> Limits:
    """The two-sided limits of a rate per hour, from the events and hours of each cluster; (0, ∞) without hours.

    `variation` is the coefficient of variation of rates between clusters that is taken for granted; where counts show
    more (`estimate_variation`), that is taken. Clusters of different lengths count as (Σ h)² / Σ h² equal ones. Raises
    `InputError` if SciPy is missing.
    """
    total, spans = float(sum(counts)), np.array(hours, dtype=np.float64)
    spent = float(spans.sum())
    if spent <= 0.0:
        return 0.0, math.inf
    spread = max(variation, estimate_variation(counts, hours))
    if spread <= 0.0:
        return rate_interval(round(total), spent, confidence)
    shape = spent**2 / float((spans**2).sum()) / spread**2
    tail, special = (1.0 - confidence) / 2.0, load_special()
    # P(X ≤ k) = I_p(shape, k + 1) with p = shape / (shape + mean); the mean at which it is the tail is the upper limit
    high = float(special.betaincinv(shape, total + 1.0, tail))
    low = float(special.betaincinv(shape, total, 1.0 - tail)) if total else 1.0
    upper = math.inf if high <= 0.0 else shape * (1.0 - high) / high / spent
    return shape * (1.0 - low) / low / spent, upper


def clustered_rate_bound(counts: Sequence[float], hours: Sequence[float], variation: float, confidence: float) -> float:
    """The one-sided upper limit: the upper end of the interval at 2 × confidence − 1."""
    return clustered_rate_interval(counts, hours, variation, 2.0 * confidence - 1.0)[1]


def estimate_variation(counts: Sequence[float], hours: Sequence[float]) -> float:
    """The coefficient of variation of rates between clusters by the method of moments; 0 where counts vary no more than
    those of one rate do.
    """
    events, spans = np.array(counts, dtype=np.float64), np.array(hours, dtype=np.float64)
    if not events.sum() or not spans.sum():
        return 0.0
    expected = spans * events.sum() / spans.sum()
    excess = float(((events - expected) ** 2 - expected).sum())
    return math.sqrt(max(excess, 0.0) / float((expected**2).sum()))
