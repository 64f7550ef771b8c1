"""Cross-track deviation: distance of true positions from the commanded track."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.metrics.time_series import Ints, Track, Vehicle

Floats = NDArray[np.float64]

AIRBORNE_M = 0.5
"""An aircraft lower than this above home counts as on the ground."""


def deviations_m(
    fleet: Sequence[Vehicle], tracks: Mapping[str, Track], waypoints: Mapping[str, Floats]
) -> dict[str, tuple[Ints, Floats]]:
    """(n,) times in ns and (n,) metres by vehicle id, for samples in the air; vehicles without home or waypoints lack.

    `waypoints` are (n, 3) ENU metres in the order flown; the track leads from home through them. The distance is
    horizontal, so a wrong height is no deviation.
    """
    found = {}
    for vehicle in fleet:
        track, points, home = tracks[vehicle.id], waypoints.get(vehicle.id), vehicle.home_enu_m
        if home is None or points is None or not len(points) or not len(track):
            continue
        airborne = track.enu_m[:, 2] > home[2] + AIRBORNE_M
        line = shapely.LineString([home[:2], *points[:, :2].tolist()])
        away_m = shapely.distance(shapely.points(track.enu_m[airborne, :2]), line)
        found[vehicle.id] = (track.time_ns[airborne], np.asarray(away_m, dtype=np.float64))
    return found
