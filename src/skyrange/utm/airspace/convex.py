"""Convex outlines: whether a ring of corners is one, and whether two have a point in common."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled

Floats = NDArray[np.float64]

MAX_CORNERS: Final = 16
"""Corners of a ring that is compared here; those of legs have 8 or 10."""
APART: Final = 0
MEETING: Final = 1
UNDECIDED: Final = 2
"""The two are so near to touching that rounding decides; an exact predicate has to."""
_NEAR: Final = 1e-12
"""Gap in degrees, a tenth of a micrometre, below which it is undecided; rounding errors are below 1e-13."""


@compiled
def is_convex(ring: Floats, count: int) -> bool:
    """Whether the first `count` rows of `ring`, its corners, are those of a convex polygon with an area.

    That is, whether each corner lies on one side of each edge, the same for all.
    """
    area = 0.0
    for k in range(count):
        following = (k + 1) % count
        area += ring[k, 0] * ring[following, 1] - ring[following, 0] * ring[k, 1]
    side = 1.0 if area > 0.0 else -1.0
    total = 0.0
    for k in range(count):
        following = (k + 1) % count
        east, north = ring[following, 0] - ring[k, 0], ring[following, 1] - ring[k, 1]
        for other in range(count):
            if other not in (k, following):
                beside = east * (ring[other, 1] - ring[k, 1]) - north * (ring[other, 0] - ring[k, 0])
                if beside * side <= 0.0:
                    return False
                total += beside * side
    return total > 0.0


@compiled
def compare(one: Floats, ones: int, other: Floats, others: int) -> int:
    """`MEETING`, `APART` or `UNDECIDED` for two convex rings, by the separating axis theorem.

    Two convex polygons are apart if and only if the normal of an edge of one of them separates them (for instance
    Gottschalk et al. 1996, OBBTree, section 5, for boxes).
    """
    gap = max(_widest_gap(one, ones, other, others), _widest_gap(other, others, one, ones))
    if gap > _NEAR:
        return APART
    return MEETING if gap < -_NEAR else UNDECIDED


@compiled
def _widest_gap(one: Floats, ones: int, other: Floats, others: int) -> float:
    """The greatest distance by which an edge of `one` has all of `other` on its outer side; negative if none has."""
    area = 0.0
    for k in range(ones):
        following = (k + 1) % ones
        area += (one[k, 0] - one[0, 0]) * (one[following, 1] - one[0, 1])
        area -= (one[following, 0] - one[0, 0]) * (one[k, 1] - one[0, 1])
    side = 1.0 if area > 0.0 else -1.0
    widest = -math.inf
    for k in range(ones):
        following = (k + 1) % ones
        east, north = one[following, 0] - one[k, 0], one[following, 1] - one[k, 1]
        length = math.sqrt(east * east + north * north)
        nearest = math.inf
        for corner in range(others):
            beside = north * (other[corner, 0] - one[k, 0]) - east * (other[corner, 1] - one[k, 1])
            nearest = min(nearest, side * beside / length)
        widest = max(widest, nearest)
        if widest > _NEAR:
            return widest
    return widest
