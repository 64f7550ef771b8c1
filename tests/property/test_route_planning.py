"""Are routes clear of buildings and the quickest of their lattice, and is it said where there is none?"""

from __future__ import annotations

import heapq
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.planning.lattice import NO_WAY, raise_field, search
from skyrange.planning.limits import Costs, Limits, NoRouteError
from skyrange.planning.routes import find_route
from skyrange.planning.sampling import Sampling
from skyrange.world.airframes import AIRFRAMES

BLOCKS = st.lists(
    st.tuples(
        st.integers(-120, 120), st.integers(-120, 120), st.integers(6, 60), st.integers(6, 60), st.integers(8, 90)
    ),
    min_size=1,
    max_size=14,
)
COSTS = st.builds(
    Costs,
    st.floats(2, 10),
    st.tuples(st.floats(-8, 8), st.floats(-8, 8), st.just(0.0)),
    st.sampled_from([None, AIRFRAMES["iris"].power_for, AIRFRAMES["hummingbird"].power_for]),
)
PLACE = st.tuples(st.floats(-150, 150), st.floats(-150, 150))


def city_of(blocks: list[tuple[int, int, int, int, int]]) -> City:
    import shapely

    return City(
        [
            Building(f"b{k}", float(high), shapely.box(east, north, east + wide, north + deep))
            for k, (east, north, wide, deep, high) in enumerate(blocks)
        ],
        "test",
    )


@settings(deadline=None)
@given(
    blocks=BLOCKS,
    start=PLACE,
    goal=PLACE,
    clearance_m=st.floats(1, 12),
    costs=COSTS,
    sampling=st.none() | st.builds(Sampling, st.just(800), st.integers(0, 9)),
)
def test_a_route_keeps_its_clearance_and_its_heights(
    blocks: list[tuple[int, int, int, int, int]],
    start: tuple[float, float],
    goal: tuple[float, float],
    clearance_m: float,
    costs: Costs,
    sampling: Sampling | None,
) -> None:
    city = city_of(blocks)
    limits = Limits(alt_m=20.0, ceiling_m=60.0, clearance_m=clearance_m, costs=costs)
    try:
        route = find_route(city, [start, goal], limits, sampling)
    except NoRouteError:
        assume(False)
    assert route[0] == (*start, 20.0)
    assert route[-1] == (*goal, 20.0)
    assert all(20.0 <= up <= 60.0 for _, _, up in route)
    assert city.is_clear(route, clearance_m - 1e-6), city.first_obstruction(route, clearance_m)


MOVES = [(0, r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0)] + [(1, 0, 0), (-1, 0, 0)]
TOPS = st.lists(st.sampled_from([0.0, 0.0, 18.0, 30.0, 90.0]), min_size=9, max_size=9)


def oracle(field: NDArray[np.float64], heights: NDArray[np.float64], start: int, goal: int, costs: Costs) -> float:
    """The least cost by Dijkstra's algorithm, written from the rules; infinite without a way."""
    rows, columns = field.shape
    plane = rows * columns

    def is_free(layer: int, row: int, column: int) -> bool:
        return bool(field[row, column] == 0.0 or field[row, column] + 5.0 <= heights[layer])

    best = {start: 0.0}
    heap = [(0.0, start)]
    while heap:
        cost, state = heapq.heappop(heap)
        if state == goal:
            return cost
        if cost > best[state]:
            continue
        layer, row, column = state // plane, state % plane // columns, state % columns
        for dl, dr, dc in [(0, r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if (r, c) != (0, 0)] + [
            (1, 0, 0),
            (-1, 0, 0),
        ]:
            to = layer + dl, row + dr, column + dc
            if not (0 <= to[0] < len(heights) and 0 <= to[1] < rows and 0 <= to[2] < columns) or not is_free(*to):
                continue
            step = costs.of((0.0, 0.0, heights[layer]), (3.0 * dc, 3.0 * dr, heights[to[0]]))
            other = to[0] * plane + to[1] * columns + to[2]
            if cost + step < best.get(other, math.inf):
                best[other] = cost + step
                heapq.heappush(heap, (cost + step, other))
    return math.inf


def cost_of(way: NDArray[np.int64], heights: NDArray[np.float64], shape: tuple[int, int], costs: Costs) -> float:
    total = 0.0
    plane = shape[0] * shape[1]
    for one, other in pairwise(way.tolist()):
        dr, dc = other % plane // shape[1] - one % plane // shape[1], other % shape[1] - one % shape[1]
        total += costs.of((0.0, 0.0, heights[one // plane]), (3.0 * dc, 3.0 * dr, heights[other // plane]))
    return total


@settings(deadline=None)
@given(
    field=st.lists(TOPS, min_size=7, max_size=7),
    ends=st.tuples(st.integers(0, 62), st.integers(0, 62)),
    costs=COSTS,
)
def test_the_way_is_the_cheapest_of_the_lattice(field: list[list[float]], ends: tuple[int, int], costs: Costs) -> None:
    tops, heights = np.array(field), np.array([20.0, 25.0, 30.0, 35.0])
    start, goal = ends
    for end in ends:
        tops.flat[end] = 0.0
    done, way = search(tops, 3.0, heights, 5.0, start, goal, costs.paces(), 10_000)
    least = oracle(tops, heights, start, goal, costs)
    if math.isinf(least):
        assert done == NO_WAY
        return
    assert (way[0], way[-1]) == (start, goal)
    assert cost_of(way, heights, tops.shape, costs) == pytest.approx(least)


@settings(deadline=None)
@given(blocks=BLOCKS, reach_m=st.floats(0.5, 15))
def test_the_field_has_the_highest_roof_within_reach(
    blocks: list[tuple[int, int, int, int, int]], reach_m: float
) -> None:
    city = city_of(blocks)
    field = raise_field(city.walls(), -60.0, -60.0, 11.0, 12, 12, reach_m)
    for row in range(12):
        for column in range(12):
            east, north = -60.0 + 11.0 * column, -60.0 + 11.0 * row
            least, most = (  # what is as far away as the reach, to a rounding error, may count or not
                max((building.height_m for building in city.obstacles_within(east, north, reach_m + more)), default=0.0)
                for more in (-1e-9, 1e-9)
            )
            assert field[row, column] in (least, most)


def test_it_is_said_who_is_in_the_way_and_what_would_be_free() -> None:
    wall = city_of([(0, -400, 20, 800, 70)])
    with pytest.raises(NoRouteError, match=r"leg 1: b0, 70 m high, is in the way.* below 60 m; there is one at 75 m"):
        find_route(wall, [(-50, 0), (60, 0)], Limits(alt_m=20, ceiling_m=60))
    over = find_route(wall, [(-50, 0), (60, 0)], Limits(alt_m=20, ceiling_m=80))
    assert max(up for _, _, up in over) == 75.0
    with pytest.raises(
        NoRouteError, match=r"leg 2 ends at \(10, 0\) m, nearer than 5 m to a building 70 m high; .* 75"
    ):
        find_route(wall, [(-50, 0), (-50, 50), (10, 0)], Limits(alt_m=20, ceiling_m=60))


def test_without_a_city_the_way_is_straight() -> None:
    assert find_route(None, [(0, 0), (9, 9)], Limits(30, 60)) == [(0, 0, 30), (9, 9, 30)]
