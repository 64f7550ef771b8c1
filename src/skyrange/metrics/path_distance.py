"""Distance between two paths in space, whatever the times at which they were flown."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_STEP_M: Final = 0.1
"""Tracks are resampled to this distance between points."""
_CHUNK: Final = 1024


def path_distance_m(first: Floats, second: Floats) -> tuple[float, str]:
    """Greatest distance of a point of either track (n, 3) from the other track, and where it is.

    NaN if either has fewer than two points: what was not flown agrees with nothing.
    This is the Hausdorff distance of the tracks as lines, to within half of `_STEP_M`.
    """
    if len(first) < 2 or len(second) < 2:
        return np.nan, ""
    most, where = 0.0, ""
    for points, line in ((first, resampled(second)), (second, resampled(first))):
        for start in range(0, len(points), _CHUNK):
            part = points[start : start + _CHUNK]
            squares = np.full(len(part), np.inf)
            for begin in range(0, len(line), _CHUNK):
                apart = part[:, None, :] - line[None, begin : begin + _CHUNK, :]
                squares = np.minimum(squares, (apart * apart).sum(axis=2).min(axis=1))
            far = int(squares.argmax())
            if np.sqrt(squares[far]) > most:
                most = float(np.sqrt(squares[far]))
                where = "near " + ", ".join(f"{value:.0f}" for value in part[far]) + " m"
    return most, where


def resampled(track: Floats) -> Floats:
    """The points of a track (n, 3) at equal distances of `_STEP_M` along it, with its ends."""
    steps = np.sqrt((np.diff(track, axis=0) ** 2).sum(axis=1))
    along = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.append(np.arange(0.0, along[-1], _STEP_M), along[-1])
    return np.stack([np.interp(wanted, along, track[:, axis]) for axis in range(3)], axis=1)
