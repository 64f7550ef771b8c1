"""Airspace volumes of a flight plan: one 4-D volume per leg, with stated margins.

A volume is the leg's footprint widened by `horizontal_m` on all sides, its range of heights widened by
`vertical_m` (but not below the ground), and the time in which the leg is expected to be flown, from `early_s`
before to `late_s` after, plus a share of the time flown so far, because the error of the estimate grows with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.core import elementary_python
from skyrange.core.geodesy import Origin
from skyrange.core.time import Time, from_seconds
from skyrange.core.volumes import Volume4D
from skyrange.gcs.plan.paths import Leg, Point
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.gcs.plan.routes import legs


@dataclass(frozen=True, slots=True)
class Margins:
    """By how much a volume exceeds the estimated leg; all values at least 0, `horizontal_m` above 0."""

    horizontal_m: float = 5.0
    vertical_m: float = 3.0
    early_s: float = 5.0
    late_s: float = 30.0
    drift: float = 0.25
    """By how much a leg may be late, as a share of the flight time up to it."""


MARGINS = Margins()
Outline = tuple[tuple[float, float], ...]
_QUADRANT_SEGMENTS = 2
_CIRCUMSCRIBE = 1.0 / elementary_python.cos(math.pi / 8.0)
"""Round ends are drawn as octagons, which have few vertices; this factor makes each octagon enclose its circle."""


def volumes(plan: FlightPlan, depart_ns: Time, margins: Margins = MARGINS) -> tuple[Volume4D, ...]:
    """The volumes of `plan` with take-off at `depart_ns`: one per leg, in the order flown."""
    return leg_volumes(plan.origin, legs(plan), depart_ns, margins)


def leg_volumes(origin: Origin, flown: Sequence[Leg], begin_ns: Time, margins: Margins) -> tuple[Volume4D, ...]:
    """The volumes of legs that are flown one after another from `begin_ns` on."""
    outlines = _outlines(origin, _ground_tracks(flown), margins.horizontal_m)
    out: list[Volume4D] = []
    since_s = 0.0
    for leg, outline in zip(flown, outlines, strict=True):
        until_s = since_s + leg.duration_s
        heights = min(leg.start.up_m, leg.end.up_m), max(leg.start.up_m, leg.end.up_m)
        start_ns = begin_ns + from_seconds(since_s - margins.early_s)
        end_ns = begin_ns + from_seconds(until_s * (1.0 + margins.drift) + margins.late_s)
        out.append(_prism(origin, outline, heights, margins.vertical_m, start_ns, end_ns))
        since_s = until_s
    return tuple(out)


def around(origin: Origin, point: Point, radius_m: float, height_m: float, begin_ns: Time, end_ns: Time) -> Volume4D:
    """The volume within `radius_m` and `height_m` of a point, not below the ground."""
    (outline,) = _outlines(origin, shapely.points([point[:2]]), radius_m)
    return _prism(origin, outline, (point.up_m, point.up_m), height_m, begin_ns, end_ns)


def _ground_tracks(flown: Sequence[Leg]) -> NDArray[Any]:
    """(n,) the geometry over which each leg leads: a line, or a point where it only climbs, sinks or waits."""
    ends = np.array([[leg.start[:2], leg.end[:2]] for leg in flown]).reshape(-1, 2, 2)
    tracks: NDArray[Any] = shapely.linestrings(ends)
    still = (ends[:, 0] == ends[:, 1]).all(axis=1)
    tracks[still] = shapely.points(ends[still, 0])
    return tracks


def _outlines(origin: Origin, tracks: NDArray[Any], radius_m: float) -> list[Outline]:
    """The outlines of tracks widened by `radius_m`: (latitude, longitude) of each corner, anticlockwise."""
    rings = shapely.get_exterior_ring(shapely.buffer(tracks, radius_m * _CIRCUMSCRIBE, quad_segs=_QUADRANT_SEGMENTS))
    corners, of = shapely.get_coordinates(rings, return_index=True)
    lat, lon = origin.to_geodetic(corners[:, 0], corners[:, 1])
    places = list(zip(lat.tolist(), lon.tolist(), strict=True))
    ends = np.searchsorted(of, np.arange(len(rings) + 1)).tolist()
    outlines = []
    for anticlockwise, begin, end in zip(shapely.is_ccw(rings).tolist(), ends, ends[1:], strict=False):
        ring = places[begin:end] if anticlockwise else places[begin:end][::-1]
        outlines.append(tuple(ring[:-1]))  # without the repeated first corner
    return outlines


def _prism(
    origin: Origin, outline: Outline, heights: tuple[float, float], height_m: float, begin_ns: Time, end_ns: Time
) -> Volume4D:
    to_ellipsoid_m = origin.ellipsoid_of(origin.alt_msl_m)
    return Volume4D(
        outline=outline,
        lower_m=max(heights[0] - height_m, 0.0) + to_ellipsoid_m,
        upper_m=heights[1] + height_m + to_ellipsoid_m,
        start_ns=begin_ns,
        end_ns=end_ns,
    )
