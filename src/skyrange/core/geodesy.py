"""Conversion between WGS 84 and east/north/up metres: one invertible map around the scenario's origin.

Mid-latitude equirectangular projection with the ellipsoid's radii of curvature taken at the mean
latitude of point and origin (Snyder, "Map Projections — A Working Manual", USGS PP 1395, p. 25,
eq. 4-18 and 4-20; ArduPilot's `Location::get_distance_NE` uses the same form on a sphere). Its
distance from the origin agrees with the geodesic to centimetres over a city (tests/validation).
The ground is flat: altitude is the origin's plus `up`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Convert = Callable[[float, float, Floats, Floats], tuple[Floats, Floats]]

Altitude = TypeVar("Altitude", float, "Floats")


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

    def ellipsoid_of(self, alt_msl_m: Altitude) -> Altitude:
        """Height above the ellipsoid (F3411, 14 CFR 89, GNSS) of an altitude above mean sea level (MAVLink's `alt`)."""
        return alt_msl_m + self.geoid_m

    def msl_of(self, alt_geo_m: Altitude) -> Altitude:
        """Altitude above mean sea level of a height above the ellipsoid; inverse of `ellipsoid_of`."""
        return alt_geo_m - self.geoid_m

    def to_enu(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(east_m, north_m) of points given in degrees; arrays of any one shape."""
        from skyrange.core import projection

        return _pointwise(projection.to_enu, self.lat_deg, self.lon_deg, lat_deg, lon_deg)

    def to_geodetic(self, east_m: ArrayLike, north_m: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(lat_deg, lon_deg) of points given in metres; inverse of `to_enu` to below 1e-9 degrees."""
        from skyrange.core import projection

        return _pointwise(projection.to_geodetic, self.lat_deg, self.lon_deg, east_m, north_m)

    def enu_of(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """`to_enu` for one point."""
        from skyrange.core import projection

        return projection.enu_of(self.lat_deg, self.lon_deg, float(lat_deg), float(lon_deg))

    def geodetic_of(self, east_m: float, north_m: float) -> tuple[float, float]:
        """`to_geodetic` for one point."""
        from skyrange.core import projection

        return projection.geodetic_of(self.lat_deg, self.lon_deg, float(east_m), float(north_m))


def _pointwise(
    convert: Convert, lat0_deg: float, lon0_deg: float, first: ArrayLike, second: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Apply a compiled function to arrays of any one shape; contiguous one-dimensional ones without copying."""
    import numpy as np

    a = np.ascontiguousarray(first, dtype=np.float64)
    b = np.ascontiguousarray(second, dtype=np.float64)
    if a.ndim == 1:
        return convert(lat0_deg, lon0_deg, a, b)
    x, y = convert(lat0_deg, lon0_deg, a.ravel(), b.ravel())
    return x.reshape(a.shape), y.reshape(a.shape)


def wrap_longitude(lng: float) -> float:
    """A longitude in degrees within -180…180; one that is stays as it is."""
    return lng if -180.0 <= lng <= 180.0 else (lng + 180.0) % 360.0 - 180.0


def longitude_near(lng: float, reference: float) -> float:
    """A longitude in degrees, and 360 more or less where that is nearer to `reference`; beyond ±180 if need be."""
    if lng - reference > 180.0:
        return lng - 360.0
    return lng + 360.0 if reference - lng > 180.0 else lng


def unwrap_outline(outline: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """The (latitude, longitude) of a ring without a jump at ±180: F3548 (Polygon) has the shortest path between two
    corners. The least longitude is at least -180 and below 180, others may exceed that.
    """
    lngs = [lng for _, lng in outline]
    if max(lngs) - min(lngs) <= 180.0:
        return tuple(outline)
    near = [(lat, longitude_near(lng, lngs[0])) for lat, lng in outline]
    west = min(lng for _, lng in near)
    turn = 360.0 if west < -180.0 else -360.0 if west >= 180.0 else 0.0
    return tuple((lat, lng + turn) for lat, lng in near)
