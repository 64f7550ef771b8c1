"""Conversion of metres and degrees point by point: the compiled functions behind `geodesy.Origin`.

One scalar computation serves one point and thousands, so that an aircraft's numbers never depend on how many are
converted with it; numpy's vector and remainder loops do not promise that.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementary
from skyrange.core.compiled import compiled

SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)
"""First eccentricity squared."""


_PER_DEGREE = math.pi / 180.0
_MERIDIONAL_M = SEMI_MAJOR_M * (1.0 - ECCENTRICITY_2) * _PER_DEGREE
_NORMAL_M = SEMI_MAJOR_M * _PER_DEGREE

_NULL_DEG = 1.5e-7
"""A point at 0 N, 0 E is given this latitude, 17 mm north, which is neither rounded nor truncated to 0: latitude and
longitude 0 mean "here" in an item of a mission (ArduPilot, ModeAuto::loc_from_cmd) and "unknown" in Remote ID
(`codec.f3411`) and in messages of MAVLink."""


@compiled
def scales(mid_lat_deg: float) -> tuple[float, float]:
    """Metres per degree of latitude and of longitude at a latitude (Snyder, eq. 4-18 and 4-20)."""
    phi = mid_lat_deg * _PER_DEGREE
    sine = elementary.sin(phi)
    w2 = 1.0 - ECCENTRICITY_2 * sine * sine
    w = math.sqrt(w2)
    return _MERIDIONAL_M / (w2 * w), _NORMAL_M / w * elementary.cos(phi)


@compiled
def enu_of(lat0_deg: float, lon0_deg: float, lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """(east_m, north_m) of a point in degrees."""
    north_scale, east_scale = scales(0.5 * (lat_deg + lat0_deg))
    return ((lon_deg - lon0_deg + 180.0) % 360.0 - 180.0) * east_scale, (lat_deg - lat0_deg) * north_scale


@compiled
def to_enu(
    lat0_deg: float, lon0_deg: float, lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(east_m, north_m), each (n,), of points (n,) in degrees."""
    east, north = np.empty_like(lat_deg), np.empty_like(lat_deg)
    for i in range(lat_deg.shape[0]):
        east[i], north[i] = enu_of(lat0_deg, lon0_deg, lat_deg[i], lon_deg[i])
    return east, north


@compiled
def geodetic_of(lat0_deg: float, lon0_deg: float, east_m: float, north_m: float) -> tuple[float, float]:
    """(lat_deg, lon_deg) of a point in metres, never 0 and 0 in units of 1e-7 degrees: see `_NULL_DEG`."""
    here = lat0_deg
    for _ in range(3):  # a contraction with factor ~1e-6 at city scale: three rounds reach rounding
        north_scale, east_scale = scales(0.5 * (here + lat0_deg))
        here = lat0_deg + north_m / north_scale
    north_scale, east_scale = scales(0.5 * (here + lat0_deg))
    lon = (lon0_deg + east_m / east_scale + 180.0) % 360.0 - 180.0
    if abs(here) < _NULL_DEG and abs(lon) < _NULL_DEG:
        here = _NULL_DEG
    return here, lon


@compiled
def to_geodetic(
    lat0_deg: float, lon0_deg: float, east_m: NDArray[np.float64], north_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(lat_deg, lon_deg), each (n,), of points (n,) in metres."""
    lat, lon = np.empty_like(east_m), np.empty_like(east_m)
    for i in range(east_m.shape[0]):
        lat[i], lon[i] = geodetic_of(lat0_deg, lon0_deg, east_m[i], north_m[i])
    return lat, lon
