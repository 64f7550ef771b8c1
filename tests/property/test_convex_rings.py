"""Are rings of corners told convex as GEOS tells them, and are volumes as arrays where their outlines are?"""

from __future__ import annotations

import math

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from skyrange.core.volumes import Volume4D
from skyrange.utm.airspace.solids import is_convex, solids_of

PLACES = st.tuples(st.floats(-170.0, 170.0), st.floats(-80.0, 80.0))
CORNERS = st.lists(st.tuples(st.integers(-50, 50), st.integers(-50, 50)), min_size=3, max_size=8, unique=True)


def ring_at(place: tuple[float, float], corners: list[tuple[float, float]]) -> np.ndarray:
    """Corners in thousandths of a degree around a place, as longitude and latitude."""
    return np.array([(place[0] + east * 1e-3, place[1] + north * 1e-3) for east, north in corners])


@given(PLACES, CORNERS, st.booleans())
def test_a_hull_is_convex_wherever_it_is_and_whichever_way_round(
    place: tuple[float, float], corners: list[tuple[float, float]], backwards: bool
) -> None:
    hull = shapely.MultiPoint(corners).convex_hull
    if not isinstance(hull, shapely.Polygon):
        return  # all in a line
    around = list(hull.exterior.coords)[:-1]
    assert is_convex(ring_at(place, around[::-1] if backwards else around), len(around))


@given(PLACES, st.floats(0.05, 0.95))
def test_a_square_with_a_dent_is_not_convex(place: tuple[float, float], depth: float) -> None:
    dented = [(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (10.0, 20.0 - 20.0 * depth), (0.0, 20.0)]
    assert not is_convex(ring_at(place, dented), 5)
    assert is_convex(ring_at(place, [*dented[:3], dented[4]]), 4)


def test_a_star_whose_corners_turn_one_way_is_not_convex() -> None:
    star = [(math.cos(0.8 * math.pi * k), math.sin(0.8 * math.pi * k)) for k in range(5)]
    assert not is_convex(ring_at((10.0, 50.0), [(30.0 * east, 30.0 * north) for east, north in star]), 5)


@given(PLACES, st.integers(1, 90), st.integers(1, 90))
def test_volumes_are_boxes_of_longitude_and_latitude(place: tuple[float, float], wide: int, high: int) -> None:
    ring = ring_at(place, [(0, 0), (wide, 0), (wide, high), (0, high)])
    outline = tuple((float(lat), float(lon)) for lon, lat in ring)
    (box,) = solids_of([Volume4D(outline, 10.0, 20.0, 3, 4)]).boxes
    assert tuple(box) == (ring[:, 0].min(), ring[:, 1].min(), ring[:, 0].max(), ring[:, 1].max())
