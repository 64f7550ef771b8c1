"""Means over independent samples, with an interval where a method is known to hold its level, or why there is none.

What counts as one sample is decided by the caller: a seed, or a cluster of runs that share a flight or a seed
(`clusters`). The 95 % interval is, by what the samples are:

- of what the caller says is yes or no (0 or 1): Clopper-Pearson's interval of a proportion;
- of fewer than `BOOTSTRAP_FROM` samples: Student's t;
- of more: bootstrap-t (Efron & Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 12.5);
- none where all agree, and none where most agree, unless there are `MOST_AGREE_FROM` samples and `OTHERS_FROM` of them
  are others: of 5 samples of a quantity that is 0 in four of five flights, Student's t covers the mean in a third of
  the cases.

`docs/reference/coverage.md` has the coverage that simulations show, also for skewed data, where it is less than stated.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.statistics.exact_intervals import proportion_interval
from skyrange.statistics.student import t_quantile

CONFIDENCE: Final = 0.95
BOOTSTRAP_FROM: Final = 20
"""From so many samples on the interval is that of bootstrap-t; of fewer, resampling knows too little of the tails."""
MOST_AGREE_FROM: Final = 40
"""From so many samples on there may be an interval even if more than half of them are equal."""
OTHERS_FROM: Final = 8
"""Of samples of which more than half are equal, so many have to differ from these."""
SKEWED: Final = "81 to 92 %"
"""How often the interval of fewer than `BOOTSTRAP_FROM` samples covers the mean of skewed data, exponential or
lognormal, by `docs/reference/coverage.md`. Few samples do not show whether they are of such data.
"""
RESAMPLES: Final = 2_000
_SEED: Final = 0x6D65616E
"""Of the resampling: the same samples have the same interval, in whatever order, wherever they are shown."""

Method = Literal["t", "bootstrap-t", "Clopper-Pearson", "one sample", "all agree", "most agree", "SciPy is missing"]
"""How the limits were found, or why there are none."""


class Interval(NamedTuple):
    """A mean and its confidence interval; `low` and `high` are `None` where there is none, and `method` says why."""

    n: int
    """Number of independent samples."""
    mean: float
    low: float | None
    high: float | None
    method: Method

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low is not None and self.high is not None and (self.low > 0.0 or self.high < 0.0)

    @property
    def without(self) -> str:
        """Why there is no interval, in words; "" if there is one."""
        if self.low is not None:
            return ""
        return f"all {self.n} agree" if self.method == "all agree" else str(self.method)


def estimate_mean(
    samples: Sequence[float], clusters: Sequence[Hashable] | None = None, *, yes_or_no: bool = False
) -> Interval | None:
    """The mean of some samples and its 95 % interval; `None` without samples.

    With `clusters`, (n,) names, samples of one name are averaged first, because they are not independent of each other.
    `yes_or_no` says that each sample is 0 or 1 and can be nothing else; a difference may be −1 as well.
    """
    values = np.array(samples if clusters is None else _average(samples, clusters), dtype=np.float64)
    if not values.size:
        return None
    values.sort()
    count, mean = len(values), math.fsum(values) / len(values)
    if count == 1:
        return Interval(1, mean, None, None, "one sample")
    if values[0] == values[-1]:
        return Interval(count, mean, None, None, "all agree")
    if yes_or_no and np.isin(values, (0.0, 1.0)).all():
        try:
            return Interval(count, mean, *proportion_interval(int(values.sum()), count, CONFIDENCE), "Clopper-Pearson")
        except InputError:
            return Interval(count, mean, None, None, "SciPy is missing")
    alike = int(np.unique(values, return_counts=True)[1].max())
    if 2 * alike > count and (count < MOST_AGREE_FROM or count - alike < OTHERS_FROM):
        return Interval(count, mean, None, None, "most agree")
    if count < BOOTSTRAP_FROM:
        half = t_quantile(0.5 + CONFIDENCE / 2, count - 1) * float(values.std(ddof=1)) / math.sqrt(count)
        return Interval(count, mean, mean - half, mean + half, "t")
    return Interval(count, mean, *_bootstrap_t(values, mean), "bootstrap-t")


def standardised_effect(samples: Sequence[float], clusters: Sequence[Hashable] | None = None) -> float | None:
    """The mean of paired differences over their standard deviation (Cohen's d for pairs); `None` without spread."""
    values = samples if clusters is None else _average(samples, clusters)
    if len(values) < 2:
        return None
    deviation = float(np.std(values, ddof=1))
    return float(np.mean(values)) / deviation if deviation > 0.0 else None


def _average(samples: Sequence[float], clusters: Sequence[Hashable]) -> list[float]:
    own: dict[Hashable, list[float]] = {}
    for value, cluster in zip(samples, clusters, strict=True):
        own.setdefault(cluster, []).append(value)
    # the mean of equal values is that value, to the last bit
    return [values[0] if min(values) == max(values) else math.fsum(values) / len(values) for values in own.values()]


def _bootstrap_t(values: NDArray[np.float64], mean: float) -> tuple[float, float]:
    """The limits mean − t s/√n with quantiles of t over resamples of (n,) sorted `values`; those without spread are
    left out.
    """
    count = len(values)
    error = float(values.std(ddof=1)) / math.sqrt(count)
    chance = np.random.Generator(np.random.Philox(_SEED + count))
    drawn = values[chance.integers(0, count, (RESAMPLES, count))]
    errors = drawn.std(axis=1, ddof=1) / math.sqrt(count)
    spread = errors > 0.0
    ratios = (drawn.mean(axis=1)[spread] - mean) / errors[spread]
    low, high = np.quantile(ratios, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2]).tolist()
    return mean - high * error, mean - low * error
