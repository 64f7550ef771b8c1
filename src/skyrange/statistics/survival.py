"""Detection delays with misses as censored observations: the Kaplan-Meier curve, its median and its restricted mean.

Kaplan & Meier, "Nonparametric estimation from incomplete observations", Journal of the American Statistical Association
53 (1958) 457-481; Royston & Parmar, "Restricted mean survival time", BMC Medical Research Methodology 13:152 (2013).
An attack that was not detected until the end of its window has a delay that is longer than the window. A mean over the
detected ones would call a detector quick that detects one attack in ten.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class SurvivalCurve:
    """The share of attacks that is not yet detected, as a step function; several replicates of it at once."""

    times_s: NDArray[np.float64]
    """Distinct delays of detections, ascending, shape (m,)."""
    shares: NDArray[np.float64]
    """Share not yet detected from each of these times on, shape (replicates, m)."""

    def medians_s(self) -> NDArray[np.float64]:
        """The first time at which half or fewer are undetected, shape (replicates,); infinite if never."""
        before = (self.shares > 0.5 + 1e-12).sum(axis=1)  # products of fractions: 1/2 may come out a little above
        return np.asarray(np.append(self.times_s, math.inf)[before], dtype=np.float64)

    def restricted_means_s(self, horizon_s: float) -> NDArray[np.float64]:
        """The mean of min(delay, horizon), shape (replicates,): the area below the curve up to the horizon."""
        edges = np.minimum(np.concatenate(([0.0], self.times_s, [math.inf])), horizon_s)
        steps = np.concatenate((np.ones((self.shares.shape[0], 1)), self.shares), axis=1)
        return np.asarray((steps * np.diff(edges)).sum(axis=1), dtype=np.float64)


def survival_curve(
    delays_s: NDArray[np.float64], detected: NDArray[np.bool_], weights: NDArray[np.float64] | None = None
) -> SurvivalCurve:
    """The Kaplan-Meier estimate; `delays_s`, shape (n,), is the time to detection, or to the window's end for a miss.

    `weights`, shape (replicates, n), says how often each attack counts; by default once, in a single replicate. At
    equal times detections come before misses.
    """
    weights = np.ones((1, delays_s.shape[0])) if weights is None else weights
    order = np.argsort(delays_s, kind="stable")
    delays, hits, weights = delays_s[order], detected[order], weights[:, order]
    times: NDArray[np.float64] = np.unique(delays[hits]).astype(np.float64)
    if times.shape[0] == 0:
        return SurvivalCurve(times, np.ones((weights.shape[0], 0)))
    padded = np.concatenate((np.zeros((weights.shape[0], 1)), np.cumsum(weights, axis=1)), axis=1)
    at_risk = padded[:, -1:] - padded[:, np.searchsorted(delays, times, side="left")]
    cumulated = np.concatenate((np.zeros((weights.shape[0], 1)), np.cumsum(weights * hits, axis=1)), axis=1)
    events = (
        cumulated[:, np.searchsorted(delays, times, side="right")]
        - cumulated[:, np.searchsorted(delays, times, side="left")]
    )
    stays = np.where(at_risk > 0.0, 1.0 - events / np.where(at_risk > 0.0, at_risk, 1.0), 1.0)
    return SurvivalCurve(times, np.cumprod(stays, axis=1).astype(np.float64))
