"""Simultaneous bands of simulated tracks, and how well they hold that of a log.

A band that holds each point by itself with a probability holds a whole track with a smaller one. The bands here are
simultaneous: half their width is one multiple, at all times and along all axes, of the standard deviation over the
seeds there, and the multiple is such that the band holds the whole tracks of a share of the seeds (the sup-t band of
J. L. Montiel Olea & M. Plagborg-Møller, J. Appl. Econometrics 34, 2019, with quantiles of the sample).

A wide band always holds the log. So its width counts too, by the interval score of T. Gneiting & A. E. Raftery (JASA
102, 2007, eq. 43), the mean over times and axes: the width, and 2/α times the distance by which the log is outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SHARE: Final = 0.95
_RESOLUTION_M: Final = 0.01
"""GLOBAL_POSITION_INT has 1e-7 degrees: a standard deviation below this says nothing."""


@dataclass(frozen=True, slots=True)
class Band:
    """A band around tracks; both arrays are (n, 3) metres east, north and up."""

    centre_m: Floats
    half_m: Floats


@dataclass(frozen=True, slots=True)
class TrackScore:
    """How a band holds a track."""

    held: bool
    """Whether the whole track is within the band, along all axes."""
    inside: float
    """The share of times at which it is."""
    width_m: float
    """Mean width of the band."""
    away_m: float
    """Mean distance of the track from the band's centre."""
    score_m: float
    """The interval score."""


def fit_band(tracks_m: Floats) -> Band:
    """The band of tracks at the same times, (seeds, n, 3) metres, with at least two seeds."""
    centre, deviation = tracks_m.mean(axis=0), np.maximum(tracks_m.std(axis=0, ddof=1), _RESOLUTION_M)
    farthest = np.sort((np.abs(tracks_m - centre) / deviation).max(axis=(1, 2)))
    return Band(centre, farthest[math.ceil(SHARE * len(farthest)) - 1] * deviation)


def score_track(band: Band, track_m: Floats) -> TrackScore:
    """How a band holds the track (n, 3)."""
    off = track_m - band.centre_m
    outside = np.maximum(np.abs(off) - band.half_m, 0.0)
    within = (outside == 0.0).all(axis=1)
    width = 2.0 * band.half_m
    return TrackScore(
        bool(within.all()),
        float(within.mean()),
        float(width.mean()),
        float(np.sqrt((off * off).sum(axis=1)).mean()),
        float((width + 2.0 / (1.0 - SHARE) * outside).mean()),
    )
