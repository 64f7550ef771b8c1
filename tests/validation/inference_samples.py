"""Samples with a known truth for tests of inference: distributions with their means, and shares of replicates."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Distribution(NamedTuple):
    """A distribution of one sample; `draw` takes a generator and a number of samples."""

    mean: float
    draw: Callable[[np.random.Generator, int], Floats]


DISTRIBUTIONS: Final[Mapping[str, Distribution]] = {
    "normal": Distribution(1.0, lambda chance, n: chance.normal(1.0, 1.0, n)),
    "exponential": Distribution(1.0, lambda chance, n: chance.exponential(1.0, n)),
    "lognormal": Distribution(math.exp(0.5), lambda chance, n: chance.lognormal(0.0, 1.0, n)),
    "half zeros": Distribution(0.5, lambda chance, n: chance.exponential(1.0, n) * (chance.random(n) < 0.5)),
    "80 % zeros": Distribution(0.2, lambda chance, n: chance.exponential(1.0, n) * (chance.random(n) < 0.2)),
    "90 % zeros": Distribution(0.1, lambda chance, n: chance.exponential(1.0, n) * (chance.random(n) < 0.1)),
    "95 % zeros": Distribution(0.05, lambda chance, n: chance.exponential(1.0, n) * (chance.random(n) < 0.05)),
    "yes or no": Distribution(0.3, lambda chance, n: (chance.random(n) < 0.3).astype(np.float64)),
}
"""Those with zeros are exponential in the other flights."""


RATES: Final[Mapping[str, Callable[[np.random.Generator, int], Floats]]] = {
    "equal": lambda chance, n: np.ones(n),
    "gamma, twice its mean": lambda chance, n: chance.gamma(0.25, 4.0, n),
    "lognormal, twice its mean": lambda chance, n: chance.lognormal(-0.5 * math.log(5.0), math.sqrt(math.log(5.0)), n),
}
"""Rates of clusters with the mean 1, and a coefficient of variation of 0 or 2."""


def margin(level: float, replicates: int) -> float:
    """How far the share of replicates may be off `level` by chance: 3.3 standard errors, once in a thousand tests."""
    return 3.3 * math.sqrt(level * (1.0 - level) / replicates)
