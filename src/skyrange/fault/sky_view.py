"""Sky view among buildings: which satellites an antenna sees, which it receives by a reflection, and by what detour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import asin, cos, pi, sin, sqrt, tan
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.contracts.components import Floats

Shapes = NDArray[np.object_]

LEAST_ELEVATION_RAD: Final = 0.17
"""Ten degrees: the elevation mask of usual receivers."""
MOST_CONDITION: Final = 1e6
"""Largest condition number of the normal equations: beyond it there is no fix."""
_GOLDEN_RAD: Final = pi * (3.0 - sqrt(5.0))


@dataclass(frozen=True, slots=True)
class Satellite:
    """A direction in the sky, radians; the azimuth is from east towards north."""

    azimuth_rad: float
    elevation_rad: float

    @property
    def unit(self) -> tuple[float, float, float]:
        """East, north and up of the direction."""
        flat = cos(self.elevation_rad)
        return flat * cos(self.azimuth_rad), flat * sin(self.azimuth_rad), sin(self.elevation_rad)


def even_sky(count: int, first_rad: float) -> tuple[Satellite, ...]:
    """Directions that share the sky above the mask evenly (a Fibonacci lattice), from an azimuth `first_rad` on."""
    lowest = sin(LEAST_ELEVATION_RAD)
    heights = [lowest + (1.0 - lowest) * (k + 0.5) / count for k in range(count)]
    return tuple(Satellite(first_rad + k * _GOLDEN_RAD, asin(height)) for k, height in enumerate(heights))


@dataclass(frozen=True, slots=True)
class Seen:
    """How the signals of n satellites reach an antenna."""

    hidden: Floats
    """(n,) 1 where a building blocks the line of sight, else 0."""
    detour_m: Floats
    """(n,) how much longer than the direct path the reflected one is; NaN where there is none."""


def see(city: City, place: tuple[float, float, float], sky: tuple[Satellite, ...], radius_m: float) -> Seen:
    """Direct and reflected paths from each satellite to `place`, by buildings within `radius_m`.

    A satellite is hidden by a building in its azimuth that is higher than the ray there. A wall in the opposite azimuth
    reflects it if it is high enough where the reflected ray meets it, and if the ray reaches it. The detour of a
    reflection by a vertical wall at a distance d across the ray is 2·d·cos(elevation) (Hsu, Analysis and modeling GPS
    NLOS effect in highly urbanized area, GPS Solutions 22:7, 2018). Walls are taken to stand across the ray.
    """
    east, north, up = place
    hidden, detour = np.zeros(len(sky)), np.full(len(sky), np.nan)
    near = city.obstacles_within(east, north, radius_m)
    if not near:
        return Seen(hidden, detour)
    begin = shapely.Point(east, north)
    shapes = np.array([building.shape for building in near])
    tops = np.array([building.height_m for building in near])
    bases = np.array([building.base_m for building in near])
    azimuths = [satellite.azimuth_rad for satellite in sky]
    ways = _ways(begin, [*azimuths, *(azimuth + pi for azimuth in azimuths)], radius_m, shapes)
    for number, satellite in enumerate(sky):
        slope = tan(satellite.elevation_rad)
        towards, behind = ways[number], ways[len(sky) + number]
        hides = (up + slope * towards < tops) & (up + slope * towards >= bases)  # NaN compares false
        hidden[number] = float(hides.any())
        walls = behind[(up + slope * behind < tops) & (up + slope * behind >= bases)]
        if not len(walls):
            continue
        away_m = float(walls.min())
        above = up + slope * (2.0 * away_m + towards)  # the ray on its way to the wall
        if not ((above < tops) & (above >= bases)).any():
            detour[number] = 2.0 * away_m * cos(satellite.elevation_rad)
    return Seen(hidden, detour)


def _ways(begin: shapely.Point, azimuths_rad: Sequence[float], radius_m: float, shapes: Shapes) -> Floats:
    """(azimuths, n) distance from a point to each footprint, metres; NaN where there is none within the radius."""
    ends = [(begin.x + radius_m * cos(azimuth), begin.y + radius_m * sin(azimuth)) for azimuth in azimuths_rad]
    rays = shapely.linestrings([[(begin.x, begin.y), end] for end in ends])
    return np.asarray(shapely.distance(begin, shapely.intersection(rays[:, None], shapes)), dtype=np.float64)


def solve(sky: tuple[Satellite, ...], errors_m: Floats, strength: Floats) -> tuple[Floats, Floats] | None:
    """What errors of pseudoranges (n,) do to a fix; NaN is a satellite that is not received.

    The fix is that of weighted least squares. A weight is the square of `strength`, the amplitude as a share of that in
    the open (as in the SIGMA-ε model of Hartinger and Brunner, GPS Solutions 2:4, 1999), times that of the sine of the
    elevation (as in RTKLIB). Returns the error of the position (3,) and the dilution of precision east, north and up
    (3,); `None` with fewer than four satellites or with directions that give no fix.
    """
    used = np.isfinite(errors_m)
    if int(used.sum()) < 4:
        return None
    directions = np.array([satellite.unit for satellite, one in zip(sky, used, strict=True) if one])
    weights = (strength[used] * directions[:, 2]) ** 2
    geometry = np.column_stack([-directions, np.ones(len(directions))])
    normal = geometry.T @ (weights[:, None] * geometry)
    if np.linalg.cond(normal) > MOST_CONDITION:
        return None
    inverse = np.linalg.inv(normal)
    found = inverse @ (geometry.T @ (weights * errors_m[used]))
    return found[:3], np.sqrt(np.diag(inverse)[:3])
