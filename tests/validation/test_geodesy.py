"""The local map against the geodesic of WGS 84 (Karney 2013, by pyproj)."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from skyrange.core.geodesy import Origin

GEOD = pyproj.Geod(ellps="WGS84")


@pytest.mark.parametrize("lat", [-35.363328, 0.0, 40.778, 64.0])
def test_distance_and_bearing_from_the_origin(lat: float) -> None:
    origin = Origin(lat, 149.1652241)
    rng = np.random.default_rng(4)
    east, north = rng.uniform(-5_000, 5_000, (2, 200))
    point_lat, point_lon = origin.to_geodetic(east, north)
    azimuth, _, distance = GEOD.inv(np.full(200, origin.lon_deg), np.full(200, origin.lat_deg), point_lon, point_lat)
    assert np.abs(distance - np.hypot(east, north)).max() < 0.02  # m, over a city 10 km wide
    error_deg = (azimuth - np.degrees(np.arctan2(east, north)) + 180.0) % 360.0 - 180.0
    assert np.abs(error_deg).max() < 0.1  # half the convergence of meridians at 64° N over 5 km


@pytest.mark.parametrize("lon", [149.1652241, 179.9999, -180.0])
def test_the_map_is_inverted_to_micrometres(lon: float) -> None:
    origin = Origin(-35.363328, lon)
    east, north = np.meshgrid(np.linspace(-2e4, 2e4, 41), np.linspace(-2e4, 2e4, 41))
    back_east, back_north = origin.to_enu(*origin.to_geodetic(east, north))
    assert np.abs(back_east - east).max() < 1e-5
    assert np.abs(back_north - north).max() < 1e-5


def test_one_point_equals_many() -> None:
    origin = Origin(40.778, -73.955)
    lat, lon = origin.geodetic_of(120.5, -33.25)
    assert origin.enu_of(lat, lon) == pytest.approx((120.5, -33.25), abs=1e-6)
