"""Do bodies that a simulator moves take its poses, give and take impulses, and break as others do?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from skyrange.contracts.components import Contacts, Floats, Poses, Source
from skyrange.contracts.mailboxes import Note
from skyrange.world import AIRFRAMES, Body, World
from skyrange.world.airframes import GRAVITY_MPS2
from skyrange.world.multirotor import MAX_TOUCHDOWN_MPS

QUANTUM_NS = 2_500_000
QUANTUM_S = QUANTUM_NS / 1e9
IRIS = AIRFRAMES["iris"]
LEVEL = (1.0, 0.0, 0.0, 0.0)
FIRST = np.array([0])


def _world(*bodies: Body, led: Sequence[int], **given: Any) -> World:
    world = World(list(bodies), **given)
    world.set_source(np.array(led, dtype=np.int64), Source.SIMULATOR)
    for i, airframe in enumerate(world.airframes):
        world.actuate(np.array([i]), np.full((1, 4), airframe.hover_command))
        world._bodies.rotor_radps[i] = airframe.rotor_max_radps * math.sqrt(airframe.hover_thrust)
    world.advance(0)
    return world


def _pose(
    position: Sequence[float], velocity: Sequence[float] = (0.0, 0.0, 0.0), contacts: Contacts | None = None
) -> Poses:
    place, speed, attitude, rates = (
        np.array([row], dtype=np.float64) for row in (position, velocity, LEVEL, (0.0, 0.0, 0.0))
    )
    return Poses(np.array([True]), place, speed, attitude, rates, at_next_tick=True, contacts=contacts)


def _contact(other: int, normal: Sequence[float], rotor: int = -1) -> Contacts:
    def one(value: int) -> Any:
        return np.array([value])

    return Contacts(one(0), one(other), one(rotor), one(-1), np.array([[1.0, 2.0, 3.0]]), np.array([normal]))


def _fly(world: World, row: int, velocity: Sequence[float], ticks: int, start: Sequence[float]) -> list[Note]:
    notes: list[Note] = []
    for tick in range(1, ticks + 1):
        place = np.array(start) + np.array(velocity) * tick * QUANTUM_S
        world.impose(np.array([row]), _pose(place.tolist(), velocity))
        notes += world.advance(tick * QUANTUM_NS)
    return notes


def test_a_pose_of_the_next_tick_is_taken_as_it_is() -> None:
    world = _world(Body("blue/1", "iris", 0.0, 0.0, 10.0), led=[0])
    for tick in range(1, 20):
        place = (math.sin(tick), 0.1 * tick, 10.0 + 0.01 * tick)
        world.impose(FIRST, _pose(place, (1.0, -2.0, 3.0)))
        world.advance(tick * QUANTUM_NS)
        position, velocity = world.motion()
        assert position[0].tolist() == list(place)
        assert velocity[0].tolist() == [1.0, -2.0, 3.0]


def test_the_specific_force_is_that_of_the_last_tick() -> None:
    world = _world(Body("blue/1", "iris", 0.0, 0.0, 10.0), led=[0])
    speed = 0.0
    for tick, change in enumerate((0.0, 0.01, 0.02, 0.0, -0.03), start=1):
        speed += change
        world.impose(FIRST, _pose((0.0, 0.0, 10.0), (speed, 0.0, 0.0)))
        world.advance(tick * QUANTUM_NS)
        force = world.sensors(FIRST).accel_mps2[0]
        assert force[0] == pytest.approx(change / QUANTUM_S, abs=1e-9)
        assert force[2] == pytest.approx(GRAVITY_MPS2)


def test_its_inputs_are_the_rotors_and_the_air_of_the_world() -> None:
    world = _world(Body("blue/1", "iris", 0.0, 0.0, 10.0), Body("blue/2", "iris", 9.0, 0.0, 0.0), led=[0])
    world.disturb(FIRST, np.array([[1.0, 0.25, 1.0, 0.0]]), np.array([[1.0, 2.0, 3.0]]))
    _fly(world, 0, (0.0, 0.0, 0.0), 400, (0.0, 0.0, 10.0))
    inputs = world.body_inputs(slice(0, 1))
    whole = inputs.rotor_radps[0, 0]
    assert 0.5 * IRIS.rotor_max_radps < whole < IRIS.rotor_max_radps
    assert inputs.rotor_radps[0] == pytest.approx([whole, 0.5 * whole, whole, 0.0], rel=1e-3)
    assert inputs.air_enu_mps.tolist() == [[1.0, 2.0, 3.0]]
    assert inputs.world_position_enu_m[1, 0] == 9.0


@pytest.mark.parametrize("swapped", [False, True])
def test_a_collision_with_a_body_of_the_world_conserves_momentum(swapped: bool) -> None:
    row = 1 if swapped else 0
    bodies = [Body("blue/1", "iris", 0.0, 0.0, 10.0), Body("blue/2", "hummingbird", 2.0, 0.0, 10.0)]
    if swapped:
        bodies.reverse()
    world = _world(*bodies, led=[row])
    before, impulse = 0.0, np.zeros(3)
    other = 1 - row
    mass = AIRFRAMES["hummingbird"].mass_kg
    for tick in range(1, 300):
        before = float(world.motion()[1][other, 0])
        world.impose(np.array([row]), _pose((4.0 * tick * QUANTUM_S, 0.0, 10.0), (4.0, 0.0, 0.0)))
        notes = world.advance(tick * QUANTUM_NS)
        impulse = world.body_inputs(slice(row, row + 1)).impulse_ns[0]
        if notes:
            break
    assert [note.kind for note in notes] == ["event.collision", "event.collision"]
    gained = mass * (float(world.motion()[1][other, 0]) - before)
    assert gained > 1.0
    assert impulse[0] == pytest.approx(-gained, rel=0.02)  # the rest is the drag of one tick
    assert (world.body_inputs(slice(row, row + 1)).impulse_ns == 0.0).all()
    alive = world._bodies.alive
    assert alive[row].min() == 0
    assert alive[other].min() == 0
    assert not world.truth()["crashed"].any()


def test_two_that_a_simulator_moves_are_left_to_it() -> None:
    world = _world(Body("blue/1", "iris", 0.0, 0.0, 10.0), Body("blue/2", "iris", 0.1, 0.0, 10.0), led=[0, 1])
    notes = _fly(world, 0, (4.0, 0.0, 0.0), 100, (0.0, 0.0, 10.0))
    assert notes == []
    assert world._bodies.alive.all()


@pytest.mark.parametrize(("rotor", "lost"), [(-1, []), (2, [2])])
def test_a_reported_contact_is_noted_and_breaks_the_propeller_that_touched(rotor: int, lost: list[int]) -> None:
    world = _world(Body("blue/1", "iris", 0.0, 0.0, 10.0), Body("blue/2", "iris", 9.0, 0.0, 10.0), led=[0, 1])
    world.impose(FIRST, _pose((0.0, 0.0, 10.0), (3.0, 0.0, 0.0)))
    world.advance(QUANTUM_NS)
    world.impose(np.array([0, 1]), _pair(_contact(1, (-1.0, 0.0, 0.0), rotor)))
    notes = world.advance(2 * QUANTUM_NS)
    assert [(note.kind, note.about, note.data["with"]) for note in notes] == [
        ("event.collision", "blue/1", "blue/2"),
        ("event.collision", "blue/2", "blue/1"),
    ]
    assert notes[0].data["speed_mps"] == pytest.approx(3.0)
    assert notes[0].data["energy_j"] == pytest.approx(0.25 * IRIS.mass_kg * 9.0)
    assert (notes[0].data["east_m"], notes[0].data["north_m"], notes[0].data["up_m"]) == (1.0, 2.0, 3.0)
    assert world.lost_motors(world.vehicles[0]) == lost
    assert world._bodies.alive[1].all()


def _pair(contacts: Contacts) -> Poses:
    def rows(first: Sequence[float], second: Sequence[float]) -> Floats:
        return np.array([first, second])

    still = (0.0, 0.0, 0.0)
    places = rows((0.0, 0.0, 10.0), (9.0, 0.0, 10.0))
    return Poses(
        np.array([True, True]), places, rows((3.0, 0.0, 0.0), still), rows(LEVEL, LEVEL), rows(still, still),
        at_next_tick=True, contacts=contacts,
    )  # fmt: skip


def test_rims_that_meet_break_although_the_normal_points_up() -> None:
    world = _world(Body("blue/1", "iris", 0.0, 0.0, 10.0), Body("blue/2", "iris", 9.0, 0.0, 10.0), led=[0, 1])
    world.impose(FIRST, _pose((0.0, 0.0, 10.0), (3.0, 0.0, 0.0)))
    world.advance(QUANTUM_NS)
    world.impose(np.array([0, 1]), _pair(_contact(1, (0.0, 0.0, 1.0), 0)))
    notes = world.advance(2 * QUANTUM_NS)
    assert [note.data["speed_mps"] for note in notes] == pytest.approx([3.0, 3.0])
    assert np.flatnonzero(world._bodies.alive[0] == 0).tolist() == [0]


def test_a_touch_that_parts_or_lands_breaks_nothing() -> None:
    for contact in (_contact(1, (-1.0, 0.0, 0.0), 0), _contact(-1, (0.0, 0.0, 1.0))):
        world = _world(Body("blue/1", "iris", 0.0, 0.0, 10.0), Body("blue/2", "iris", 9.0, 0.0, 10.0), led=[0, 1])
        world.impose(FIRST, _pose((0.0, 0.0, 10.0), (-3.0, 0.0, -2.0)))
        world.advance(QUANTUM_NS)
        world.impose(np.array([0, 1]), _pair(contact))
        assert world.advance(2 * QUANTUM_NS) == []
        assert world._bodies.alive.all()


def test_a_great_change_of_speed_stops_all_motors() -> None:
    world = _world(Body("blue/1", "iris", 0.0, 0.0, 30.0), led=[0])
    world.impose(FIRST, _pose((0.0, 0.0, 30.0), (15.0, 0.0, 0.0)))
    world.advance(QUANTUM_NS)
    world.impose(FIRST, _pose((0.0, 0.0, 30.0), (-1.0, 0.0, 0.0), _contact(-3, (-1.0, 0.0, 0.0))))
    notes = world.advance(2 * QUANTUM_NS)
    assert [(note.kind, note.data["with"]) for note in notes] == [("event.collision", "building:2")]
    assert not world._bodies.alive[0].any()


def test_a_crash_on_the_ground_stops_the_motors() -> None:
    fall = -(MAX_TOUCHDOWN_MPS + 0.5)
    world = _world(Body("blue/1", "iris", 0.0, 0.0, 0.5), led=[0])
    notes: list[Note] = []
    for tick in range(1, 80):
        place = max(0.5 + fall * tick * QUANTUM_S, 0.0)
        world.impose(FIRST, _pose((0.0, 0.0, place), (0.0, 0.0, fall if place > 0.0 else 0.0)))
        notes += world.advance(tick * QUANTUM_NS)
    assert [note.kind for note in notes] == ["event.contact", "event.crash"]
    assert not world._bodies.alive[0].any()
    assert world.truth()["crashed"][0] == 1.0
