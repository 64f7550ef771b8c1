"""Separation: closest approaches between aircraft, and to buildings, over the recorded truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.core.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

NEAR_M = 10.0
"""Two aircraft nearer than this, centre to centre, have a near miss. This is a modelling choice, about 13 widths of an
Iris. By the 500 ft by 100 ft of a near mid-air collision in crewed aviation, every flight in a street would be one."""
WALLS_M = 30.0
"""Distances to buildings are determined only up to this."""
_MAX_SAMPLES = 300_000  # positions whose distance to buildings is computed: at most a minute of work


class Approaches(NamedTuple):
    """Closest approaches, one row per aircraft, over all ticks at which it was in the air."""

    least_m: Floats
    """(n,) least distance, centre to centre in space; infinite if it was never in the air together with another."""
    nearest: Ints
    """(n,) index of the nearest aircraft; −1 in the same case."""
    tick: Ints
    """(n,) index of the tick; −1 in the same case."""
    near_misses: Ints
    """(n,) number of times that another aircraft came within the limit; one ends when they are farther apart again."""


@compiled
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


def closest_approaches(enu_m: Floats, aloft: Flags, near_m: float = NEAR_M) -> Approaches:
    """Closest approaches of n aircraft over t ticks: `enu_m` (t, n, 3), `aloft` (t, n)."""
    count = aloft.shape[1]
    found = Approaches(
        np.full(count, np.inf), np.full(count, -1, np.int64), np.full(count, -1, np.int64), np.zeros(count, np.int64)
    )
    _closest(np.ascontiguousarray(enu_m), np.ascontiguousarray(aloft), near_m, *found)
    return found


def min_building_distance_m(enu_m: Floats, aloft: Flags, city: Sequence[Mapping[str, Any]]) -> Floats:
    """(n,) least distance of each aircraft's centre to a building in metres; infinite beyond `WALLS_M`.

    A building is a prism over its outline from its base to its roof. In long runs with many aircraft only every k-th
    tick is examined.
    """
    count = aloft.shape[1]
    least_m = np.full(count, np.inf)
    rows = [(shapely.Polygon(row["rings"][0], row["rings"][1:]), row) for row in city if row.get("rings")]
    if not rows:
        return least_m
    tree = shapely.STRtree([shape for shape, _ in rows])
    roofs_m = np.array([float(row.get("height_m") or 0.0) for _, row in rows])
    bases_m = np.array([float(row.get("base_m") or 0.0) for _, row in rows])
    stride = max(1, aloft.size // _MAX_SAMPLES)
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
