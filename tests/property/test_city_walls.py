"""Do the flattened walls say what shapely says of the same buildings?"""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.city.buildings import Building
from skyrange.city.downtown import downtown_grid
from skyrange.city.wall_index import MARGIN_M, build_wall_index, cell_of, distance_to_box, distance_to_footprint
from skyrange.world.collision.broad_phase import floor_and_clearance
from tests.tiers import examples

_RING = shapely.box(-40.0, 60.0, 0.0, 100.0).difference(shapely.Point(-20.0, 80.0).buffer(12.0))
_PARTS = shapely.multipolygons([shapely.box(60.0, 60.0, 80.0, 90.0), shapely.box(90.0, 60.0, 95.0, 70.0)])
_ODD = shapely.Polygon([(-90, -90), (-60, -95), (-55, -60), (-70, -75), (-88, -50)])
BUILDINGS = [
    *downtown_grid((3, 2), seed=4).buildings,
    Building("ring", 25.0, _RING),
    Building("parts", 40.0, _PARTS),
    Building("odd", 12.0, _ODD),
    Building("bridge", 30.0, shapely.box(0.0, 120.0, 40.0, 126.0), base_m=15.0),
]
WALLS = build_wall_index(BUILDINGS)
PLACE = st.tuples(st.floats(-260, 260), st.floats(-260, 260))


@settings(deadline=None, max_examples=examples(300))
@given(place=PLACE, b=st.integers(0, len(BUILDINGS) - 1))
def test_footprints(place: tuple[float, float], b: int) -> None:
    point, shape = shapely.Point(place), BUILDINGS[b].shape
    inside, away, near_e, near_n = distance_to_footprint(WALLS, b, *place)
    edge = shapely.distance(shape.boundary, point)
    assert away == pytest.approx(edge, abs=1e-9)
    assert math.hypot(near_e - place[0], near_n - place[1]) == pytest.approx(away, abs=1e-9)
    if edge > 1e-9:
        assert inside == shapely.contains(shape, point)
    assert distance_to_box(WALLS, b, *place) == pytest.approx(
        shapely.distance(shapely.box(*shape.bounds), point), abs=1e-9
    )


@settings(deadline=None, max_examples=examples(300))
@given(place=PLACE)
def test_a_cell_lists_all_that_is_near(place: tuple[float, float]) -> None:
    near = {
        b for b, building in enumerate(BUILDINGS) if shapely.distance(building.shape, shapely.Point(place)) < MARGIN_M
    }
    cell = cell_of(WALLS, *place)
    listed = (
        set() if cell < 0 else set(WALLS.cell_buildings[WALLS.cell_start[cell] : WALLS.cell_start[cell + 1]].tolist())
    )
    assert near <= listed


@settings(deadline=None, max_examples=examples(300))
@given(place=PLACE, up=st.floats(0, 120), steps=st.lists(st.tuples(PLACE, st.floats(-1, 1)), max_size=5))
def test_free_is_no_more_than_the_way_to_anything(
    place: tuple[float, float], up: float, steps: list[tuple[tuple[float, float], float]]
) -> None:
    """Floor by shapely, and no place within the free distance touches a building or stands over another roof."""
    radius, height = 0.4, 0.25
    here = np.array([*place, up])
    floor, free = floor_and_clearance(WALLS, here, radius, height)

    def under(p: np.ndarray) -> float:
        tops = [
            b.height_m for b in BUILDINGS if shapely.intersects(b.shape, shapely.Point(p[:2])) and p[2] >= b.height_m
        ]
        return max(tops, default=0.0)

    def touches(p: np.ndarray) -> list[str]:
        return [
            b.id for b in BUILDINGS
            if shapely.distance(b.shape, shapely.Point(p[:2])) < radius - 1e-9
            and b.base_m - height < p[2] - 1e-9 and p[2] < b.height_m - 0.02 - 1e-9
        ]  # fmt: skip

    edges = [shapely.distance(b.shape.boundary, shapely.Point(place)) for b in BUILDINGS]
    if min(edges) > 1e-9 and all(abs(up - b.height_m) > 0.021 for b in BUILDINGS):
        assert floor == under(here)
    if touches(here):
        assert free == 0.0
    for (east, north), rise in steps:
        way = np.array([east, north, 100.0 * rise])
        there = here + way / max(float(np.linalg.norm(way)), 1e-9) * max(free - 1e-6, 0.0)
        if not touches(here) and there[2] >= floor - 0.02:  # the floor holds what falls on it
            assert touches(there) == [] or under(there) == floor > 0.0
            if free > 0.2500001:
                assert under(there) == floor or abs(there[2] - floor) < 0.03


def test_no_buildings_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        build_wall_index([])
