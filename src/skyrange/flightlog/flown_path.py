"""The flown path of a flight as few waypoints (D. H. Douglas & T. K. Peucker, Cartographica 10, 1973)."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.flightlog.flights import Flight
from skyrange.flightlog.model import Rows

Floats = NDArray[np.float64]
_TOLERANCES_M: Final = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_MOST: Final = 200
_LEAST_UP_M: Final = 2.0
"""Waypoints are not lower: the ends of a track are at the ground."""
_SPEEDS_MPS: Final = (0.5, 20.0)


def track_m(flight: Flight, rows: Rows | None = None) -> Floats:
    """(n, 4) time of the log in seconds, and metres east, north and up of home, of positions: from take-off to landing
    if none are given.
    """
    rows = flight.rows("position") if rows is None else rows
    east_m, north_m = flight.origin.to_enu(rows["lat_deg"], rows["lon_deg"])
    return np.stack([rows["time_s"], east_m, north_m, rows["alt_msl_m"] - flight.home[2]], axis=1)


def simplify_path(flight: Flight) -> tuple[list[list[float]], float, float]:
    """Points (east, north, up) in metres from home, the speed in m/s, and how far the track is from the points at most.

    The least tolerance that leaves at most `_MOST` points is taken, at least a metre.
    """
    track = track_m(flight)[:, 1:]
    kept = np.arange(len(track))
    for tolerance_m in _TOLERANCES_M:
        kept = _keep(track, tolerance_m)
        if len(kept) <= _MOST:
            break
    points = track[kept].copy()
    points[:, 2] = np.maximum(points[:, 2], _LEAST_UP_M)
    off_m = max(
        (float(_distances(track[first : last + 1]).max()) for first, last in pairwise(kept.tolist())),
        default=0.0,
    )
    rows = flight.rows("position")
    speeds = np.sqrt(rows["north_mps"] ** 2 + rows["east_mps"] ** 2)
    moving = speeds[np.isfinite(speeds) & (speeds > _SPEEDS_MPS[0])]
    speed_mps = float(np.clip(np.median(moving), *_SPEEDS_MPS)) if len(moving) else 5.0
    return [[round(value, 2) for value in point] for point in points.tolist()], round(speed_mps, 2), off_m


def _keep(track: Floats, tolerance_m: float) -> NDArray[np.int64]:
    """The rows of the points that stay."""
    if len(track) < 3:
        return np.arange(len(track))
    kept = {0, len(track) - 1}
    spans = [(0, len(track) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        off_m = _distances(track[first : last + 1])
        worst = int(off_m.argmax())
        if off_m[worst] > tolerance_m:
            kept.add(first + worst)
            spans += [(first, first + worst), (first + worst, last)]
    return np.array(sorted(kept))


def _distances(points: Floats) -> Floats:
    """Distances of points from the line between the first and the last."""
    start, line = points[0], points[-1] - points[0]
    square = float((line * line).sum())
    along = np.clip((points - start) @ line / square, 0.0, 1.0) if square else np.zeros(len(points))
    off: Floats = np.sqrt(((points - start - along[:, None] * line) ** 2).sum(axis=1))
    return off
