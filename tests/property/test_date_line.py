"""Volumes across the date line: what overlaps, contains and covers elsewhere does so there too."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from skyrange.city.building_files import load_buildings
from skyrange.codec.f3548.values import Area
from skyrange.core.geodesy import Origin, unwrap_outline, wrap_longitude
from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import Volume4D, contains
from skyrange.utm.airspace.claimed_airspace import Airspace, Query
from skyrange.utm.alternatives import Limits, find_alternatives, reach
from skyrange.utm.federated.dss.coverings import extent_of
from tests.tiers import examples

Ring = tuple[tuple[float, float], ...]
STEP_DEG = 0.002
HERE = 20.0


LIMITS = Limits(60.0, (20.0,), (50.0, -50.0), 120.0, 4)
BOX: Ring = ((-0.002, -0.004), (0.002, -0.004), (0.002, 0.004), (-0.002, 0.004))


def rings(shift: float) -> st.SearchStrategy[Ring]:
    """Convex rings about 0, 0. With other shifts no corner of one is on an edge of another."""
    corner = st.builds(
        lambda a, b: ((a + shift) * STEP_DEG, (b - 0.7 * shift) * STEP_DEG), st.integers(-4, 4), st.integers(-4, 4)
    )
    hulls = st.lists(corner, min_size=3, max_size=6, unique=True).map(shapely.MultiPoint).map(shapely.convex_hull)
    return hulls.filter(lambda hull: hull.area > 0.0).map(lambda hull: tuple(hull.exterior.coords[:-1]))


def at(lon: float) -> Callable[[Ring], Volume4D]:
    def place(ring: Ring) -> Volume4D:
        return Volume4D(tuple((lat, wrap_longitude(lon + lng)) for lat, lng in ring), 0.0, 50.0, 0, 60 * NS_PER_S)

    return place


def places_of(ring: Ring, lon: float) -> list[tuple[float, float]]:
    return [(lat, wrap_longitude(lon + lng)) for lat, lng in ring]


@settings(max_examples=examples(200))
@given(st.lists(rings(0.0), min_size=1, max_size=6), st.lists(rings(0.37), min_size=1, max_size=4))
@example(
    [((-0.002, -0.004), (0.002, -0.004), (0.002, 0.004), (-0.002, 0.004))],
    [((0.0, -0.006), (0.001, -0.001), (-0.001, -0.001))],
)
def test_what_overlaps_elsewhere_overlaps_there(claims: list[Ring], asked: list[Ring]) -> None:
    found = []
    for lon in (HERE, 180.0, -180.0, 179.9971, -179.9953):
        airspace = Airspace()
        for number, ring in enumerate(claims):
            airspace.put(str(number), [at(lon)(ring)])
        found.append(airspace.find_overlaps(list(map(at(lon), asked))))
    assert all(one == found[0] for one in found)


@given(rings(0.0), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))
def test_what_contains_a_point_elsewhere_contains_it_there(ring: Ring, lat: float, lng: float) -> None:
    east = [lng + 1e-5] * 2  # not on an edge
    inside = [contains([at(lon)(ring)], 0, lat + 1.3e-5, wrap_longitude(lon + east[0]), 10.0) for lon in (HERE, 180.0)]
    assert inside[0] == inside[1]


@given(rings(0.0))
def test_an_outline_is_unwrapped_to_the_ring_that_it_is(ring: Ring) -> None:
    there = unwrap_outline(at(180.0)(ring).outline)
    lngs = [lng for _, lng in there]
    assert max(lngs) - min(lngs) < 0.02
    assert -180.0 <= min(lngs) <= 180.0
    assert np.allclose([wrap_longitude(lng - 180.0) for lng in lngs], [lng for _, lng in ring], atol=1e-9)


@given(rings(0.0).filter(lambda ring: len({lng for _, lng in ring}) > 1))
def test_a_covering_is_as_small_there_as_elsewhere(ring: Ring) -> None:
    one, other = (extent_of([Area(at(lon)(ring).outline, 0.0, 50.0, 0, 1)]) for lon in (HERE, 180.0))
    assert len(other.cells) <= 4 * len(one.cells) + 4


def test_alternatives_reach_as_far_there() -> None:
    def search(queries: Sequence[Query]) -> list[Time | None]:
        """No delay is free, and each other change is."""
        return [None] if len(queries) == 1 else [0] * len(queries)

    shapes = []
    for lon in (HERE, 180.0):
        volume = at(lon)(BOX)
        offers = find_alternatives([volume], search, LIMITS)
        around = unwrap_outline(reach([volume], LIMITS).outline)
        ends = [(lat, wrap_longitude(lng - lon)) for lat, lng in around]
        moved = [[(lat, wrap_longitude(lng - lon)) for lat, lng in one.volumes[0].outline] for one in offers]
        shapes.append((ends, moved))
    assert np.allclose(shapes[0][0], shapes[1][0], atol=1e-9)
    assert len(shapes[0][1]) == len(shapes[1][1]) > 0
    for one, other in zip(shapes[0][1], shapes[1][1], strict=True):
        assert np.allclose(one, other, atol=1e-9)


def test_a_city_across_it_is_one_city(tmp_path: Path) -> None:
    """RFC 7946, 3.1.9: its features are on both sides."""

    def feature(number: int, west: float) -> dict[str, object]:
        lngs = [wrap_longitude(west + step) for step in (0.0, 0.0003, 0.0003, 0.0, 0.0)]
        ring = [[lng, lat] for lng, lat in zip(lngs, (-16.8, -16.8, -16.7997, -16.7997, -16.8), strict=True)]
        return {"type": "Feature", "id": number, "properties": {"building": "yes", "height": "10"},
                "geometry": {"type": "Polygon", "coordinates": [ring]}}  # fmt: skip

    cities = []
    for middle in (100.0, 180.0):
        file = tmp_path / f"{middle:g}.geojson"
        features = [feature(1, middle - 0.0005), feature(2, middle + 0.0002)]
        file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
        cities.append(load_buildings(file))
    (one, here), (other, there) = cities
    assert np.allclose(one.bounds, other.bounds, atol=1e-3)
    assert wrap_longitude(there.lon_deg - here.lon_deg) == pytest.approx(80.0)


@given(st.sampled_from([0.0, 1e-9, -3e-8, 4e-5]), st.sampled_from([0.0, -2e-9, 6e-8, 1e-4]), st.floats(-1e-2, 1e-2),
       st.floats(-1e-2, 1e-2))  # fmt: skip
def test_no_point_has_latitude_and_longitude_0(lat: float, lon: float, east_m: float, north_m: float) -> None:
    """Neither rounded nor truncated to 1e-7 degrees; it is moved by 17 mm at most."""
    origin = Origin(lat, lon)
    for aside in (0.0, 1.0):  # over 0, 0, and where that is
        to = origin.enu_of(0.0, 0.0)
        east, north = east_m + aside * to[0], north_m + aside * to[1]
        found = origin.geodetic_of(east, north)
        assert (int(found[0] * 1e7), int(found[1] * 1e7)) != (0, 0)
        assert (round(found[0] * 1e7), round(found[1] * 1e7)) != (0, 0)
        back = origin.enu_of(*found)
        assert np.hypot(back[0] - east, back[1] - north) < 0.035
