"""Exact confidence intervals of proportions and of rates, and the least rate that hours without an alarm support.

Clopper & Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial", Biometrika 26
(1934) 404-413; Garwood, "Fiducial limits for the Poisson distribution", Biometrika 28 (1936) 437-442; Hanley &
Lippman-Hand, "If nothing goes wrong, is everything all right?", JAMA 249 (1983) 1743-1745, for the rule of three.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.extras import missing_module

Limits = tuple[float, float]
"""Lower and upper limit; the upper one may be infinite."""


def proportion_interval(hits: float, trials: float, confidence: float) -> Limits:
    """The Clopper-Pearson interval of `hits` in `trials`, two-sided, within [0, 1]; (0, 1) without trials.

    Its limits are quantiles of beta distributions, which are defined for numbers that are not whole as well: an AUC
    times the number of blocks, or the number of trials that are worth as much as dependent ones. Raises InputError if
    SciPy is missing.
    """
    if trials == 0:
        return 0.0, 1.0
    tail, special = (1.0 - confidence) / 2.0, load_special()
    low = 0.0 if hits <= 0 else float(special.betaincinv(hits, trials - hits + 1, tail))
    high = 1.0 if hits >= trials else float(special.betaincinv(hits + 1, trials - hits, 1.0 - tail))
    return low, high


def rate_interval(count: int, hours: float, confidence: float) -> Limits:
    """Garwood's interval of a Poisson rate, two-sided, per hour; (0, ∞) without hours.

    Its limits are halves of chi-square quantiles, here as quantiles of gamma distributions. Raises InputError if SciPy
    is missing.
    """
    if hours <= 0.0:
        return 0.0, math.inf
    tail, special = (1.0 - confidence) / 2.0, load_special()
    low = 0.0 if count == 0 else float(special.gammaincinv(count, tail))
    return low / hours, float(special.gammaincinv(count + 1, 1.0 - tail)) / hours


def rate_bound(count: int, hours: float, confidence: float) -> float:
    """The one-sided upper limit of a Poisson rate, per hour: the upper end of Garwood's interval at 2 × confidence − 1.

    Infinite without hours. Raises InputError if SciPy is missing.
    """
    return rate_interval(count, hours, 2.0 * confidence - 1.0)[1]


def lowest_claimable_rate(hours: float, confidence: float) -> float:
    """The least rate, per hour, that `hours` can support even without a single alarm: −ln(1 − confidence) / hours.

    At 95 % that is 2.996 / hours, the rule of three. Infinite without hours.
    """
    return -math.log1p(-confidence) / hours if hours > 0.0 else math.inf


def load_special() -> Any:
    """The module `scipy.special`. Raises InputError if SciPy is not installed."""
    try:
        import scipy.special
    except ImportError as error:
        raise missing_module("scipy", "study", "scoring") from error
    return scipy.special
