"""Clusters of runs that are not independent, resampling of them, and limits of their proportions and rates.

Runs of one seed share all chance, whatever differs in their scenarios; runs with the same frames and the same truth are
one flight. Splits, resampling and hours of flight count clusters, not runs.

Resampling: block bootstrap with percentile limits (Efron & Tibshirani, "An introduction to the bootstrap", 1993,
chapters 8, 13). Which clusters a replicate draws is addressed chance: the n-th of the sorted names in replicate r,
whatever is computed of it. So all detectors are resampled alike, results repeat to the bit, and the order of rows does
not matter.

Proportions: Korn & Graubard, "Confidence intervals for proportions with small expected number of positive counts
estimated from survey data", Survey Methodology 24 (1998) 193-201: Clopper-Pearson's interval with the number of
independent trials that has the same variance, less what the few clusters cost. Where all trials agree each cluster
counts as one trial.

Rates: Garwood's interval takes one rate for all flights. Where that of a cluster is itself drawn, from a gamma
distribution with a coefficient of variation c, the number of events is negative binomial (Greenwood & Yule, "An inquiry
into the nature of frequency distributions representative of multiple happenings", Journal of the Royal Statistical
Society 83 (1920) 255-279), and the limits are quantiles of it. With c = 0 they are Garwood's.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.statistics.exact_intervals import Limits, load_special, proportion_interval, rate_interval

Name = TypeVar("Name", bound=Hashable)


def find_clusters(shared: Mapping[Name, Iterable[Hashable]]) -> dict[Name, Name]:
    """The cluster of each member, by name of its first member in the order of `shared`.

    `shared` has, for each member, what it shares with others, such as its seed and its flights.
    Members are in one cluster if a chain of shared things leads from one to the other.
    """
    first: dict[Hashable, Name] = {}
    parent: dict[Name, Name] = {name: name for name in shared}
    place = {name: number for number, name in enumerate(shared)}

    def root(name: Name) -> Name:
        while parent[name] != name:
            parent[name] = parent[parent[name]]
            name = parent[name]
        return name

    for name, things in shared.items():
        for thing in things:
            other = root(first.setdefault(thing, name))
            own_root = root(name)
            earlier, later = sorted((own_root, other), key=place.__getitem__)
            parent[later] = earlier
    return {name: root(name) for name in shared}


def keep_first(keys: Sequence[Hashable]) -> list[bool]:
    """(n,) whether each key is there for the first time."""
    seen: set[Hashable] = set()
    kept = []
    for key in keys:
        kept.append(key not in seen)
        seen.add(key)
    return kept


_STREAM = "study.scoring.blocks"


@lru_cache(maxsize=16)
def draw_weights(blocks: int, replicates: int, seed: int) -> NDArray[np.float64]:
    """How often each replicate draws each block, shape (replicates, blocks): `blocks` draws each, with replacement."""
    draws = blocks * replicates
    calls = -(-draws // 4)
    who = np.full(calls, hash64(f"{blocks} blocks"), dtype=np.uint64)
    uniforms = (
        Chance(seed)
        .uniforms(_STREAM, who, np.zeros(calls, dtype=np.int64), np.arange(calls, dtype=np.uint64))
        .ravel()[:draws]
    )
    drawn = (uniforms * blocks).astype(np.int64).reshape(replicates, blocks)
    cells = drawn + blocks * np.arange(replicates)[:, np.newaxis]
    weights = np.bincount(cells.ravel(), minlength=draws).reshape(replicates, blocks).astype(np.float64)
    weights.flags.writeable = False
    return weights


def percentile_limits(samples: NDArray[np.float64], point: float, confidence: float) -> Limits:
    """The central `confidence` of `samples` (shape (n,), maybe infinite), widened to include `point`.

    The quantiles are samples, not interpolated between two: one of them may be infinite.
    """
    ordered = np.sort(samples)
    tail = (1.0 - confidence) / 2.0
    last = ordered.shape[0] - 1
    low, high = ordered[math.floor(tail * last)], ordered[math.ceil((1.0 - tail) * last)]
    return min(float(low), point), max(float(high), point)


def dense_codes(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ranks of the distinct values, from 0, shape (n,)."""
    return np.unique(values, return_inverse=True)[1].astype(np.int64).reshape(-1)


def clustered_proportion_interval(
    hits: Sequence[bool], clusters: Sequence[Hashable], confidence: float
) -> Limits | None:
    """The limits of the share of `hits`, (n,), whose clusters are named in `clusters`, (n,); `None` with one cluster.

    Raises `InputError` if SciPy is missing.
    """
    codes = {name: number for number, name in enumerate(dict.fromkeys(clusters))}
    count = len(codes)
    if count < 2:
        return None
    places = [codes[name] for name in clusters]
    top = np.bincount(places, np.array(hits, dtype=np.float64))
    trials = np.bincount(places).astype(np.float64)
    share, total = float(top.sum() / trials.sum()), float(trials.sum())
    independent = float(count)
    if 0.0 < share < 1.0:
        residuals = top - share * trials
        variance = count / (count - 1.0) * float((residuals**2).sum()) / total**2
        independent = min(total, share * (1.0 - share) / variance) if variance > 0.0 else total
        every, few = load_special().stdtrit([total - 1.0, count - 1.0], 0.5 + confidence / 2.0).tolist()
        independent *= (every / few) ** 2
    low, high = proportion_interval(share * independent, independent, confidence)
    return min(low, share), max(high, share)


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
