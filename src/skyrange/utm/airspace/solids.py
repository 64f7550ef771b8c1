"""Volumes as arrays, convex outlines, and whether the outlines of two have a point in common.

Outlines are compared in the plane of longitude and latitude, in degrees, because F3548 states corners alone. A ring
that crosses itself counts as its convex hull; F3548 allows none. Convex rings, as those of legs are, are compared in
compiled code; others, and those that all but touch, by GEOS.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.geodesy import unwrap_outline
from skyrange.core.volumes import Volume4D

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


Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Outline = tuple[tuple[float, float], ...]


class Solids(NamedTuple):
    """Volumes as arrays, row by row."""

    boxes: Floats
    """(n, 4) Least longitude and latitude, and greatest; those of a free row meet nothing. Where a ring crosses the
    date line, its greatest longitude exceeds 180 (`core.geodesy.unwrap_outline`)."""
    heights: Floats
    """(n, 2) Metres."""
    times: Ints
    """(n, 2) Nanoseconds."""
    rings: Floats
    """(n, `MAX_CORNERS`, 2) Corners in longitude and latitude."""
    counts: Ints
    """(n,) How many corners a convex ring has; 0 for another one."""


def turned(solids: Solids, places: Ints, by_deg: float) -> Solids:
    """Some rows, moved in longitude by a whole turn."""
    boxes, rings = solids.boxes[places], solids.rings[places]
    boxes[:, [0, 2]] += by_deg
    rings[:, :, 0] += by_deg
    return Solids(boxes, solids.heights[places], solids.times[places], rings, solids.counts[places])


NOWHERE: Final = (math.inf, math.inf, -math.inf, -math.inf)
"""The box of a free row."""


def make_solids(count: int) -> Solids:
    """Rows that are free."""
    return Solids(
        np.full((count, 4), NOWHERE),
        np.zeros((count, 2)),
        np.zeros((count, 2), dtype=np.int64),
        np.zeros((count, MAX_CORNERS, 2)),
        np.zeros(count, dtype=np.int64),
    )


def solids_of(volumes: Sequence[Volume4D]) -> Solids:
    """Volumes, of which there is one at least, as arrays."""
    lengths = np.array([len(volume.outline) for volume in volumes], dtype=np.int64)
    corners = np.array([corner for volume in volumes for corner in volume.outline])[:, ::-1]
    if np.ptp(corners[:, 0]) > 180.0:  # one of them may cross the date line
        corners = np.array([corner for volume in volumes for corner in unwrap_outline(volume.outline)])[:, ::-1]
    rings, counts, boxes = _gather(np.ascontiguousarray(corners), lengths)
    heights = np.array([(volume.lower_m, volume.upper_m) for volume in volumes])
    times = np.array([(volume.start_ns, volume.end_ns) for volume in volumes], dtype=np.int64)
    return Solids(boxes, heights, times, rings, counts)


@compiled
def _gather(corners: Floats, lengths: Ints) -> tuple[Floats, Ints, Floats]:
    rings = np.zeros((len(lengths), MAX_CORNERS, 2))
    counts = np.zeros(len(lengths), dtype=np.int64)
    boxes = np.empty((len(lengths), 4))
    first = 0
    for place in range(len(lengths)):
        ring = corners[first : first + lengths[place]]
        for axis in range(2):
            boxes[place, axis] = ring[:, axis].min()
            boxes[place, 2 + axis] = ring[:, axis].max()
        if lengths[place] <= MAX_CORNERS:
            rings[place, : lengths[place]] = ring
            if is_convex(ring, lengths[place]):
                counts[place] = lengths[place]
        first += lengths[place]
    return rings, counts, boxes


def find_meeting(ones: Sequence[Outline], others: Sequence[Outline], pairs: Ints) -> NDArray[np.bool_]:
    """Whether the outlines of each pair, (n, 2) places in `ones` and in `others`, have a point in common, by GEOS."""
    return np.asarray(shapely.intersects(_polygons(ones, pairs[:, 0]), _polygons(others, pairs[:, 1])))


def _polygons(outlines: Sequence[Outline], places: Ints) -> NDArray[np.object_]:
    """The polygon of each place, made once."""
    different, numbers = np.unique(places, return_inverse=True)
    made = np.array([_polygon(outlines[place]) for place in different.tolist()], dtype=np.object_)
    return made[numbers]


def _polygon(outline: Outline) -> shapely.Geometry:
    polygon = shapely.Polygon([(lng, lat) for lat, lng in outline])
    return polygon if polygon.is_valid else polygon.convex_hull


def find_invalid(volumes: Sequence[Volume4D]) -> int | None:
    """The place of the first volume whose outline crosses itself or has no area; `None` if all are valid."""
    counts = solids_of(volumes).counts
    for place in np.flatnonzero(counts == 0).tolist():
        if not shapely.Polygon(unwrap_outline(volumes[place].outline)).is_valid:
            return int(place)
    return None
