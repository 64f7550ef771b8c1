"""Does a city know where its walls are, and does a generated one keep to its promises?"""

from __future__ import annotations

import copy

import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.city.downtown import downtown_grid
from skyrange.core.errors import InputError

TOWER = Building("tower", 50.0, shapely.box(10, 10, 20, 20))
HALL = Building("hall", 10.0, shapely.box(5, 5, 40, 40).difference(shapely.box(25, 25, 35, 35)))
BRIDGE = Building("bridge", 30.0, shapely.box(60, 0, 70, 10), base_m=20.0)
CITY = City([HALL, TOWER, BRIDGE], "by hand")


def test_points() -> None:
    assert CITY.bounds == (5.0, 0.0, 70.0, 40.0)
    assert CITY.inside(15, 15) is TOWER  # the taller of two
    assert CITY.inside(6, 6) is HALL
    assert CITY.inside(6, 6, 10.0) is None  # on its roof
    assert CITY.inside(30, 30) is None  # its courtyard
    assert CITY.inside(10, 15) is TOWER  # a wall counts
    assert CITY.inside(65, 5) is None  # under the bridge
    assert CITY.inside(65, 5, 25.0) is BRIDGE
    assert (CITY.height_at(15, 15), CITY.height_at(6, 6), CITY.height_at(0, 0)) == (50.0, 10.0, 0.0)


def test_obstacles_within_a_radius() -> None:
    assert CITY.obstacles_within(0, 5, 5.0) == [HALL]
    assert CITY.obstacles_within(0, 5, 4.9) == []
    assert CITY.obstacles_within(50, 20, 40.0) == [HALL, TOWER, BRIDGE]


@pytest.mark.parametrize(
    ("path", "margin_m", "first"),
    [
        ([(0, 15, 5), (50, 15, 5)], 0.0, HALL),
        ([(50, 15, 20), (0, 15, 20)], 0.0, TOWER),  # above the hall
        ([(0, 15, 51), (50, 15, 51)], 0.0, None),  # above the tower
        ([(0, 15, 51), (50, 15, 51)], 2.0, TOWER),  # but too near to its roof
        ([(0, 3, 20), (50, 3, 20)], 0.0, None),
        ([(0, 8, 20), (50, 8, 20)], 2.0, TOWER),  # beside its wall
        ([(0, 8, 20), (50, 8, 20)], 1.9, None),
        ([(0, 15, 60), (0, 15, 5), (0, 30, 5)], 4.0, None),
        ([(0, 15, 60), (50, 15, 5)], 0.0, HALL),  # a descending leg counts with its lowest point
        ([(50, 5, 5), (80, 5, 5)], 1.0, None),  # under the bridge
        ([(50, 5, 19.5), (80, 5, 19.5)], 1.0, BRIDGE),  # under it, but too near
        ([(50, 5, 5), (80, 5, 25)], 1.0, BRIDGE),
        ([(80, 5, 25), (50, 5, 25), (0, 5, 5)], 1.0, BRIDGE),  # first along the path
        ([(15, 15, 5)], 0.0, HALL),
        ([(0, 0, 5)], 1.0, None),
        ([(15, 15, 60), (15, 15, 45)], 1.0, TOWER),  # straight down
        ([], 1.0, None),
    ],
)
def test_paths(path: list[tuple[float, float, float]], margin_m: float, first: Building | None) -> None:
    assert CITY.first_obstruction(path, margin_m) is first
    assert CITY.is_clear(path, margin_m) is (first is None)


def test_deep_copy_is_the_city_itself() -> None:
    assert copy.deepcopy({"city": CITY})["city"] is CITY


def test_impossible_buildings_and_empty_cities_are_refused() -> None:
    with pytest.raises(ValueError, match="base_m"):
        Building("x", 5.0, TOWER.shape, base_m=5.0)
    with pytest.raises(ValueError, match="at least one"):
        City([], "nowhere")


def test_downtown_keeps_to_its_measures() -> None:
    city = downtown_grid((4, 2), (20.0, 90.0), seed=5, street_m=20.0, block_m=60.0)
    assert len(city) == 4 * 2 * 4
    assert city.bounds == (-150.0, -70.0, 150.0, 70.0)
    heights = [building.height_m for building in city.buildings]
    assert min(heights) >= 20.0
    assert max(heights) <= 90.0
    assert len(set(heights)) > 16
    for street_m in (-80.0, 0.0, 80.0):  # the middles of the streets, to within a metre of their edges
        assert city.is_clear([(street_m, -200.0, 1.0), (street_m, 200.0, 1.0)], 9.0)
    shapes = [building.shape for building in city.buildings]
    assert shapely.union_all(shapes).area == pytest.approx(sum(shape.area for shape in shapes))


def test_downtown_is_addressed_by_seed_and_place() -> None:
    def tops(city: City) -> dict[str, float]:
        return {building.id: building.height_m for building in city.buildings}

    small, large, other = downtown_grid((2, 2), seed=1), downtown_grid((3, 5), seed=1), downtown_grid((2, 2), seed=2)
    assert tops(small).items() <= tops(large).items()
    assert tops(small) != tops(other)
    assert tops(downtown_grid((2, 2), seed=1)) == tops(small)


def test_downtown_refuses_all_that_is_wrong_at_once() -> None:
    with pytest.raises(InputError) as caught:
        downtown_grid((0, 3), (50.0, 20.0), street_m=-1.0, block_m=float("nan"))
    assert [fault.where for fault in caught.value.problems] == ["blocks", "height_m", "street_m", "block_m"]
