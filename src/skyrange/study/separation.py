"""How near did aircraft come to each other, and to walls? Closest approaches over the recorded truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.core.compiled import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

NEAR_M = 10.0
"""Two aircraft nearer than this, centre to centre, have a near miss: a modelling choice, some 13 widths of an Iris. The
500 ft by 100 ft of a near mid-air collision in crewed aviation would call every flight in a street one."""
WALLS_M = 30.0
"""Walls farther than this are not looked for."""
_MOST_SAMPLES = 300_000  # places that are held against walls: a minute's work at most


class Approaches(NamedTuple):
    """One row per aircraft, over all ticks at which it was in the air."""

    least_m: Floats
    """(n,) centre to centre in space; infinite where it was never in the air with another."""
    nearest: Ints
    """(n,) to whom; −1 likewise."""
    tick: Ints
    """(n,) when; −1 likewise."""
    near_misses: Ints
    """(n,) how often another came nearer than the limit, until they were farther again."""


@kernel
def _closest(
    enu_m: Floats, aloft: Flags, near_m: float, least_m: Floats, nearest: Ints, tick: Ints, near_misses: Ints
) -> None:
    ticks, count = aloft.shape
    within = np.zeros((count, count), dtype=np.bool_)
    for t in range(ticks):
        for i in range(count):
            if not aloft[t, i]:
                continue
            for j in range(i + 1, count):
                if not aloft[t, j]:
                    continue
                de = enu_m[t, i, 0] - enu_m[t, j, 0]
                dn = enu_m[t, i, 1] - enu_m[t, j, 1]
                du = enu_m[t, i, 2] - enu_m[t, j, 2]
                away = np.sqrt(de * de + dn * dn + du * du)
                if away < least_m[i]:
                    least_m[i], nearest[i], tick[i] = away, j, t
                if away < least_m[j]:
                    least_m[j], nearest[j], tick[j] = away, i, t
                near = away < near_m
                if near and not within[i, j]:
                    near_misses[i] += 1
                    near_misses[j] += 1
                within[i, j] = near


def approaches(enu_m: Floats, aloft: Flags, near_m: float = NEAR_M) -> Approaches:
    """Closest approaches of n aircraft over t ticks: `enu_m` (t, n, 3), `aloft` (t, n)."""
    count = aloft.shape[1]
    found = Approaches(
        np.full(count, np.inf), np.full(count, -1, np.int64), np.full(count, -1, np.int64), np.zeros(count, np.int64)
    )
    _closest(np.ascontiguousarray(enu_m), np.ascontiguousarray(aloft), near_m, *found)
    return found


def least_to_walls_m(enu_m: Floats, aloft: Flags, city: Sequence[Mapping[str, Any]]) -> Floats:
    """(n,) least distance of each aircraft's centre to a building, in metres; infinite above `WALLS_M`.

    A building is the prism over its outline from its base to its roof. Of long runs with many aircraft every k-th tick
    is looked at.
    """
    count = aloft.shape[1]
    least_m = np.full(count, np.inf)
    rows = [(shapely.Polygon(row["rings"][0], row["rings"][1:]), row) for row in city if row.get("rings")]
    if not rows:
        return least_m
    tree = shapely.STRtree([shape for shape, _ in rows])
    roofs_m = np.array([float(row.get("height_m") or 0.0) for _, row in rows])
    bases_m = np.array([float(row.get("base_m") or 0.0) for _, row in rows])
    stride = max(1, aloft.size // _MOST_SAMPLES)
    for vehicle in range(count):
        places = enu_m[::stride, vehicle][aloft[::stride, vehicle]]
        if not len(places):
            continue
        points = shapely.points(places[:, :2])
        who, where = tree.query(points, predicate="dwithin", distance=WALLS_M)
        if not len(who):
            continue
        beside_m = shapely.distance(points[who], tree.geometries[where])
        up_m = places[who, 2]
        above_m = np.maximum(np.maximum(up_m - roofs_m[where], bases_m[where] - up_m), 0.0)
        nearest_m = float(np.hypot(beside_m, above_m).min())
        least_m[vehicle] = nearest_m if nearest_m <= WALLS_M else np.inf
    return least_m
