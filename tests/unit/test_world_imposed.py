"""Do bodies follow imposed poses, meet the world as others do, and leave the others to the bit as they are?"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.contracts.components import Poses, Source
from skyrange.contracts.mailboxes import Note
from skyrange.world import AIRFRAMES, Body, SensorSpec, Wind, World
from skyrange.world.imposed_poses import CARRY_S, JUMP_M
from skyrange.world.sensing.sensor_errors import ACCEL_MOTORS_MPS2

QUANTUM_NS = 2_500_000
QUANTUM_S = QUANTUM_NS / 1e9
IRIS = AIRFRAMES["iris"]
LEVEL = (1.0, 0.0, 0.0, 0.0)


def _pose(
    position: Sequence[float],
    velocity: Sequence[float] = (0.0, 0.0, 0.0),
    attitude: Sequence[float] = LEVEL,
    rates: Sequence[float] = (0.0, 0.0, 0.0),
    fresh: bool = True,
) -> Poses:
    place, speed, turned, turning = (np.array([row], dtype=np.float64) for row in (position, velocity, attitude, rates))
    return Poses(np.array([fresh]), place, speed, turned, turning)


def _world(*bodies: Body, led: Sequence[int], **given: Any) -> World:
    world = World(list(bodies), **given)
    world.set_source(np.array(led, dtype=np.int64), Source.KINEMATIC)
    for i, airframe in enumerate(world.airframes):
        if i not in led:
            world.actuate(np.array([i]), np.full((1, 4), airframe.hover_command))
            world._bodies.rotor_radps[i] = airframe.rotor_max_radps * math.sqrt(airframe.hover_thrust)
    world.advance(0)
    return world


def _circle(t: float, east_m: float = 30.0, radius_m: float = 5.0, radps: float = 1.0) -> Poses:
    """Round a centre at 10 m height, nose along the tangent."""
    c, s = math.cos(radps * t), math.sin(radps * t)
    half = 0.5 * (radps * t + 0.5 * math.pi)
    return _pose(
        (east_m + radius_m * c, radius_m * s, 10.0),
        (-radius_m * radps * s, radius_m * radps * c, 0.0),
        (math.cos(half), 0.0, 0.0, math.sin(half)),
        (0.0, 0.0, radps),
    )


def _straight(world: World, row: int, start: Sequence[float], velocity: Sequence[float], ticks: int) -> list[Note]:
    """Impose a straight flight at 50 Hz."""
    notes: list[Note] = []
    for tick in range(ticks):
        if tick % 8 == 0:
            place = np.array(start) + np.array(velocity) * tick * QUANTUM_S
            world.impose(np.array([row]), _pose(place.tolist(), velocity))
        notes += world.advance((tick + 1) * QUANTUM_NS)
    return notes


def _kinds(notes: Sequence[Note]) -> list[tuple[str, str]]:
    return [(note.kind, note.about) for note in notes]


def test_a_circle_told_at_50_hz_is_followed_between_the_poses_too() -> None:
    """Carried on for 20 ms, a turn of 5 m/s² leaves at most 5·0.02²/2 = 1 mm."""
    world = _world(Body("blue/a", "iris", 35.0, 0.0, 10.0), Body("blue/b", "iris", 0.0, 0.0), led=[0])
    most = 0.0
    for tick in range(1, 2000):
        now = (tick - 1) * QUANTUM_S
        if (tick - 1) % 8 == 0:
            world.impose(np.array([0]), _circle(now))
        assert list(world.advance(tick * QUANTUM_NS)) == []
        wanted = _circle(tick * QUANTUM_S)
        most = max(most, float(np.linalg.norm(world._bodies.position[0] - wanted.position_enu_m[0])))
        turned = abs(float(np.dot(world._bodies.attitude[0], wanted.attitude[0])))
        assert turned == pytest.approx(1.0, abs=1e-9)  # the same rotation
    assert 0.0005 < most < 0.001001
    truth = world.truth()
    assert truth["rate_z_radps"][0] == 1.0
    assert world.sources == (Source.KINEMATIC, Source.DYNAMIC)
    # centripetal, 5 m/s² to the left of a nose along the tangent: the mean over 20 ms, told for the 20 ms after
    assert world.sensors(slice(0, 1)).accel_mps2[0] == pytest.approx([0.0, 5.0, 9.80665], abs=0.15)
    assert np.linalg.norm(world.sensors(slice(0, 1)).accel_mps2[0, :2]) == pytest.approx(5.0, abs=0.001)
    position, velocity = world.motion()
    assert position[0].tolist() == [truth[name][0] for name in ("east_m", "north_m", "up_m")]
    assert np.linalg.norm(velocity[0]) == pytest.approx(5.0)


def test_it_stands_at_its_start_until_the_first_pose() -> None:
    world = _world(Body("blue/a", "iris", 3.0, 4.0, 0.0, 90.0), led=[0])
    for tick in range(1, 200):
        assert list(world.advance(tick * QUANTUM_NS)) == []
    assert world._bodies.position[0].tolist() == [3.0, 4.0, 0.0]
    assert world.truth()["on_ground"].tolist() == [1.0]
    assert world.sensors(slice(None)).accel_mps2[0].tolist() == [0.0, 0.0, 9.80665]


def test_without_another_pose_it_goes_on_for_a_while_and_then_stands() -> None:
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 20.0), led=[0])
    world.impose(slice(None), _pose((0.0, 0.0, 20.0), (8.0, 0.0, 0.0), LEVEL, (0.0, 0.0, 1.0)))
    for tick in range(1, 1000):
        world.advance(tick * QUANTUM_NS)
    assert world._bodies.position[0].tolist() == pytest.approx([8.0 * CARRY_S, 0.0, 20.0])
    truth = world.truth()
    assert (truth["vel_east_mps"][0], truth["rate_z_radps"][0]) == (0.0, 0.0)
    assert 2.0 * math.atan2(truth["qz"][0], truth["qw"][0]) == pytest.approx(CARRY_S)
    world.impose(slice(None), _pose((6.0, 0.0, 20.0), (8.0, 0.0, 0.0)))  # it comes back, and is no jump
    assert list(world.advance(1000 * QUANTUM_NS)) == []
    assert world._bodies.position[0, 0] == pytest.approx(6.0 + 8.0 * QUANTUM_S)


def test_rows_that_are_not_fresh_are_not_read() -> None:
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 20.0), led=[0])
    world.impose(slice(None), _pose((0.0, 0.0, 20.0), (1.0, 0.0, 0.0)))
    world.advance(QUANTUM_NS)
    world.impose(slice(None), _pose([math.nan] * 3, [math.nan] * 3, [math.nan] * 4, [math.nan] * 3, fresh=False))
    world.advance(2 * QUANTUM_NS)
    assert world._bodies.position[0, 0] == pytest.approx(2.0 * QUANTUM_S)


def _bytes(world: World, row: int) -> bytes:
    seen = world.sensors(np.array([row]))
    columns = [column[row : row + 1] for column in world.truth().values()]
    return b"".join(a.tobytes() for a in [*columns, seen.accel_mps2, seen.gyro_radps, seen.gnss_enu_m, seen.baro_up_m])


def test_the_others_are_to_the_bit_as_they_are_without_it() -> None:
    """A dynamic aircraft flies among gusts with noisy sensors: beside dynamic ones, and beside one that is led."""

    def flown(led: Sequence[int]) -> bytes:
        bodies = [Body(f"blue/b{i}", "iris", 15.0 * i, 0.0, 20.0, seed=7) for i in range(3)]
        world = _world(*bodies, led=led, wind=Wind((3.0, 0.0, 0.0), 1.0), sensors=SensorSpec(1.0))
        said = b""
        for tick in range(1, 800):
            if led and tick % 5 == 0:
                world.impose(np.array(led), _circle(tick * QUANTUM_S))
            m = np.arange(4)
            world.actuate(np.array([0]), np.array([IRIS.hover_command + 0.02 * np.sin(0.1 * tick + m)]))
            world.advance(tick * QUANTUM_NS)
            said += _bytes(world, 0)
        return said

    assert flown([2]) == flown([]) == flown([1])


def test_a_copy_goes_on_alike_and_apart() -> None:
    world = _world(Body("blue/a", "iris", 35.0, 0.0, 10.0), Body("blue/b", "iris", 0.0, 0.0, 40.0), led=[0])

    def fly(of: World, first: int, last: int) -> bytes:
        for tick in range(first, last):
            if tick % 16 == 0:
                of.impose(np.array([0]), _circle(tick * QUANTUM_S))
            of.advance((tick + 1) * QUANTUM_NS)
        return _bytes(of, 0) + _bytes(of, 1)

    fly(world, 0, 100)
    world.impose(np.array([0]), _circle(100 * QUANTUM_S))  # a pose that waits is copied too
    fork = copy.deepcopy(world)
    before = _bytes(fork, 0)
    after = fly(world, 100, 300)
    assert _bytes(fork, 0) == before
    assert fly(fork, 100, 300) == after


@pytest.mark.parametrize("led", [[0], [1], [0, 1]])
def test_a_collision_moves_only_who_can_be_moved(led: list[int]) -> None:
    """One meets the other head-on at 20 m/s: both are told of, one falls, and what is led flies on, marked."""
    world = _world(
        Body("blue/a", "iris", -2.0, 0.0, 50.0, 90.0), Body("green/b", "iris", 2.0, 0.1, 50.0, 270.0), led=led
    )
    starts, velocities = ((-2.0, 0.0, 50.0), (2.0, 0.1, 50.0)), ((10.0, 0.0, 0.0), (-10.0, 0.0, 0.0))
    for row in range(2):
        if row not in led:
            world._bodies.velocity[row] = velocities[row]
    notes: list[Note] = []
    for tick in range(400 * 8):
        for row in led:
            if tick % 8 == 0:
                place = np.array(starts[row]) + np.array(velocities[row]) * tick * QUANTUM_S
                world.impose(np.array([row]), _pose(place.tolist(), velocities[row]))
        notes += world.advance((tick + 1) * QUANTUM_NS)
    hits = [note for note in notes if note.kind == "event.collision"]
    assert [(hit.about, hit.data["with"]) for hit in hits] == [("blue/a", "green/b"), ("green/b", "blue/a")]
    assert hits[0].data["speed_mps"] == pytest.approx(20.0, rel=0.05)  # less what drag took
    speed_mps = hits[0].data["speed_mps"]
    assert isinstance(speed_mps, float)
    assert hits[0].data["energy_j"] == pytest.approx(0.5 * 0.75 * speed_mps**2, rel=1e-9)
    assert world.truth()["crashed"].tolist() == [1.0, 1.0]
    assert {note.about for note in notes if note.kind == "event.crash"} == {
        world.vehicles[row] for row in range(2) if row not in led
    }
    for row in led:
        flown = np.array(starts[row]) + np.array(velocities[row]) * 3200 * QUANTUM_S
        assert world._bodies.position[row] == pytest.approx(flown, abs=1e-9)
    for row in {0, 1} - set(led):
        assert world._bodies.position[row, 2] == 0.0
        assert (world._bodies.alive[row] == 0).all()  # it changed its speed by more than 10 m/s


def test_what_is_led_pushes_what_is_in_its_way() -> None:
    """A hovering aircraft is hit from behind at 3 m/s: it leaves along the way of what hit it, and faster."""
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 50.0, 90.0), Body("green/b", "iris", 1.0, 0.0, 50.0, 90.0), led=[0])
    notes: list[Note] = []
    for tick in range(1200):
        if tick % 8 == 0:
            world.impose(np.array([0]), _pose((3.0 * tick * QUANTUM_S, 0.0, 50.0), (3.0, 0.0, 0.0)))
        notes += world.advance((tick + 1) * QUANTUM_NS)
        if notes:
            break
    assert _kinds(notes) == [("event.collision", "blue/a"), ("event.collision", "green/b")]
    # against what gives no way the whole relative speed is returned, 0.3 of it beyond, at the point of contact
    assert 3.0 < world._bodies.velocity[1, 0] < 1.3 * 3.0 + 0.01
    assert world._bodies.velocity[0].tolist() == [3.0, 0.0, 0.0]


def test_what_overlaps_is_pushed_out_whole() -> None:
    """All of the way out is the other's, for what is led gives none."""
    start = 2.0 * IRIS.radius_m - 0.2
    for led in (0, 1):
        bodies = [Body("blue/a", "iris", 0.0, 0.0, 50.0), Body("green/b", "iris", start, 0.0, 50.0)]
        world = _world(*bodies, led=[led])
        world._bodies.velocity[1 - led] = (1.0 if led else -1.0, 0.0, 0.0)
        notes = world.advance(QUANTUM_NS)
        assert _kinds(notes) == [("event.collision", "blue/a"), ("event.collision", "green/b")]
        assert world._bodies.position[led].tolist() == [start * led, 0.0, 50.0]
        assert abs(world._bodies.position[1, 0] - world._bodies.position[0, 0]) == pytest.approx(
            2.0 * IRIS.radius_m, abs=1e-9
        )


def _block(*shape: float, height_m: float) -> City:
    far = shapely.box(500.0, 500.0, 510.0, 510.0)
    return City([Building(f"b{i}", height_m, box) for i, box in enumerate((shapely.box(*shape), far))], "test")


def test_a_wall_is_noted_and_flown_through() -> None:
    city = _block(5.0, -9.0, 8.0, 9.0, height_m=30.0)
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 15.0), led=[0], city=city)
    notes = _straight(world, 0, (0.0, 0.0, 15.0), (5.0, 0.0, 0.0), 1200)
    (hit,) = notes
    assert (hit.kind, hit.data["with"], hit.data["speed_mps"]) == ("event.collision", "building:0", 5.0)
    assert hit.data["east_m"] == pytest.approx(5.0)
    assert world._bodies.position[0] == pytest.approx([15.0, 0.0, 15.0])
    assert world.truth()["crashed"].tolist() == [1.0]


def test_a_roof_is_ground() -> None:
    city = _block(-9.0, -9.0, 9.0, 9.0, height_m=12.0)
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 20.0), led=[0], city=city)
    notes = _straight(world, 0, (0.0, 0.0, 20.0), (0.0, 0.0, -1.0), 8 * 400)
    assert notes[0].kind == "event.contact"
    assert not [note for note in notes if note.kind == "event.crash"]
    world.impose(slice(None), _pose((0.0, 0.0, 12.01)))
    world.advance(9 * 400 * QUANTUM_NS)
    assert (world._bodies.position[0, 2], world.truth()["on_ground"][0]) == (12.01, 1.0)
    assert world.sensors(slice(None)).rangefinder_m[0] == pytest.approx(0.01)
    world.impose(slice(None), _pose((20.0, 0.0, 0.0)))  # it is another place's ground at once
    world.advance((9 * 400 + 1) * QUANTUM_NS)
    assert world._bodies.position[0].tolist() == [20.0, 0.0, 0.0]


@pytest.mark.parametrize(("speed", "crashes"), [(1.0, False), (3.0, False), (3.3, True), (9.0, True)])
def test_a_touchdown_is_told_once_and_breaks_it_when_too_hard(speed: float, crashes: bool) -> None:
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 5.0), led=[0])
    notes: list[Note] = []
    for tick in range(8 * 400):
        if tick % 8 == 0:
            up = 5.0 - speed * tick * QUANTUM_S
            still = up <= 0.0  # a simulator has the pose on the ground without the speed of the fall
            world.impose(slice(None), _pose((0.0, 0.0, max(up, 0.0)), (0.0, 0.0, 0.0 if still else -speed)))
        notes += world.advance((tick + 1) * QUANTUM_NS)
    wanted = ["event.contact", "event.crash"] if crashes else ["event.contact"]
    assert [note.kind for note in notes] == wanted
    assert notes[0].data["speed_mps"] == pytest.approx(speed)
    truth = world.truth()
    assert (truth["up_m"][0], truth["on_ground"][0], truth["crashed"][0]) == (0.0, 1.0, float(crashes))


def test_lying_on_its_side_it_has_crashed() -> None:
    world = _world(Body("blue/a", "iris", 0.0, 0.0), led=[0])
    world.impose(slice(None), _pose((0.0, 0.0, 0.0), attitude=(math.cos(0.7), math.sin(0.7), 0.0, 0.0)))
    (note,) = world.advance(QUANTUM_NS)
    assert note.kind == "event.crash"
    assert note.data["tilt_deg"] == pytest.approx(math.degrees(1.4))


def test_a_jump_is_told_and_hits_nothing_on_its_way() -> None:
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 50.0), Body("green/b", "iris", 5_000.0, 0.0, 50.0), led=[0])
    world.impose(np.array([0]), _pose((10_000.0, 0.0, 50.0)))
    (note,) = world.advance(QUANTUM_NS)
    assert (note.kind, note.about) == ("event.jump", "blue/a")
    assert note.data["distance_m"] == pytest.approx(10_000.0)
    assert world._bodies.position[0].tolist() == [10_000.0, 0.0, 50.0]
    # and it is a body there: what flies into it collides
    world._bodies.position[1] = (9_999.0, 0.0, 50.0)
    world.impose(np.array([0]), _pose((10_000.0, 0.0, 50.0), (-5.0, 0.0, 0.0)))
    notes = _straight_on(world, 2, 600)
    assert ("event.collision", "green/b") in _kinds(notes)


@pytest.mark.parametrize(("far_m", "kinds"), [(JUMP_M - 0.1, ["event.collision"]), (JUMP_M + 0.1, ["event.jump"])])
def test_only_what_is_near_is_a_way_through_a_wall(far_m: float, kinds: list[str]) -> None:
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 15.0), led=[0], city=_block(2.0, -9.0, 2.1, 9.0, height_m=30.0))
    world.impose(slice(None), _pose((far_m, 0.0, 15.0), (1.0, 0.0, 0.0)))
    assert [note.kind for note in world.advance(QUANTUM_NS)] == kinds
    assert world._bodies.position[0, 0] == pytest.approx(far_m + QUANTUM_S)


def _straight_on(world: World, first: int, ticks: int) -> list[Note]:
    notes: list[Note] = []
    for tick in range(first, first + ticks):
        place = (10_000.0 - 5.0 * (tick - first) * QUANTUM_S, 0.0, 50.0)
        world.impose(np.array([0]), _pose(place, (-5.0, 0.0, 0.0)))
        notes += world.advance(tick * QUANTUM_NS)
    return notes


def test_handed_back_it_falls_from_where_it_is() -> None:
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 20.0), led=[0])
    notes = _straight(world, 0, (0.0, 0.0, 20.0), (5.0, 0.0, 0.0), 100)
    world.impose(slice(None), _pose((90.0, 0.0, 20.0)))  # too late to count
    world.set_source(np.array([0]), Source.DYNAMIC)
    assert world.sources == (Source.DYNAMIC,)
    for tick in range(101, 2000):
        notes += world.advance(tick * QUANTUM_NS)
    assert [note.kind for note in notes] == ["event.contact", "event.crash"]
    dropped = World([Body("blue/a", "iris", 1.25, 0.0, 20.0, 90.0)])
    dropped._bodies.velocity[0] = (5.0, 0.0, 0.0)
    same = [note for tick in range(100, 2000) for note in dropped.advance(tick * QUANTUM_NS)]
    assert notes[0].data["speed_mps"] == pytest.approx(same[0].data["speed_mps"], rel=1e-9)
    assert world._bodies.position[0] == pytest.approx(dropped._bodies.position[0], rel=1e-9)
    with pytest.raises(ValueError, match="on blue/a, which the world moves"):
        world.impose(slice(None), _pose((0.0, 0.0, 1.0)))
    world.set_source(np.array([0]), Source.KINEMATIC)
    world.advance(2000 * QUANTUM_NS)
    assert world._bodies.position[0] == pytest.approx(dropped._bodies.position[0], rel=1e-9)


def test_motors_that_its_engine_reports_drain_the_battery_and_shake_the_sensors() -> None:
    def flown(command: float) -> tuple[float, float, float]:
        world = _world(Body("blue/a", "iris", 0.0, 0.0, 20.0, seed=3), led=[0], sensors=SensorSpec(1.0))
        felt = []
        for tick in range(1, 800):
            world.actuate(slice(None), np.full((1, 4), command))
            world.impose(slice(None), _pose((0.0, 0.0, 20.0)))
            world.advance(tick * QUANTUM_NS)
            felt.append(float(world.sensors(slice(None)).accel_mps2[0, 0]))
        truth = world.truth()
        assert truth["throttle"][0] == command
        assert world._bodies.position[0].tolist() == [0.0, 0.0, 20.0]
        return float(truth["battery_a"][0]), float(truth["charge"][0]), float(np.std(felt))

    resting, hovering = flown(0.0), flown(IRIS.hover_command)
    assert resting[0] == pytest.approx(IRIS.avionics_w / 12.5, rel=0.02)
    assert 10.0 < hovering[0] < 40.0  # an Iris hovers on some 20 A
    assert hovering[1] < resting[1] < 1.0
    assert hovering[2] == pytest.approx(resting[2] + IRIS.hover_command * ACCEL_MOTORS_MPS2, rel=0.2)


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        (_pose((math.nan, 0.0, 1.0)), r"blue/a the position_enu_m \[nan, 0.0, 1.0\], expected finite metres"),
        (_pose((math.inf, 0.0, 1.0)), "position_enu_m"),
        (_pose((0.0, -1e7, 1.0)), "at most 1e"),
        (_pose((0.0, 0.0, 1.0), (0.0, math.nan, 0.0)), "vel_enu_mps"),
        (_pose((0.0, 0.0, 1.0), (0.0, 2e3, 0.0)), "vel_enu_mps"),
        (_pose((0.0, 0.0, 1.0), attitude=(0.0, 0.0, 0.0, 0.0)), "attitude .* length 1"),
        (_pose((0.0, 0.0, 1.0), attitude=(1.0, math.nan, 0.0, 0.0)), "attitude"),
        (_pose((0.0, 0.0, 1.0), attitude=(1e308, 1e308, 0.0, 0.0)), "attitude"),
        (_pose((0.0, 0.0, 1.0), rates=(0.0, 0.0, math.inf)), "rates_radps"),
        (
            Poses(np.array([True, True]), np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 4)), np.zeros((2, 3))),
            "shapes",
        ),
        (Poses(np.array([True]), np.zeros(3), np.zeros(3), np.zeros(4), np.zeros(3)), "shapes"),
    ],
)
def test_what_no_body_can_be_is_refused_and_changes_nothing(pose: Poses, said: str) -> None:
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 20.0), led=[0])
    with pytest.raises(ValueError, match=said):
        world.impose(slice(None), pose)
    world.advance(QUANTUM_NS)
    assert world._bodies.position[0].tolist() == [0.0, 0.0, 20.0]


def test_a_quaternion_nearly_of_length_1_becomes_one() -> None:
    world = _world(Body("blue/a", "iris", 0.0, 0.0, 20.0), led=[0])
    world.impose(slice(None), _pose((0.0, 0.0, 20.0), attitude=(1.005, 0.0, 0.0, 0.0)))
    world.advance(QUANTUM_NS)
    assert world._bodies.attitude[0].tolist() == [1.0, 0.0, 0.0, 0.0]
