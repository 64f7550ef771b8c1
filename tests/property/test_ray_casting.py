"""Do rays meet what geometry says, whatever the grid, the order of the rays and the other rays of a batch?"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from skyrange.city.buildings import Building
from skyrange.city.downtown import downtown_grid
from skyrange.city.wall_index import build_wall_index
from skyrange.core.arrays import Floats
from skyrange.core.errors import InputError
from skyrange.optics.ray_casting import AIRCRAFT, BUILDING, GROUND, NONE, Hits, Rays, cast_rays
from skyrange.optics.ray_index import build_ray_index
from skyrange.optics.targets import Targets, place_targets
from tests.tiers import examples

REACH_M = 300.0
EXACT_M = 1e-9
ANGLE = st.floats(-math.pi, math.pi)


def make_rays(origin: Floats, direction: Floats, delay_s: Floats | None = None, own: int = -1) -> Rays:
    """Rays from one origin (3,) or one each (n, 3), at the start of the scan unless `delay_s` (n,) says when."""
    count = len(direction)
    origins = np.ascontiguousarray(np.broadcast_to(np.asarray(origin, dtype=np.float64), (count, 3)))
    delays = np.zeros(count) if delay_s is None else np.ascontiguousarray(delay_s, dtype=np.float64)
    directions = np.ascontiguousarray(direction, dtype=np.float64)
    return Rays(origins, directions, delays, np.full(count, own, dtype=np.int32))


def point_at(azimuth: float, elevation: float) -> Floats:
    """The unit vector in a direction, clockwise from north and up."""
    level = math.cos(elevation)
    return np.array([level * math.sin(azimuth), level * math.cos(azimuth), math.sin(elevation)])


def choose(rays: Rays, order: NDArray[np.int64]) -> Rays:
    """Some of the rays, in an order."""
    return Rays(rays.origin[order], rays.direction[order], rays.delay_s[order], rays.own[order])


def draw_directions(rng: np.random.Generator, count: int) -> Floats:
    """Directions spread evenly over the sphere, of which some are exactly along an axis."""
    vectors = rng.normal(size=(count, 3))
    vectors[: count // 8] = np.sign(vectors[: count // 8]) * np.eye(3)[rng.integers(0, 3, count // 8)]
    return np.asarray(vectors / np.sqrt((vectors**2).sum(axis=1))[:, None])


def draw_buildings(rng: np.random.Generator, count: int) -> list[Building]:
    """Turned and plain blocks, some with a courtyard, some with a raised base, some in each other; and two in parts."""
    buildings = []
    for k in range(count):
        east, north = rng.uniform(-80.0, 80.0, 2).round(1)
        wide, deep, top = rng.uniform(4.0, 40.0), rng.uniform(4.0, 40.0), rng.uniform(5.0, 60.0)
        shape = shapely.box(-wide, -deep, wide, deep)
        if k % 3 == 0:
            shape = shape.difference(shapely.box(-0.5 * wide, -0.4 * deep, 0.3 * wide, 0.6 * deep))
        if k % 4 == 1:
            shape = shapely.union_all([shape, shapely.affinity.translate(shape, 3.0 * wide, 0.0)])
        if k % 2:
            shape = shapely.affinity.rotate(shape, float(rng.uniform(0.0, 90.0)))
        base = float(rng.uniform(1.0, 0.9 * top)) if k % 5 == 2 else 0.0
        buildings.append(Building(f"b{k}", float(top), shapely.affinity.translate(shape, east, north), base_m=base))
    return buildings


def cast_by_hand(buildings: list[Building], targets: Targets, rays: Rays) -> Hits:
    """Every ray against every wall, roof, base and cylinder, by shapely and by quadratics of their own."""
    count = len(rays.direction)
    hits = Hits(np.full(count, math.inf), np.zeros(count, np.uint8), np.full(count, -1, np.int32), np.zeros(count))
    for i in range(count):
        origin, direction = rays.origin[i], rays.direction[i]
        found: list[tuple[float, int, int, float]] = []
        if direction[2] < 0.0 <= origin[2]:
            found.append((-origin[2] / direction[2], GROUND, -1, abs(direction[2])))
        for b, building in enumerate(buildings):
            for along in [(level - origin[2]) / direction[2] for level in (building.base_m, building.height_m)
                          if direction[2] != 0.0 and level > 0.0]:  # fmt: skip
                place = shapely.Point(*(origin + along * direction)[:2])
                if along >= 0.0 and shapely.contains(building.shape, place):
                    found.append((along, BUILDING, b, abs(direction[2])))
            for polygon in building.shape.geoms if building.shape.geom_type == "MultiPolygon" else [building.shape]:
                for ring in (polygon.exterior, *polygon.interiors):
                    corners = shapely.get_coordinates(ring)
                    for one, two in pairwise(corners):
                        wall = two - one
                        matrix = np.column_stack([direction[:2], -wall])
                        if abs(np.linalg.det(matrix)) < 1e-12:
                            continue
                        along, share = np.linalg.solve(matrix, one - origin[:2])
                        height = origin[2] + along * direction[2]
                        if along >= 0.0 and 0.0 <= share <= 1.0 and building.base_m <= height <= building.height_m:
                            normal = np.array([wall[1], -wall[0]]) / math.hypot(*wall)
                            found.append((along, BUILDING, b, abs(float(direction[:2] @ normal))))
        for j in range(len(targets.position)):
            if j == rays.own[i]:
                continue
            place = targets.position[j] + rays.delay_s[i] * targets.velocity[j]
            found += meet_by_hand(origin - place, direction, float(targets.radius[j]), float(targets.height[j]), j)
        found = [one for one in found if one[0] <= REACH_M]
        if found:
            hits.distance_m[i], hits.kind[i], hits.row[i], hits.cosine[i] = min(found)
    return hits


def meet_by_hand(
    origin: Floats, direction: Floats, radius: float, height: float, j: int
) -> list[tuple[float, int, int, float]]:
    """All points in which a ray meets the side, the top and the bottom of an upright cylinder at the origin."""
    found = []
    for level in (0.0, height):
        if direction[2] != 0.0:
            along = (level - origin[2]) / direction[2]
            if along >= 0.0 and math.hypot(*(origin + along * direction)[:2]) <= radius:
                found.append((along, AIRCRAFT, j, abs(float(direction[2]))))
    a, b = direction[:2] @ direction[:2], direction[:2] @ origin[:2]
    root = b * b - a * (origin[:2] @ origin[:2] - radius * radius)
    if a > 0.0 and root >= 0.0:
        for along in ((-b - math.sqrt(root)) / a, (-b + math.sqrt(root)) / a):
            point = origin + along * direction
            if along >= 0.0 and 0.0 <= point[2] <= height:
                found.append((along, AIRCRAFT, j, abs(float(direction[:2] @ point[:2])) / radius))
    return found


@settings(deadline=None, max_examples=examples(20))
@given(seed=st.integers(0, 2**32), cell_m=st.sampled_from([3.0, 12.0, 40.0, 500.0]))
def test_the_grid_gives_what_all_surfaces_give(seed: int, cell_m: float) -> None:
    rng = np.random.default_rng(seed)
    buildings = draw_buildings(rng, 7)
    index = build_ray_index(build_wall_index(buildings), cell_m)
    position = np.column_stack([rng.uniform(-120.0, 120.0, (12, 2)), rng.uniform(0.0, 70.0, 12)])
    moving = rng.normal(0.0, 20.0, (12, 3))
    targets = place_targets(
        index, position, moving, rng.uniform(0.2, 15.0, 12), rng.uniform(0.1, 10.0, 12), during_s=0.5
    )
    count = 64
    origin = np.column_stack([rng.uniform(-200.0, 200.0, (count, 2)), rng.uniform(-1.0, 80.0, count)])
    own = rng.integers(-1, 12, count).astype(np.int32)
    rays = Rays(origin, draw_directions(rng, count), rng.uniform(0.0, 0.5, count), own)
    hits, expected = cast_rays(index, rays, REACH_M, targets), cast_by_hand(buildings, targets, rays)
    assert hits.kind.tolist() == expected.kind.tolist()
    assert hits.row.tolist() == expected.row.tolist()
    near = np.isfinite(expected.distance_m)
    assert np.array_equal(np.isfinite(hits.distance_m), near)
    assert hits.distance_m[near] == pytest.approx(expected.distance_m[near], abs=1e-8)
    assert hits.cosine == pytest.approx(expected.cosine, abs=1e-6)


@settings(deadline=None, max_examples=examples(20))
@given(seed=st.integers(0, 2**32))
def test_no_result_depends_on_the_batch_the_order_or_the_cells(seed: int) -> None:
    rng = np.random.default_rng(seed)
    city = downtown_grid((4, 4), seed=seed % 97)
    index = build_ray_index(city.walls())
    count = 500
    origin = np.column_stack([rng.uniform(-220.0, 220.0, (count, 2)), rng.uniform(0.0, 100.0, count)])
    rays = Rays(origin, draw_directions(rng, count), np.zeros(count), np.full(count, -1, dtype=np.int32))
    position = np.column_stack([rng.uniform(-190.0, 190.0, (30, 2)), rng.uniform(5.0, 60.0, 30)])
    shape = (np.zeros((30, 3)), np.full(30, 3.0), np.full(30, 1.0))
    targets = place_targets(index, position, *shape)
    whole = cast_rays(index, rays, REACH_M, targets)
    order = rng.permutation(count)
    shuffled = cast_rays(index, choose(rays, order), REACH_M, targets)
    alone = [cast_rays(index, choose(rays, np.array([i])), REACH_M, targets) for i in range(20)]
    coarse = build_ray_index(city.walls(), 90.0)
    other = cast_rays(coarse, rays, REACH_M, place_targets(coarse, position, *shape))
    for name in Hits._fields:
        values = getattr(whole, name)
        assert getattr(shuffled, name).tobytes() == values[order].tobytes()
        assert b"".join(getattr(hits, name).tobytes() for hits in alone) == values[:20].tobytes()
        assert getattr(other, name).tobytes() == values.tobytes()


@settings(deadline=None, max_examples=examples(100))
@given(azimuth=ANGLE, down=st.floats(0.01, 1.57), up_m=st.floats(0.0, 200.0))
def test_the_ground_is_a_plane(azimuth: float, down: float, up_m: float) -> None:
    direction = point_at(azimuth, -down)
    hits = cast_rays(build_ray_index(), make_rays(np.array([5.0, -3.0, up_m]), direction[None]), math.inf)
    assert hits.kind.tolist() == [GROUND]
    assert hits.distance_m[0] == pytest.approx(up_m / math.sin(down), rel=1e-12)
    assert hits.cosine[0] == pytest.approx(math.sin(down), rel=1e-12)


@settings(deadline=None, max_examples=examples(100))
@given(turn=ANGLE, east=st.floats(-900, 900), north=st.floats(-900, 900), azimuth=ANGLE, away=st.floats(20.0, 80.0))
def test_a_turned_box_is_met_on_its_nearest_side(
    turn: float, east: float, north: float, azimuth: float, away: float
) -> None:
    shape = shapely.affinity.rotate(shapely.box(-5.0, -8.0, 5.0, 8.0), math.degrees(turn), origin=(0.0, 0.0))
    box = Building("box", 30.0, shapely.affinity.translate(shape, east, north))
    to_middle = point_at(azimuth, 0.0)
    origin = np.array([east, north, 12.0]) - away * to_middle
    hits = cast_rays(build_ray_index(build_wall_index([box])), make_rays(origin, to_middle[None]), 100.0)
    # in the frame of the box the ray enters at the slab that it leaves the box's outside through last
    across = to_middle[0] * math.cos(turn) + to_middle[1] * math.sin(turn)
    along = to_middle[1] * math.cos(turn) - to_middle[0] * math.sin(turn)
    sides = {5.0 / max(abs(across), 1e-300): abs(across), 8.0 / max(abs(along), 1e-300): abs(along)}
    inside_m = min(sides)
    assert hits.distance_m[0] == pytest.approx(away - inside_m, abs=EXACT_M * 100)
    if abs(5.0 * abs(along) - 8.0 * abs(across)) > 1e-6:  # not exactly at an edge
        assert hits.cosine[0] == pytest.approx(sides[inside_m], abs=1e-6)


@settings(deadline=None, max_examples=examples(100))
@given(azimuth=ANGLE, elevation=st.floats(-1.5, 1.5), x=st.floats(-8, 8), y=st.floats(-8, 8), z=st.floats(0.5, 19.5))
def test_a_courtyard_is_a_corner_of_planes(azimuth: float, elevation: float, x: float, y: float, z: float) -> None:
    ring = shapely.box(-20.0, -20.0, 20.0, 20.0).difference(shapely.box(-9.0, -9.0, 9.0, 9.0))
    index = build_ray_index(build_wall_index([Building("ring", 20.0, ring)]))
    direction = point_at(azimuth, elevation)
    hits = cast_rays(index, make_rays(np.array([x, y, z]), direction[None]), 1e4)
    planes = [
        (math.copysign(9.0, direction[a]) - (x, y)[a]) / direction[a] for a in range(2) if abs(direction[a]) > 1e-12
    ]
    nearest = min(planes)
    height = z + nearest * direction[2]
    if height < 0.0:
        assert hits.kind.tolist() == [GROUND]
        assert hits.distance_m[0] == pytest.approx(-z / direction[2], abs=EXACT_M)
    elif height < 20.0 - 1e-6:
        assert (hits.kind.tolist(), hits.row.tolist()) == ([BUILDING], [0])
        assert hits.distance_m[0] == pytest.approx(nearest, abs=EXACT_M)
    elif height > 20.0 + 1e-6:
        assert hits.kind.tolist() == [NONE]


@settings(deadline=None, max_examples=examples(30))
@given(azimuth=ANGLE, elevation=st.floats(-1.2, 1.2), aside=st.floats(0.0, 0.7), around=ANGLE)
def test_thin_cylinders_make_a_sphere(azimuth: float, elevation: float, aside: float, around: float) -> None:
    """Of 4,000 discs of 0.5 mm, each as wide as the sphere of 1 m at its middle; they overlap a little, so that
    rounding leaves no gap."""
    index, count, thin_m = build_ray_index(), 4_000, 0.0005
    heights = -1.0 + thin_m * np.arange(count)
    middle = heights + 0.5 * thin_m
    bottom = np.column_stack([np.zeros((count, 2)), 50.0 + heights])
    sphere = place_targets(index, bottom, np.zeros((count, 3)), np.sqrt(1.0 - middle**2), np.full(count, 1.01 * thin_m))
    direction = point_at(azimuth, elevation)
    right = np.array([math.cos(azimuth), -math.sin(azimuth), 0.0])
    over = np.cross(right, direction)
    centre = np.array([0.0, 0.0, 50.0])
    off = aside * (math.cos(around) * right + math.sin(around) * over)
    hits = cast_rays(index, make_rays(centre + off - 10.0 * direction, direction[None]), 100.0, sphere)
    assert hits.kind.tolist() == [AIRCRAFT]
    assert hits.distance_m[0] == pytest.approx(10.0 - math.sqrt(1.0 - aside * aside), abs=1e-3)


def test_an_aircraft_moves_while_the_scan_lasts_and_its_own_sensor_sees_through_it() -> None:
    index = build_ray_index(downtown_grid((2, 2)).walls())
    position = np.array([[0.0, 50.0, 30.0], [0.0, 0.0, 30.0]])
    targets = place_targets(
        index,
        position,
        np.array([[0.0, -100.0, 0.0], [0.0, 0.0, 0.0]]),
        np.full(2, 0.4),
        np.full(2, 0.25),
        during_s=0.1,
    )
    delay = np.array([0.0, 0.05, 0.1])
    rays = make_rays(np.array([0.0, 0.0, 30.1]), np.tile([0.0, 1.0, 0.0], (3, 1)), delay, own=1)
    hits = cast_rays(index, rays, 100.0, targets)
    assert hits.row.tolist() == [0, 0, 0]
    assert hits.distance_m == pytest.approx([49.6, 44.6, 39.6], abs=EXACT_M)
    seen_by_all = cast_rays(index, rays._replace(own=np.full(3, -1, dtype=np.int32)), 100.0, targets)
    assert seen_by_all.distance_m == pytest.approx(0.4, abs=EXACT_M)


def test_a_ray_passes_under_a_bridge_and_meets_its_sides_and_its_base() -> None:
    bridge = Building("bridge", 20.0, shapely.box(-10.0, 30.0, 10.0, 36.0), base_m=12.0)
    index = build_ray_index(build_wall_index([bridge]))
    forward, up = np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    distances = [
        cast_rays(index, make_rays(np.array([0.0, 0.0, z]), forward), 90.0).distance_m[0] for z in (11, 15, 21)
    ]
    assert distances == [math.inf, 30.0, math.inf]
    assert cast_rays(index, make_rays(np.array([0.0, 33.0, 2.0]), up), 90.0).distance_m[0] == 10.0
    assert cast_rays(index, make_rays(np.array([0.0, 33.0, 50.0]), -up), 90.0).distance_m[0] == 30.0
    aslant = np.array([[0.0, 2.0, 1.0]]) / math.sqrt(5.0)  # below the foot of the wall, then up to the base behind it
    hits = cast_rays(index, make_rays(np.array([0.0, 29.0, 11.0]), aslant), 90.0)
    assert hits.distance_m[0] == pytest.approx(math.sqrt(5.0), abs=EXACT_M)
    assert hits.cosine[0] == pytest.approx(1.0 / math.sqrt(5.0))


def test_an_aircraft_is_found_in_each_cell_that_it_crosses_during_the_scan() -> None:
    index = build_ray_index(downtown_grid((2, 2)).walls(), 2.0)
    one = np.ones(1)
    targets = place_targets(
        index, np.array([[-60.0, 0.0, 30.0]]), np.array([[400.0, 0.0, 0.0]]), 0.3 * one, one, during_s=0.3
    )
    delay = np.linspace(0.0, 0.3, 61)
    rays = make_rays(np.zeros(3), np.tile([0.0, 0.0, -1.0], (61, 1)), delay)
    origin = np.column_stack([-60.0 + 400.0 * delay, np.zeros(61), np.full(61, 40.0)])
    hits = cast_rays(index, rays._replace(origin=origin), 90.0, targets)
    assert hits.distance_m == pytest.approx(9.0, abs=EXACT_M)


def test_a_roof_is_found_where_cells_end_on_walls() -> None:
    """Walls on round metres and cells of whole metres: centres and edges of cells lie exactly on walls."""
    plain = [Building(f"{k}", 20.0, shapely.box(10.0 * k, 0.0, 10.0 * k + 6.0, 10.0)) for k in range(4)]
    for cell_m in (1.0, 2.0, 2.5, 4.0, 5.0):
        index = build_ray_index(build_wall_index(plain), cell_m)
        east = np.arange(-0.75, 40.0, 0.5)
        rays = make_rays(np.zeros(3), np.tile([0.0, 0.0, -1.0], (len(east), 1)))
        origin = np.column_stack([east, np.full(len(east), 5.0), np.full(len(east), 50.0)])
        hits = cast_rays(index, rays._replace(origin=origin), 100.0)
        inside = (east > 0.0) & (east % 10.0 < 6.0)
        assert hits.distance_m.tolist() == np.where(inside, 30.0, 50.0).tolist()


@pytest.mark.parametrize(
    ("change", "value"),
    [
        ({"direction": np.array([[0.0, 2.0, 0.0]])}, "0.0, 2.0, 0.0"),
        ({"direction": np.array([[np.nan, 0.0, 0.0]])}, "nan"),
        ({"origin": np.array([[np.inf, 0.0, 0.0]])}, "inf"),
        ({"delay_s": np.array([-0.1])}, "-0.1 s"),
        ({"delay_s": np.zeros(2)}, r"\(2,\)"),
    ],
)
def test_what_is_no_ray_is_refused(change: dict[str, Any], value: str) -> None:
    rays = make_rays(np.zeros(3), np.array([[0.0, 1.0, 0.0]]))._replace(**change)
    with pytest.raises(InputError, match=value):
        cast_rays(build_ray_index(), rays, 100.0)


def test_targets_of_another_grid_are_refused() -> None:
    one = np.ones(1)
    targets = place_targets(build_ray_index(), np.zeros((1, 3)), np.zeros((1, 3)), one, one)
    with pytest.raises(InputError, match="another grid"):
        cast_rays(build_ray_index(downtown_grid((2, 2)).walls()), make_rays(np.zeros(3), np.eye(3)), 10.0, targets)
    with pytest.raises(InputError, match="positive metres"):
        place_targets(build_ray_index(), np.zeros((1, 3)), np.zeros((1, 3)), 0.0 * one, one)
    with pytest.raises(InputError, match="not finite"):
        place_targets(build_ray_index(), np.full((1, 3), np.nan), np.zeros((1, 3)), one, one)
