"""Sky view among buildings: which satellites an antenna sees, which it receives by a reflection, and by what detour."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, cos, pi, sin, sqrt, tan
from typing import Final

import numpy as np
import shapely

from skyrange.city.city import City
from skyrange.contracts.components import Floats

LEAST_ELEVATION_RAD: Final = 0.17
"""Ten degrees: the elevation mask of usual receivers."""
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
    reflects it if it is high enough where the reflected ray meets it. The detour of a reflection by a vertical wall at
    a distance d across the ray is 2·d·cos(elevation) (Hsu, Analysis and modeling GPS NLOS effect in highly urbanized
    area, GPS Solutions 22:7, 2018). Walls are taken to stand across the ray.
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
    for number, satellite in enumerate(sky):
        slope = tan(satellite.elevation_rad)
        for turn in (0.0, pi):
            azimuth = satellite.azimuth_rad + turn
            ray = shapely.LineString([(east, north), (east + radius_m * cos(azimuth), north + radius_m * sin(azimuth))])
            away = shapely.distance(begin, shapely.intersection(ray, shapes))  # NaN where they do not meet
            meets = up + slope * away
            met = away[(meets < tops) & (meets >= bases)]  # NaN compares false
            if not len(met):
                continue
            if turn:
                detour[number] = 2.0 * float(met.min()) * cos(satellite.elevation_rad)
            else:
                hidden[number] = 1.0
    return Seen(hidden, detour)


def solve(sky: tuple[Satellite, ...], errors_m: Floats) -> tuple[Floats, Floats] | None:
    """What errors of pseudoranges (n,) do to a least-squares fix; NaN is a satellite that is not received.

    Returns the error of the position (3,) and the dilution of precision east, north and up (3,); `None` with fewer than
    four satellites or with directions that give no fix (Kaplan and Hegarty, Understanding GPS, 2006, section 7.3).
    """
    used = np.isfinite(errors_m)
    if int(used.sum()) < 4:
        return None
    directions = np.array([satellite.unit for satellite, one in zip(sky, used, strict=True) if one])
    geometry = np.column_stack([-directions, np.ones(len(directions))])
    normal = geometry.T @ geometry
    if np.linalg.cond(normal) > 1e6:
        return None
    inverse = np.linalg.inv(normal)
    found = inverse @ (geometry.T @ errors_m[used])
    return found[:3], np.sqrt(np.diag(inverse)[:3])
