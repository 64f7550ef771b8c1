"""Gates of statistical tests: the values that noise alone exceeds with a given chance."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from statistics import NormalDist

from skyrange.core.elementary import exp, log

_OVERSHOOT = 1.166
"""2 · 0.583: by how much a random walk of unit steps exceeds its two barriers (Siegmund, Sequential Analysis, 1985)."""


def normal_gate(chance: float) -> float:
    """How many standard deviations a normal deviate exceeds, on either side, with this chance."""
    return -NormalDist().inv_cdf(chance / 2.0)


def chi_square_gate(degrees: int, chance: float) -> float:
    """What a chi-square variable of an even number of degrees of freedom exceeds with this chance.

    With 2m degrees it exceeds x where a Poisson variable of mean x/2 is below m.
    """
    if degrees % 2 or degrees < 2:
        raise ValueError(f"degrees is {degrees}; an even number from 2 was expected")

    def excess(x: float) -> float:
        term, total = -x / 2.0, -inf
        for count in range(degrees // 2):
            total = max(total, term) + log(1.0 + exp(-abs(total - term)))
            term += log(x / 2.0) - log(count + 1.0)
        return log(chance) - total

    return _root(excess, 1e-9, 4.0 * degrees - 8.0 * log(chance))


def cusum_gate(allowance: float, samples: float) -> float:
    """Threshold of a one-sided CUSUM of normal deviates with one false alarm in so many samples on average.

    Siegmund's approximation of the average run length, (exp(2kb) − 2kb − 1) / 2k², with b = h + 1.166 and k the
    `allowance`, half the shift of the mean that is to be found, in standard deviations.
    """

    def excess(threshold: float) -> float:
        span = 2.0 * allowance * (threshold + _OVERSHOOT)
        return (exp(span) - span - 1.0) / (2.0 * (allowance * allowance)) - samples

    return _root(excess, 0.0, log(2.0 * (allowance * allowance) * samples + 10.0) / allowance)


def _root(rising: Callable[[float], float], low: float, high: float) -> float:
    """Where a rising function is 0, by bisection to the last bit."""
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if rising(middle) < 0.0 else (low, middle)
    return high
