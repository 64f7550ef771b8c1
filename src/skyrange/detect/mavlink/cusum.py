"""CUSUM charts: their average run length, and the decision interval for a wanted one.

A one-sided CUSUM of standard normal values z (E. S. Page, "Continuous Inspection Schemes", Biometrika 41, 1954) is
S ← max(0, S + z − k), with an alarm at S ≥ h. Its average run length follows from a Markov chain over a division of
0…h (D. Brook and D. A. Evans, "An approach to the probability distribution of cusum run length", Biometrika 59, 1972).
"""

from __future__ import annotations

from functools import cache
from math import erf, log, sqrt

import numpy as np

STATES = 100
_SCALE = sqrt(2.0)


def run_length(reference: float, interval: float) -> float:
    """The average number of standard normal values to an alarm; `reference` is k and `interval` is h."""
    width = 2.0 * interval / (2 * STATES - 1)
    steps = (np.arange(-STATES, STATES) + 0.5) * width + reference
    below = np.array([0.5 * (1.0 + erf(step / _SCALE)) for step in steps.tolist()])
    probability = np.diff(below)  # of a step of j − STATES + 1 states
    places = np.arange(STATES)
    moves = places[None, :] - places[:, None]
    chain = probability[moves + STATES - 1]
    chain[:, 0] = below[STATES - places]
    return float(np.linalg.solve(np.eye(STATES) - chain, np.ones(STATES))[0])


@cache
def find_interval(reference: float, length: float) -> float:
    """The decision interval h whose average run length is `length` values (10 … 1e9), to 0.1 %."""
    low, high = 0.05, 0.1 + 2.0 * log(length) / reference
    while high - low > 1e-3 * low:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run_length(reference, middle) < length else (low, middle)
    return 0.5 * (low + high)
