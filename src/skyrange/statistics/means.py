"""Means over independent samples with intervals, tests of shares in paired flights, and Student's t distribution.

What counts as one sample is decided by the caller: a seed, or a cluster of runs that share a flight or a seed
(`clusters`). The 95 % interval is, by what the samples are:

- of what the caller says is yes or no (0 or 1): Clopper-Pearson's interval of a proportion;
- of fewer than `BOOTSTRAP_FROM` samples: Student's t;
- of more: bootstrap-t (Efron & Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 12.5);
- none where all agree, and none where most agree, unless there are `MOST_AGREE_FROM` samples and `OTHERS_FROM` of them
  are others: of 5 samples of a quantity that is 0 in four of five flights, Student's t covers the mean in a third of
  the cases.

`docs/reference/coverage.md` has the coverage that simulations show, also for skewed data, where it is less than stated.

A claim such as "the defence stops the attack" rests on two tests of the same flights, both of which have to hold: the
exact sign test, that in more than half of all flights the one is below the share of the other, and Student's t test,
that its mean is. The first holds its level for any distribution; the second guards against rare large values.

The base installation has no SciPy, so quantiles and tail of Student's t are computed here; tests compare them with
SciPy's.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from functools import cache
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.statistics.exact_intervals import proportion_interval


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
    values_by_cluster: dict[Hashable, list[float]] = {}
    for value, cluster in zip(samples, clusters, strict=True):
        values_by_cluster.setdefault(cluster, []).append(value)
    # the mean of equal values is that value, to the last bit
    return [
        values[0] if min(values) == max(values) else math.fsum(values) / len(values)
        for values in values_by_cluster.values()
    ]


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


LEVEL: Final = 0.05
"""The probability of any false claim among all comparisons, at most."""


def sign_test(hits: int, trials: int) -> float:
    """P(at least `hits` of `trials`) if each is as likely as not: the one-sided p of "in more than half of all"."""
    return float(sum(math.comb(trials, k) for k in range(hits, trials + 1)) / 2**trials)


def share_test(mine: Sequence[float], other: Sequence[float], share: float) -> float:
    """The one-sided p that `mine` is below `share` times `other`, pair by pair: the larger of the two tests' p.

    1.0 without pairs. Pairs in which they are equal count against the claim.
    """
    differences = np.array(mine, dtype=np.float64) - share * np.array(other, dtype=np.float64)
    if not differences.size:
        return 1.0
    return max(sign_test(int((differences < 0.0).sum()), differences.size), _t_test(differences.tolist()))


def _t_test(differences: Sequence[float]) -> float:
    """The one-sided p that the mean is below zero; with one sample, or without spread, the sign decides alone."""
    count, mean = len(differences), math.fsum(differences) / len(differences)
    deviation = float(np.std(differences, ddof=1)) if count > 1 else 0.0
    if deviation == 0.0:
        return 0.0 if mean < 0.0 else 1.0
    return t_tail(-mean / (deviation / math.sqrt(count)), count - 1)


def adjust_by_holm(p_values: Sequence[float]) -> list[float]:
    """(n,) p-values adjusted for the number of tests, so that those at most α are false together with at most α.

    Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6 (1979) 65-70.
    """
    adjusted, highest = [0.0] * len(p_values), 0.0
    for rank, place in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[place]))
        adjusted[place] = highest
    return adjusted


def pairs_needed(tests: int, level: float = LEVEL) -> int:
    """The fewest pairs with which any of so many tests can hold: 2⁻ⁿ has to be at most level / tests."""
    return max(1, math.ceil(math.log2(max(tests, 1) / level)))
