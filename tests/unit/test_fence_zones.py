"""Inside or outside of polygons and circles: AC_PolyFence_loader.cpp `breached`, against shapely."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Point, Polygon

from skyrange.vehicle.builtin.fence import zone_breach
from skyrange.vehicle.builtin.layout import CIRCLE_IN, CIRCLE_OUT, POLYGON_IN, POLYGON_OUT, ZONES

SQUARE = [(-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)]


def zones(*parts: tuple[int, list[tuple[float, float]], float]) -> Any:
    record = np.zeros(1, dtype=ZONES)[0]
    points = 0
    for number, (kind, places, radius) in enumerate(parts):
        record["kind"][number] = kind
        record["first"][number] = points
        record["size"][number] = len(places)
        record["radius"][number] = radius
        for place in places:
            record["point"][points] = place
            points += 1
    record["count"] = len(parts)
    return record


def square(kind: int, east: float = 0.0) -> tuple[int, list[tuple[float, float]], float]:
    return kind, [(e + east, n) for e, n in SQUARE], 0.0


def circle(kind: int, east: float, radius: float) -> tuple[int, list[tuple[float, float]], float]:
    return kind, [(east, 0.0)], radius


def test_nothing_is_never_breached() -> None:
    assert zone_breach(zones(), 1e6, 0.0, False) == (False, 0.0)


@pytest.mark.parametrize(
    ("parts", "east", "union", "broken", "far"),
    [
        ([square(POLYGON_IN)], 0.0, False, False, -10.0),
        ([square(POLYGON_IN)], 12.0, False, True, 2.0),
        ([square(POLYGON_OUT)], 7.0, False, True, 3.0),
        ([square(POLYGON_OUT)], 15.0, False, False, -5.0),
        ([circle(CIRCLE_IN, 0.0, 5.0)], 4.0, False, False, -1.0),
        ([circle(CIRCLE_IN, 0.0, 5.0)], 7.0, False, True, 2.0),
        ([circle(CIRCLE_OUT, 0.0, 5.0)], 4.0, False, True, 1.0),
        ([circle(CIRCLE_OUT, 0.0, 5.0)], 8.0, False, False, -3.0),
        # all inclusion zones, unless any will do
        ([square(POLYGON_IN), square(POLYGON_IN, 15.0)], 8.0, False, False, -2.0),
        ([square(POLYGON_IN), square(POLYGON_IN, 15.0)], 0.0, False, True, 5.0),
        ([square(POLYGON_IN), square(POLYGON_IN, 15.0)], 0.0, True, False, 5.0),
        ([square(POLYGON_IN), circle(CIRCLE_IN, 30.0, 5.0)], 30.0, True, False, 20.0),
        ([square(POLYGON_IN), circle(CIRCLE_IN, 30.0, 5.0)], 18.0, True, True, 8.0),
        # an exclusion zone counts either way
        ([square(POLYGON_IN), circle(CIRCLE_OUT, 0.0, 3.0)], 1.0, True, True, 2.0),
    ],
)
def test_zones(parts: list[Any], east: float, union: bool, broken: bool, far: float) -> None:
    is_broken, distance_m = zone_breach(zones(*parts), east, 0.0, union)
    assert is_broken == broken
    assert distance_m == pytest.approx(far)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.integers(-40, 40), st.integers(-40, 40)), min_size=3, max_size=9, unique=True),
    st.floats(-45, 45),
    st.floats(-45, 45),
)
def test_against_shapely(corners: list[tuple[int, int]], east: float, north: float) -> None:
    shape = Polygon(corners)
    place = Point(east, north)
    if not shape.is_valid or shape.exterior.distance(place) < 1e-6:
        return  # crossing edges, or on the edge
    broken, far = zone_breach(zones((POLYGON_IN, [(float(e), float(n)) for e, n in corners], 0.0)), east, north, False)
    assert broken == (not shape.contains(place))
    assert abs(far) == pytest.approx(shape.exterior.distance(place), abs=1e-9)
