"""Airspace volumes of a flight plan: one 4-D volume per leg, with stated margins.

A volume is the leg's footprint widened by `horizontal_m` on all sides, its range of heights widened by
`vertical_m` (but not below the ground), and the time in which the leg is expected to be flown, from `early_s`
before to `late_s` after, plus a share of the time flown so far, because the error of the estimate grows with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from shapely.geometry import LineString, Point, Polygon
from shapely.geometry.polygon import orient

from skyrange.core.time import Time, from_seconds
from skyrange.core.volumes import Volume4D
from skyrange.gcs.plan.paths import Leg
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
_QUADRANT_SEGMENTS = 2
_CIRCUMSCRIBE = 1.0 / math.cos(math.pi / 8.0)
"""Round ends are drawn as octagons, which have few vertices; this factor makes each octagon enclose its circle."""


def volumes(plan: FlightPlan, depart_ns: Time, margins: Margins = MARGINS) -> tuple[Volume4D, ...]:
    """The volumes of `plan` with take-off at `depart_ns`: one per leg, in the order flown."""
    out: list[Volume4D] = []
    since_s = 0.0
    for leg in legs(plan):
        until_s = since_s + leg.duration_s
        out.append(_volume(plan, leg, depart_ns, since_s, until_s, margins))
        since_s = until_s
    return tuple(out)


def _volume(plan: FlightPlan, leg: Leg, depart_ns: Time, since_s: float, until_s: float, margins: Margins) -> Volume4D:
    origin = plan.origin
    a, b = leg.start, leg.end
    still = (a.east_m, a.north_m) == (b.east_m, b.north_m)
    line = Point(a.east_m, a.north_m) if still else LineString([(a.east_m, a.north_m), (b.east_m, b.north_m)])
    ring: Polygon = orient(line.buffer(margins.horizontal_m * _CIRCUMSCRIBE, quad_segs=_QUADRANT_SEGMENTS))
    corners = np.asarray(ring.exterior.coords)[:-1]
    lat, lon = origin.to_geodetic(corners[:, 0], corners[:, 1])
    to_ellipsoid_m = origin.ellipsoid_of(origin.alt_msl_m)
    lower_m = max(min(a.up_m, b.up_m) - margins.vertical_m, 0.0)
    upper_m = max(a.up_m, b.up_m) + margins.vertical_m
    return Volume4D(
        outline=tuple(zip(lat.tolist(), lon.tolist(), strict=True)),
        lower_m=lower_m + to_ellipsoid_m,
        upper_m=upper_m + to_ellipsoid_m,
        start_ns=depart_ns + from_seconds(since_s - margins.early_s),
        end_ns=depart_ns + from_seconds(until_s * (1.0 + margins.drift) + margins.late_s),
    )
