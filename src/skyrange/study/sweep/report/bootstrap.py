"""Bootstrap intervals of means over blocks.

A block is one independent sample: its arms share all chance, so that differences between arms are paired. The interval
is that of percentiles (Efron & Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 13). Resampling is seeded
by what it is for, so that the same samples give the same interval.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from skyrange.core.ids import hash64
from skyrange.study.twins.confidence import CONFIDENCE, Interval

RESAMPLES: Final = 2_000


def bootstrap_mean(samples: Sequence[float], address: str) -> Interval | None:
    """The mean of some samples and its 95 % interval, `None` without samples; `address` says what it is a mean of."""
    count = len(samples)
    if count == 0:
        return None
    values = np.array(samples, dtype=np.float64)
    mean = math.fsum(samples) / count
    if count == 1:
        return Interval(1, mean, None, None)
    chance = np.random.Generator(np.random.Philox(hash64(address)))
    means = values[chance.integers(0, count, (RESAMPLES, count))].mean(axis=1)
    low, high = np.quantile(means, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2]).tolist()
    return Interval(count, mean, low, high)


def standardised_effect(samples: Sequence[float]) -> float | None:
    """The mean of paired differences over their standard deviation (Cohen's d for pairs); `None` without spread."""
    if len(samples) < 2:
        return None
    deviation = float(np.std(samples, ddof=1))
    return float(np.mean(samples)) / deviation if deviation > 0.0 else None
