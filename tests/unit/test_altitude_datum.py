"""F3411 and 14 CFR 89 count from the ellipsoid, MAVLink from mean sea level: one conversion, tested both ways."""

from __future__ import annotations

import numpy as np

from skyrange.codec.f3411 import Location, decode, encode
from skyrange.core.geodesy import Origin

# Manhattan: the geoid is about 33 m below the ellipsoid (EGM96 and GEOID18 agree to a metre there).
MANHATTAN = Origin(40.7780, -73.9550, alt_msl_m=20.0, geoid_m=-32.8)


def test_the_geoid_is_added_towards_the_ellipsoid() -> None:
    assert MANHATTAN.ellipsoid_of(20.0) == 20.0 - 32.8
    assert abs(MANHATTAN.msl_of(-12.8) - 20.0) < 1e-12
    np.testing.assert_allclose(MANHATTAN.msl_of(MANHATTAN.ellipsoid_of(np.array([0.0, 50.0]))), [0.0, 50.0], atol=1e-12)


def test_an_altitude_above_the_sea_crosses_a_broadcast() -> None:
    alt_msl_m = 61.3
    sent = Location(2, 40.778, -73.955, alt_geo_m=MANHATTAN.ellipsoid_of(alt_msl_m))
    heard = decode(encode(sent))
    assert isinstance(heard, Location)
    assert heard.alt_geo_m is not None
    assert heard.alt_geo_m == 28.5
    assert abs(MANHATTAN.msl_of(heard.alt_geo_m) - alt_msl_m) <= 0.25  # half of F3411's step
