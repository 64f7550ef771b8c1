"""Resampling of clusters as a whole, because runs of a cluster are not independent of each other.

Block bootstrap with percentile limits (Efron & Tibshirani, "An introduction to the bootstrap", 1993, chapters 8, 13).
Which clusters a replicate draws is addressed chance: the n-th of the sorted names in replicate r, whatever is computed
of it. So all detectors are resampled alike, results repeat to the bit, and the order of rows does not matter.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.statistics.exact_intervals import Limits

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
