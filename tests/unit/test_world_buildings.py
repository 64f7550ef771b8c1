"""Do walls stop aircraft, roofs carry them, and gaps let them through?"""

from __future__ import annotations

import copy

import numpy as np
import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.contracts.mailboxes import Note
from skyrange.core.errors import InputError
from skyrange.world import AIRFRAMES, Body, World

QUANTUM_NS = 2_500_000
IRIS = AIRFRAMES["iris"]
FAR = shapely.box(500.0, 500.0, 510.0, 510.0)


def _city(*shapes: shapely.Geometry, height_m: float = 30.0, base_m: float = 0.0) -> City:
    return City([Building(f"b{i}", height_m, shape, base_m=base_m) for i, shape in enumerate((*shapes, FAR))], "test")


def _world(
    city: City,
    east_m: float,
    north_m: float,
    up_m: float,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    hover: bool = True,
) -> World:
    world = World([Body("blue/a", "iris", east_m, north_m, up_m, 90.0)], city=city)
    world._bodies.velocity[0] = velocity
    if hover:
        world.actuate(slice(None), np.full((1, 4), IRIS.hover_command))
        world._bodies.rotor_radps[:] = IRIS.rotor_max_radps * IRIS.hover_thrust**0.5
    world.advance(0)
    return world


def _run(world: World, ticks: int, first: int = 1) -> list[Note]:
    return [note for tick in range(first, first + ticks) for note in world.advance(tick * QUANTUM_NS)]


def _collisions(notes: list[Note]) -> list[Note]:
    return [note for note in notes if note.kind == "event.collision"]


@pytest.mark.parametrize("thick", [20.0, 0.01])
@pytest.mark.parametrize("speed", [5.0, 30.0, 1000.0])
def test_a_wall_stops_it(speed: float, thick: float) -> None:
    """Flying east into a wall at east 10 m, thick or thin: it never gets past, and the event says where."""
    world = _world(_city(shapely.box(10.0, -20.0, 10.0 + thick, 20.0)), 0.0, 0.0, 15.0, (speed, 0.0, 0.0))
    notes = _run(world, 3200)
    (hit,) = _collisions(notes)
    assert hit.about == "blue/a"
    assert hit.data["with"] == "building:0"
    assert hit.data["east_m"] == pytest.approx(10.0, abs=1e-9 if thick > 1.0 else 0.011)
    speed_mps = hit.data["speed_mps"]
    assert isinstance(speed_mps, float)
    assert 0.4 * speed < speed_mps <= speed + 1.0  # it climbs meanwhile
    assert hit.data["energy_j"] == pytest.approx(0.75 * speed_mps**2, rel=1e-9)
    assert world._bodies.position[0, 0] < 10.0 - IRIS.radius_m + 1e-6
    assert (world._bodies.alive[0, [0, 2]] == 0).all()  # the front ones: it looks east
    assert [note.kind for note in notes[-1:]] == ["event.crash"]


def test_a_gap_wider_than_it_lets_it_through_and_a_narrower_does_not() -> None:
    for width, passes in ((2.0 * IRIS.radius_m + 0.1, True), (2.0 * IRIS.radius_m - 0.1, False)):
        city = _city(
            shapely.box(10.0, 0.5 * width, 12.0, 20.0),
            shapely.box(10.0, -20.0, 12.0, -0.5 * width),
        )
        world = _world(city, 0.0, 0.0, 15.0, (15.0, 0.0, 0.0))
        assert (_collisions(_run(world, 800)) == []) == passes
        assert (world._bodies.position[0, 0] > 12.0) == passes


def test_over_a_roof_it_passes() -> None:
    world = _world(_city(shapely.box(5.0, -5.0, 15.0, 5.0)), 0.0, 0.0, 30.3, (18.0, 0.0, 0.0))
    assert _run(world, 800) == []
    assert world._bodies.position[0, 0] > 15.0


def test_a_courtyard_is_open() -> None:
    """A hole in the footprint: down to the ground in it, and against its inner wall."""
    ring = shapely.box(-30.0, -30.0, 30.0, 30.0).difference(shapely.box(-10.0, -10.0, 10.0, 10.0))
    world = _world(_city(ring), 0.0, 0.0, 20.0, hover=False)
    assert [note.kind for note in _run(world, 1200)] == ["event.contact", "event.crash"]
    assert world._bodies.position[0, 2] == 0.0
    (hit,) = _collisions(_run(_world(_city(ring), 0.0, 0.0, 15.0, (0.0, -12.0, 0.0)), 800))
    assert hit.data["north_m"] == pytest.approx(-10.0, abs=1e-9)


def test_parts_of_one_building_are_one() -> None:
    parts = shapely.multipolygons([shapely.box(5.0, -5.0, 9.0, 5.0), shapely.box(-9.0, -5.0, -5.0, 5.0)])
    for east in (12.0, -12.0):
        (hit,) = _collisions(_run(_world(_city(parts), 0.0, 0.0, 15.0, (east, 0.0, 0.0)), 600))
        assert hit.data["with"] == "building:0"


def test_lands_on_a_roof_stands_there_and_takes_off_again() -> None:
    world = _world(_city(shapely.box(-10.0, -10.0, 10.0, 10.0)), 2.0, 3.0, 30.3, hover=False)
    assert world.sensors(slice(None)).rangefinder_m[0] == pytest.approx(0.3)
    notes = _run(world, 800)
    assert [note.kind for note in notes] == ["event.contact"]
    assert world._bodies.position[0].tolist() == pytest.approx([2.0, 3.0, 30.0])
    truth = world.truth()
    assert (truth["on_ground"][0], truth["crashed"][0], truth["vel_up_mps"][0]) == (1.0, 0.0, 0.0)
    assert world.sensors(slice(None)).rangefinder_m[0] == 0.0
    assert world.sensors(slice(None)).baro_up_m[0] == 30.0
    world.actuate(slice(None), np.full((1, 4), 0.8))
    assert _run(world, 400, 801) == []
    assert world._bodies.position[0, 2] > 31.0


def test_a_hard_fall_on_a_roof_is_a_crash() -> None:
    world = _world(_city(shapely.box(-10.0, -10.0, 10.0, 10.0)), 0.0, 0.0, 60.0, hover=False)
    assert [note.kind for note in _run(world, 1600)] == ["event.contact", "event.crash"]
    assert world._bodies.position[0, 2] == 30.0


def test_starts_on_a_roof() -> None:
    world = World([Body("blue/a", "iris", 0.0, 0.0, 30.0)], city=_city(shapely.box(-10.0, -10.0, 10.0, 10.0)))
    world.advance(0)
    assert _run(world, 400) == []
    assert (world.truth()["on_ground"][0], world.truth()["up_m"][0]) == (1.0, 30.0)


def test_a_start_inside_a_building_is_refused() -> None:
    with pytest.raises(InputError, match="outside buildings; b0"):
        World([Body("blue/a", "iris", 0.0, 0.0, 3.0)], city=_city(shapely.box(-10.0, -10.0, 10.0, 10.0)))


def test_slides_off_a_roof_and_falls() -> None:
    """Blown over the edge by a wind that beats friction; it strikes the rim at most and ends on the ground."""
    from skyrange.world import Wind

    city = _city(shapely.box(-10.0, -10.0, 10.0, 10.0))
    world = World([Body("blue/a", "iris", 8.0, 0.0, 30.0)], wind=Wind((45.0, 0.0, 0.0)), city=city)
    world.advance(0)
    notes = _run(world, 400 * 12)
    assert world._bodies.position[0, 2] == 0.0
    assert world._bodies.position[0, 0] > 10.0
    assert [note.kind for note in notes][-1] == "event.crash"
    assert len(_collisions(notes)) <= 1


def test_an_overhang_lets_under_and_stops_from_below() -> None:
    city = _city(shapely.box(-10.0, -10.0, 10.0, 10.0), base_m=10.0)
    world = _world(city, -15.0, 0.0, 4.0, (15.0, 0.0, 0.0))
    assert _run(world, 300) == []
    assert -10.0 < world._bodies.position[0, 0] < 10.0
    world.actuate(slice(None), np.ones((1, 4)))
    (hit,) = _collisions(_run(world, 800, 301))
    assert hit.data["up_m"] == 10.0
    assert not world._bodies.alive.any()


def test_leaning_on_a_wall_is_one_event() -> None:
    world = _world(_city(shapely.box(10.0, -20.0, 12.0, 20.0)), 9.0, 0.0, 10.0, (4.0, 0.0, 0.0))
    hits = 0
    for tick in range(1, 2000):
        world._bodies.velocity[0] = (1.0, 0.0, 0.0)
        world._bodies.position[0, 2] = 10.0
        world._bodies.attitude[0], world._bodies.rates[0] = (1.0, 0.0, 0.0, 0.0), 0.0
        hits += len(_collisions(list(world.advance(tick * QUANTUM_NS))))
    assert hits == 1


def test_a_copy_continues_alike_and_shares_the_city() -> None:
    city = _city(shapely.box(10.0, -20.0, 12.0, 20.0))
    world = _world(city, 0.0, 0.0, 15.0, (10.0, 0.0, 0.0))
    _run(world, 100)
    fork = copy.deepcopy(world)
    assert fork.city is city
    assert _run(world, 800, 101) == _run(fork, 800, 101)
    assert world._bodies.position.tobytes() == fork._bodies.position.tobytes()


def test_company_changes_no_bit_among_walls() -> None:
    """Bounds are skipped by the fastest of all; what they skip must not matter."""
    city = _city(shapely.box(10.0, -20.0, 12.0, 20.0), shapely.box(-40.0, -20.0, -30.0, 20.0))
    alone = _world(city, 0.0, 0.0, 25.0, (7.0, 1.0, 0.0))
    others = [Body(f"blue/x{i}", "iris", 100.0 + 9.0 * i, 80.0, 40.0) for i in range(5)]
    among = World([*others, Body("blue/a", "iris", 0.0, 0.0, 25.0, 90.0)], city=city)
    among._bodies.velocity[-1] = (7.0, 1.0, 0.0)
    among._bodies.velocity[:-1, 1] = 33.0
    among.actuate(np.array([5]), np.full((1, 4), IRIS.hover_command))
    among._bodies.rotor_radps[-1] = alone._bodies.rotor_radps[0]
    among.advance(0)
    one, many = _run(alone, 1600), _run(among, 1600)
    assert _collisions(one)
    assert one == [note for note in many if note.about == "blue/a"]
    for name, column in alone.truth().items():
        assert column.tobytes() == among.truth()[name][-1:].tobytes(), name


def test_company_changes_no_reading_of_the_height_above_a_roof() -> None:
    """When a roof's edge is noticed must depend on the aircraft that crosses it alone, at every tick."""
    city = _city(*(shapely.box(7.3 * k, -9.0, 7.3 * k + 3.1, 9.0) for k in range(8)))
    other = Body("blue/x", "iris", 100.0, 80.0, 40.0)
    alone = World([Body("blue/a", "iris", -5.0, 0.0, 33.0, 90.0)], city=city)
    among = World([other, Body("blue/a", "iris", -5.0, 0.0, 33.0, 90.0)], city=city)
    among._bodies.velocity[0, 1] = 41.0
    seen = set()
    for world in (alone, among):
        world._bodies.velocity[-1] = (9.0, 0.3, 0.0)
        world.actuate(slice(None), np.full((len(world.vehicles), 4), IRIS.hover_command * 0.93))
        world._bodies.rotor_radps[-1] = IRIS.rotor_max_radps * IRIS.hover_thrust**0.5
        world.advance(0)
    for tick in range(1, 1200):
        alone.advance(tick * QUANTUM_NS)
        among.advance(tick * QUANTUM_NS)
        one = float(alone.sensors(slice(None)).rangefinder_m[0])
        assert one == among.sensors(slice(None)).rangefinder_m[1], tick
        seen.add(round(float(alone._bodies.floor[0])))
    assert seen == {0, 30}
