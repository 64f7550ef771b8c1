"""Tests of whether something is below a share of something else in paired flights, over many comparisons.

A claim such as "the defence stops the attack" rests on two tests of the same flights, both of which have to hold: the
exact sign test, that in more than half of all flights the one is below the share of the other, and Student's t test,
that its mean is. The first holds its level for any distribution; the second guards against rare large values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from skyrange.statistics.student import t_tail

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
