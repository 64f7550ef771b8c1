"""The 4-D volume that a plan claims: Volume4D of ASTM F3548-21.

Heights are above the WGS 84 ellipsoid, as F3548 (Altitude, reference W84, units M) asks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skyrange.core.geodesy import longitude_near, unwrap_outline
from skyrange.core.time import Time


@dataclass(frozen=True, slots=True)
class Volume4D:
    """A prism with a time window.

    `outline` is a closed ring without the repeated last vertex, (latitude, longitude) in degrees, at
    least three vertices; `lower_m` and `upper_m` are ellipsoid heights in metres; `start_ns` and
    `end_ns` are simulated times.
    """

    outline: tuple[tuple[float, float], ...]
    lower_m: float
    upper_m: float
    start_ns: Time
    end_ns: Time

    def __post_init__(self) -> None:
        if len(self.outline) < 3:
            raise ValueError(f"a volume's outline needs 3 vertices, got {len(self.outline)}")
        if not self.lower_m < self.upper_m:
            raise ValueError(f"a volume's lower_m must be below upper_m, got {self.lower_m} and {self.upper_m}")
        if not self.start_ns < self.end_ns:
            raise ValueError(f"a volume must start before it ends, got {self.start_ns} and {self.end_ns}")


def contains(volumes: Sequence[Volume4D], time: Time, lat: float, lon: float, up_m: float) -> bool:
    """Whether a position (degrees, metres above the ellipsoid) lies in one of `volumes` at a time."""
    return any(
        volume.start_ns <= time <= volume.end_ns
        and volume.lower_m <= up_m <= volume.upper_m
        and _is_inside(volume.outline, lat, lon)
        for volume in volumes
    )


def _is_inside(ring: Sequence[tuple[float, float]], lat: float, lon: float) -> bool:
    """Whether a ray from a point to the east crosses a ring an odd number of times."""
    inside = False
    ring = unwrap_outline(ring)
    lon = longitude_near(lon, ring[0][1])
    lat_0, lon_0 = ring[-1]
    for lat_1, lon_1 in ring:
        if (lat_0 > lat) != (lat_1 > lat) and lon < lon_0 + (lat - lat_0) / (lat_1 - lat_0) * (lon_1 - lon_0):
            inside = not inside
        lat_0, lon_0 = lat_1, lon_1
    return inside
