"""How far was an aircraft beside its track? Distances of true positions from the line that it was told to fly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.study.series import Ints, Track, Vehicle

Floats = NDArray[np.float64]

AIRBORNE_M = 0.5
"""Lower than this above home an aircraft counts as on the ground."""


def deviations_m(
    fleet: Sequence[Vehicle], tracks: Mapping[str, Track], waypoints: Mapping[str, Floats]
) -> dict[str, tuple[Ints, Floats]]:
    """(n,) times in ns and (n,) metres by vehicle id, of the samples in the air; without a home or waypoints none.

    `waypoints` are (n, 3) ENU metres in flying order; the track leads from home through them. Seen from above, so a
    wrong height is no deviation.
    """
    found = {}
    for vehicle in fleet:
        track, points, home = tracks[vehicle.id], waypoints.get(vehicle.id), vehicle.home_enu_m
        if home is None or points is None or not len(points) or not len(track):
            continue
        aloft = track.enu_m[:, 2] > home[2] + AIRBORNE_M
        line = shapely.LineString([home[:2], *points[:, :2].tolist()])
        away_m = shapely.distance(shapely.points(track.enu_m[aloft, :2]), line)
        found[vehicle.id] = (track.time_ns[aloft], np.asarray(away_m, dtype=np.float64))
    return found
