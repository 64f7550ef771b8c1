"""How do east/north/up metres relate to WGS 84? One invertible map around the scenario's origin.

Mid-latitude equirectangular projection with the ellipsoid's radii of curvature taken at the mean
latitude of point and origin (Snyder, "Map Projections — A Working Manual", USGS PP 1395, p. 25,
eq. 4-18 and 4-20; ArduPilot's `Location::get_distance_NE` uses the same form on a sphere). Its
distance from the origin agrees with the geodesic to centimetres over a city (tests/validation).
The ground is flat: altitude is the origin's plus `up`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SEMI_MAJOR_M = 6_378_137.0
"""WGS 84 semi-major axis (NIMA TR8350.2)."""
FLATTENING = 1.0 / 298.257223563
"""WGS 84 flattening (NIMA TR8350.2)."""
_E2 = FLATTENING * (2.0 - FLATTENING)


@dataclass(frozen=True, slots=True)
class Origin:
    """The point that local coordinates are measured from.

    `lat_deg`, `lon_deg` WGS 84; `alt_msl_m` above mean sea level (MAVLink's datum); `geoid_m` is the
    geoid's height above the ellipsoid there, so the ellipsoid height (ASTM F3411, 14 CFR 89) is
    `alt_msl_m + geoid_m`.
    """

    lat_deg: float
    lon_deg: float
    alt_msl_m: float = 0.0
    geoid_m: float = 0.0

    def _scales(self, mid_lat_deg: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Metres per degree of latitude and of longitude at a latitude."""
        phi = np.radians(mid_lat_deg)
        w2 = 1.0 - _E2 * np.sin(phi) ** 2
        meridional_m = SEMI_MAJOR_M * (1.0 - _E2) / (w2 * np.sqrt(w2))
        normal_m = SEMI_MAJOR_M / np.sqrt(w2)
        per_degree = math.pi / 180.0
        return meridional_m * per_degree, normal_m * np.cos(phi) * per_degree

    def to_enu(
        self, lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(east_m, north_m) of points given in degrees; arrays of any one shape."""
        north_scale, east_scale = self._scales(0.5 * (np.asarray(lat_deg) + self.lat_deg))
        dlon = (np.asarray(lon_deg) - self.lon_deg + 180.0) % 360.0 - 180.0
        return dlon * east_scale, (np.asarray(lat_deg) - self.lat_deg) * north_scale

    def to_geodetic(
        self, east_m: NDArray[np.float64], north_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(lat_deg, lon_deg) of points given in metres; inverse of `to_enu` to below 1e-9 degrees."""
        lat = np.full_like(np.asarray(north_m, dtype=np.float64), self.lat_deg)
        for _ in range(3):  # a contraction with factor ~1e-6 at city scale: three rounds reach rounding
            north_scale, east_scale = self._scales(0.5 * (lat + self.lat_deg))
            lat = self.lat_deg + np.asarray(north_m) / north_scale
        _, east_scale = self._scales(0.5 * (lat + self.lat_deg))
        lon = self.lon_deg + np.asarray(east_m) / east_scale
        return lat, (lon + 180.0) % 360.0 - 180.0

    def enu_of(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """`to_enu` for one point."""
        east, north = self.to_enu(np.asarray(lat_deg), np.asarray(lon_deg))
        return float(east), float(north)

    def geodetic_of(self, east_m: float, north_m: float) -> tuple[float, float]:
        """`to_geodetic` for one point."""
        lat, lon = self.to_geodetic(np.asarray(east_m), np.asarray(north_m))
        return float(lat), float(lon)
