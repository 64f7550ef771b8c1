"""Do aircraft collide with each other, and with nothing else that is not there, as momentum and geometry demand?"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import numpy as np
import pytest

from skyrange.contracts.mailboxes import Note
from skyrange.core.time import Time
from skyrange.world import AIRFRAMES, Body, World
from skyrange.world.body_state import BodyState
from skyrange.world.collision.contact_tracker import ContactTracker
from skyrange.world.collision.response import RESTITUTION

QUANTUM_NS = 2_500_000
IRIS = AIRFRAMES["iris"]
MIRRORED = IRIS.radius_m * 2.0


def _world(*bodies: Body, velocities: list[tuple[float, float, float]], hover: bool = True) -> World:
    world = World(list(bodies))
    world._bodies.velocity[:] = velocities
    if hover:
        for i, airframe in enumerate(world.airframes):
            world.actuate(np.array([i]), np.full((1, 4), airframe.hover_command))
            world._bodies.rotor_radps[i] = airframe.rotor_max_radps * math.sqrt(airframe.hover_thrust)
    world.advance(0)
    return world


def _run(world: World, ticks: int, first: int = 1) -> list[tuple[int, Note]]:
    return [(tick, note) for tick in range(first, first + ticks) for note in world.advance(tick * QUANTUM_NS)]


def _collisions(notes: list[tuple[int, Note]]) -> list[Note]:
    return [note for _, note in notes if note.kind == "event.collision"]


def _momentum(world: World) -> np.ndarray:
    mass = np.array([airframe.mass_kg for airframe in world.airframes])
    return np.asarray((mass[:, None] * world._bodies.velocity).sum(axis=0))


def _spin(world: World) -> np.ndarray:
    """Angular momentum about the origin."""
    total = np.zeros(3)
    for i, airframe in enumerate(world.airframes):
        w, x, y, z = world._bodies.attitude[i]
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        centre = world._bodies.position[i] + (0.0, 0.0, airframe.cg_height_m)
        total += turn @ (np.array(airframe.inertia_kgm2) * world._bodies.rates[i])
        total += np.cross(centre, airframe.mass_kg * world._bodies.velocity[i])
    return total


def test_head_on_both_fall_and_are_noted() -> None:
    world = _world(
        Body("blue/a", "iris", -6.0, 0.0, 50.0, 90.0),
        Body("green/b", "iris", 6.0, 0.1, 50.0, 270.0),
        velocities=[(10.0, 0.0, 0.0), (-10.0, 0.0, 0.0)],
    )
    notes = _run(world, 400 * 8)
    first, second = _collisions(notes)
    assert (first.about, first.data["with"]) == ("blue/a", "green/b")
    assert (second.about, second.data["with"]) == ("green/b", "blue/a")
    assert {k: v for k, v in first.data.items() if k != "with"} == {k: v for k, v in second.data.items() if k != "with"}
    assert first.data["speed_mps"] == pytest.approx(15.6, rel=0.02)  # 20 less what drag took
    speed_mps = first.data["speed_mps"]
    assert isinstance(speed_mps, float)
    assert first.data["energy_j"] == pytest.approx(0.5 * 0.75 * speed_mps**2, rel=1e-9)
    assert first.data["east_m"] == pytest.approx(0.0, abs=0.1)
    assert first.data["north_m"] == pytest.approx(0.05, abs=0.02)
    assert first.data["up_m"] == pytest.approx(50.5, abs=0.2)  # half its height, and a full battery lifts
    assert {note.about for _, note in notes if note.kind == "event.crash"} == {"blue/a", "green/b"}
    assert world.truth()["crashed"].tolist() == [1.0, 1.0]


@pytest.mark.parametrize("speed", [5.0, 20.0, 100.0, 1000.0, 5000.0])
def test_nothing_passes_through_at_any_speed(speed: float) -> None:
    """At 5 km/s a tick is 12 m of way: from 9 m apart they are far behind each other at its end."""
    world = _world(
        Body("blue/a", "iris", -4.5, 0.0, 500.0),
        Body("green/b", "iris", 4.5, 0.0, 500.0),
        velocities=[(speed, 0.0, 0.0), (-speed, 0.0, 0.0)],
        hover=False,
    )
    assert len(_collisions(_run(world, 800))) == 2
    assert world._bodies.position[0, 0] < world._bodies.position[1, 0]


@pytest.mark.parametrize("off", [0.97, 1.03])
def test_a_graze_is_one_and_a_miss_is_none(off: float) -> None:
    """Two discs of radius r touch when their ways are less than 2·r apart: 3 % either way."""
    world = _world(
        Body("blue/a", "iris", -4.0, 0.0, 50.0),
        Body("green/b", "iris", 4.0, off * MIRRORED, 50.0),
        velocities=[(8.0, 0.0, 0.0), (-8.0, 0.0, 0.0)],
    )
    assert len(_collisions(_run(world, 400))) == (2 if off < 1.0 else 0)


@pytest.mark.parametrize(("above", "meets"), [(0.24, True), (0.26, False)])
def test_over_each_other_they_pass(above: float, meets: bool) -> None:
    """The cylinder is 0.25 m high."""
    world = _world(
        Body("blue/a", "iris", -1.0, 0.0, 50.0),
        Body("green/b", "iris", 1.0, 0.0, 50.0 + above),
        velocities=[(20.0, 0.0, 0.0), (-20.0, 0.0, 0.0)],
    )
    assert bool(_collisions(_run(world, 60))) == meets


@pytest.mark.parametrize(
    ("offset", "velocity"),
    [((1.5, 0.3, 0.1), (-12.0, 1.0, 1.0)), ((0.2, 0.1, 1.0), (1.0, -1.0, -8.0)), ((-1.2, 0.5, -0.05), (9.0, 0.0, 1.0))],
    ids=["side", "from above", "slanted"],
)
@pytest.mark.parametrize("other", ["iris", "hummingbird", "x500"])
def test_momentum_and_angular_momentum_are_kept(
    offset: tuple[float, float, float], velocity: tuple[float, float, float], other: str
) -> None:
    """Newton's third law: over the tick of the blow only gravity and thrust act beside it, so 1e-9 with both off.

    Angular momentum about the origin is of the bodies as they stand when they meet: the blow moves no one.
    """
    world = _world(
        Body("blue/a", "iris", 0.0, 0.0, 0.5e3, 20.0),
        Body("green/b", other, offset[0], offset[1], 0.5e3 + offset[2], 250.0),
        velocities=[(0.0, 0.0, 0.0), velocity],
        hover=False,
    )
    world._bodies.rates[:] = [(1.0, -2.0, 0.5), (0.3, 0.2, -1.0)]
    contacts = world._contact_tracker
    seen = {}
    look = type(contacts).resolve_tick

    def watched(self: ContactTracker, now: Time, step_s: float, bodies: BodyState) -> Sequence[tuple[int, Note]]:
        seen["before"] = (
            _momentum(world),
            world._bodies.velocity.copy(),
            world._bodies.rates.copy(),
            world._bodies.position.copy(),
        )
        return look(self, now, step_s, bodies)

    type(contacts).resolve_tick = watched  # type: ignore[method-assign]
    try:
        for tick in range(1, 400):
            if _collisions([(tick, note) for note in world.advance(tick * QUANTUM_NS)]):
                break
        else:
            pytest.fail("they missed")
    finally:
        type(contacts).resolve_tick = look  # type: ignore[method-assign]
    momentum, velocities, rates, _ = seen["before"]
    assert _momentum(world) == pytest.approx(momentum, abs=1e-9)
    after = _spin(world)
    blown_v, blown_w = world._bodies.velocity.copy(), world._bodies.rates.copy()
    world._bodies.velocity[:], world._bodies.rates[:] = velocities, rates
    assert after == pytest.approx(_spin(world), rel=1e-9, abs=1e-6)
    # and energy is lost, not made
    mass = np.array([a.mass_kg for a in world.airframes])
    inertia = np.array([a.inertia_kgm2 for a in world.airframes])

    def energy(v: np.ndarray, w: np.ndarray) -> float:
        return float((0.5 * mass[:, None] * v**2 + 0.5 * inertia * w**2).sum())

    assert energy(blown_v, blown_w) < energy(velocities, rates)


def test_restitution_of_a_square_blow() -> None:
    """The speed of the points of contact towards each other turns, and shrinks to `RESTITUTION` of it: 1 % for drag.

    Heading east the body's axes are the local ones; the point is at half height, 0.07 m below the centre of gravity.
    """
    world = _world(
        Body("blue/a", "iris", -1.0, 0.0, 500.0, 90.0),
        Body("green/b", "iris", 1.0, 0.0, 500.0, 90.0),
        velocities=[(6.0, 0.0, 0.0), (-6.0, 0.0, 0.0)],
        hover=False,
    )
    before = 0.0
    for tick in range(1, 200):
        before = world._bodies.velocity[0, 0] - world._bodies.velocity[1, 0]
        if world.advance(tick * QUANTUM_NS):
            break
    points = world._bodies.velocity[:, 0] + world._bodies.rates[:, 1] * (0.5 * IRIS.height_m - IRIS.cg_height_m)
    assert points[1] - points[0] == pytest.approx(RESTITUTION * before, rel=0.01)


def test_the_struck_side_loses_its_motors() -> None:
    """Nose to nose loses the front ones (1 and 3), struck from the left the left ones (2 and 3); its own nose too."""
    world = _world(
        Body("blue/a", "iris", 0.0, 0.0, 50.0, 0.0),
        Body("green/b", "iris", -3.0, 0.0, 50.0, 90.0),
        velocities=[(0.0, 0.0, 0.0), (6.0, 0.0, 0.0)],
    )
    notes = _run(world, 400)
    assert len(_collisions(notes)) == 2
    assert world._bodies.alive.tolist() == [[1, 0, 0, 1], [0, 1, 0, 1]]
    _run(world, 400 * 6, 401)
    assert world.truth()["crashed"].tolist() == [1.0, 1.0]


def test_a_hard_blow_leaves_no_motor() -> None:
    world = _world(
        Body("blue/a", "iris", 0.0, 0.0, 50.0),
        Body("green/b", "iris", -3.0, 0.0, 50.0),
        velocities=[(0.0, 0.0, 0.0), (25.0, 0.0, 0.0)],
    )
    _run(world, 100)
    assert not world._bodies.alive.any()


def test_from_above_the_lower_one_loses_what_is_below_the_other() -> None:
    world = _world(
        Body("blue/a", "iris", 0.0, 0.0, 50.0),
        Body("green/b", "iris", 0.0, 0.0, 51.0),
        velocities=[(0.0, 0.0, 0.0), (0.0, 0.0, -4.0)],
    )
    assert len(_collisions(_run(world, 120))) == 2
    assert world._bodies.alive[0].tolist() == [0, 0, 0, 0]
    assert world._bodies.alive[1].tolist() == [1, 1, 1, 1]


def test_a_wreck_that_lies_on_another_is_one_event() -> None:
    world = World([Body("blue/a", "iris", 0.0, 0.0, 0.0), Body("green/b", "iris", 0.05, 0.0, 6.0)])
    world.advance(0)
    notes = _run(world, 400 * 10)
    assert [note.kind for note in _collisions(notes)] == ["event.collision"] * 2
    assert np.isfinite(world._bodies.position).all()


def test_order_and_company_change_no_bit() -> None:
    """The same four in any order, and with others far away or near but untouched: equal to the bit."""
    four = [
        ("blue/a", -3.0, 0.0, (7.0, 0.0, 0.0)),
        ("blue/b", 3.0, 0.2, (-7.0, 0.5, 0.0)),
        ("green/c", 0.1, 3.0, (0.0, -7.0, 0.0)),
        ("green/d", 0.0, -3.1, (0.2, 7.0, 0.0)),
    ]
    company = [
        ("amber/x", 40.0, 40.0, (0.0, 0.0, 0.0)),
        ("zed/y", 6.0, 8.0, (0.0, 20.0, 0.0)),
        ("blue/ab", 300.0, 0.0, (0.0, 0.0, 0.0)),
    ]
    casts = [four, four[::-1], [four[2], four[0], four[3], four[1]], [company[0], *four[::-1], *company[1:]]]
    worlds, said = [], []
    for cast in casts:
        world = _world(
            *(Body(name, "iris", east, north, 60.0, 30.0) for name, east, north, _ in cast),
            velocities=[velocity for *_, velocity in cast],
        )
        notes = _run(world, 1000)
        said.append(
            {(tick, n.kind, n.about, tuple(n.data.items())) for tick, n in notes if n.about in {f[0] for f in four}}
        )
        worlds.append(world)
    assert len([note for note in said[0] if note[1] == "event.collision"]) >= 6
    for cast, world, told in zip(casts, worlds, said, strict=True):
        assert told == said[0]
        rows = [[name for name, *_ in cast].index(name) for name, *_ in four]
        for column, values in world.truth().items():
            assert values[rows].tobytes() == worlds[0].truth()[column].tobytes(), column


def test_a_copy_of_a_world_collides_alike() -> None:
    world = _world(
        Body("blue/a", "iris", -3.0, 0.0, 50.0),
        Body("green/b", "iris", 3.0, 0.3, 50.0),
        velocities=[(9.0, 0.0, 0.0), (-9.0, 0.0, 0.0)],
    )
    _run(world, 50)
    fork = copy.deepcopy(world)
    assert _run(world, 400, 51) == _run(fork, 400, 51)
    assert world._bodies.position.tobytes() == fork._bodies.position.tobytes()


def test_touching_again_within_a_second_is_the_same_contact() -> None:
    world = _world(
        Body("blue/a", "iris", 0.0, 0.0, 50.0),
        Body("green/b", "iris", 2.0, 0.0, 50.0),
        velocities=[(0.0, 0.0, 0.0), (-6.0, 0.0, 0.0)],
    )
    found = []
    for tick in range(1, 4000):
        world._bodies.position[:, 2], world._bodies.velocity[:, 2] = 50.0, 0.0
        world._bodies.attitude[:], world._bodies.rates[:] = (1.0, 0.0, 0.0, 0.0), 0.0
        world._bodies.velocity[1, 0] = -6.0 if tick % 1000 < 500 else 2.0  # in for 1.25 s, out for as long
        world._bodies.velocity[0] = 0.0
        found += [tick for note in world.advance(tick * QUANTUM_NS) if note.kind == "event.collision"]
    assert len(found) == 8  # four blows, two aircraft
    assert len(set(found)) == 4
