"""Does the world keep its contract: ticks, sensors, actuators, truth, copies, and refusals?"""

from __future__ import annotations

import copy
import math
import subprocess
import sys

import numpy as np
import pytest

from skyrange.contracts.mailboxes import Note
from skyrange.core.errors import InputError
from skyrange.world import AIRFRAMES, Body, Wind, World

QUANTUM_NS = 2_500_000
IRIS = AIRFRAMES["iris"]
COLUMNS = [
    *("east_m", "north_m", "up_m", "vel_east_mps", "vel_north_mps", "vel_up_mps", "qw", "qx", "qy", "qz"),
    *("rate_x_radps", "rate_y_radps", "rate_z_radps", "throttle", "on_ground", "crashed"),
    *("battery_v", "battery_a", "charge", "wind_east_mps", "wind_north_mps", "wind_up_mps"),
]


def _fleet(n: int, up_m: float = 20.0) -> World:
    return World([Body(f"blue/b{i}", "iris", 10.0 * i, -3.0 * i, up_m, 7.0 * i) for i in range(n)])


def _commands(tick: int, n: int) -> np.ndarray:
    """Different for every aircraft, motor and tick, around hover."""
    i, m = np.arange(n)[:, None], np.arange(4)[None, :]
    return IRIS.hover_command + 0.05 * np.sin(0.37 * tick + 1.7 * i + 0.9 * m)


def _run(world: World, first: int, last: int) -> None:
    for tick in range(first, last):
        world.advance(tick * QUANTUM_NS)
        world.actuate(slice(None), _commands(tick, len(world.vehicles)))


def _bytes(world: World) -> bytes:
    return b"".join(column.tobytes() for column in world.truth().values())


def test_first_advance_is_the_initial_state() -> None:
    world = World([Body("blue/b1", "iris", 5.0, 7.0, 0.0, 90.0)])
    before = _bytes(world)
    assert list(world.advance(-8 * QUANTUM_NS)) == []
    assert _bytes(world) == before
    truth = world.truth()
    assert list(truth) == COLUMNS
    assert (truth["east_m"][0], truth["north_m"][0], truth["up_m"][0]) == (5.0, 7.0, 0.0)
    assert (truth["qw"][0], truth["qz"][0]) == (1.0, 0.0)  # heading 90 is east, the local x axis
    assert world.sensors(slice(0, 1)).accel_mps2[0].tolist() == [0.0, 0.0, 9.80665]


def test_heading_turns_clockwise_from_north() -> None:
    world = World([Body(f"blue/b{h}", "iris", 0, 0, heading_deg=h) for h in (0.0, 90.0, 180.0, 270.0)])
    truth = world.truth()
    yaw = 2.0 * np.arctan2(truth["qz"], truth["qw"])
    assert np.cos(yaw) == pytest.approx([0.0, 1.0, 0.0, -1.0], abs=1e-12)
    assert np.sin(yaw) == pytest.approx([1.0, 0.0, -1.0, 0.0], abs=1e-12)


def test_alone_or_among_a_thousand_to_the_bit() -> None:
    """An aircraft's numbers do not depend on how many others share the arrays."""
    alone, crowd = _fleet(1), _fleet(1000)
    for tick in range(400):
        alone.advance(tick * QUANTUM_NS)
        crowd.advance(tick * QUANTUM_NS)
        commands = _commands(tick, 1000)
        alone.actuate(slice(None), commands[:1])
        crowd.actuate(slice(None), commands)
    for name, column in alone.truth().items():
        assert column.tobytes() == crowd.truth()[name][:1].tobytes(), name
    accel = crowd.sensors(slice(0, 1)).accel_mps2
    assert alone.sensors(slice(0, 1)).accel_mps2.tobytes() == accel.tobytes()


def test_several_quanta_at_once_equal_one_by_one() -> None:
    stepped, leapt = _fleet(3, up_m=0.4), _fleet(3, up_m=0.4)
    notes: list[Note] = []
    for tick in range(401):
        notes += stepped.advance(tick * QUANTUM_NS)
    leapt.advance(0)
    assert leapt.advance(400 * QUANTUM_NS + QUANTUM_NS - 1) == notes
    assert len(notes) == 3
    assert _bytes(stepped) == _bytes(leapt)


def test_deep_copy_continues_identically_and_apart() -> None:
    world = _fleet(5)
    _run(world, 0, 200)
    world.sensors(slice(0, 5))  # views handed out before the copy must not tie the two together
    fork = copy.deepcopy(world)
    at_fork = _bytes(fork)
    _run(world, 200, 400)
    assert _bytes(fork) == at_fork
    _run(fork, 200, 400)
    assert _bytes(fork) == _bytes(world)
    assert fork.sensors(slice(0, 5)).gyro_radps.tobytes() == world.sensors(slice(0, 5)).gyro_radps.tobytes()
    assert fork.sensors(slice(0, 5)).gnss_enu_m[:, 2].tobytes() == fork.truth()["up_m"].tobytes()


def test_sensors_are_read_only_views_that_ticks_refill() -> None:
    world = _fleet(4)
    _run(world, 0, 10)
    some = world.sensors(slice(1, 3))
    assert some.gyro_radps.shape == some.accel_mps2.shape == some.gnss_enu_m.shape == (2, 3)
    assert some.attitude.shape == (2, 4)
    assert some.baro_up_m.shape == some.rangefinder_m.shape == (2,)
    for values in (some.gyro_radps, some.accel_mps2, some.attitude, some.gnss_enu_m, some.baro_up_m):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0
    before = some.gnss_enu_m[:, 2].copy()
    _run(world, 10, 20)
    assert (some.gnss_enu_m[:, 2] < before).all()
    assert (some.rangefinder_m == world.truth()["up_m"][1:3]).all()


def test_sensors_of_chosen_rows_keep_their_order() -> None:
    world = _fleet(4)
    world.advance(0)
    chosen = world.sensors(np.array([3, 0]))
    assert chosen.gnss_enu_m[:, 0].tolist() == [30.0, 0.0]


def test_actuates_chosen_rows_only() -> None:
    world = _fleet(3)
    world.advance(0)
    world.actuate(np.array([2, 0]), np.array([[0.8] * 4, [0.4] * 4]))
    assert world.truth()["throttle"].tolist() == pytest.approx([0.4, 0.0, 0.8])


def test_commands_beyond_their_range_are_clipped_and_nan_stops_a_motor() -> None:
    world, clean = _fleet(1), _fleet(1)
    for w, command in ((world, [np.nan, 7.0, -3.0, np.inf]), (clean, [0.0, 1.0, 0.0, 1.0])):
        w.advance(0)
        w.actuate(slice(None), np.array([command]))
        w.advance(100 * QUANTUM_NS)
    assert _bytes(world) == _bytes(clean)
    assert world.truth()["throttle"].tolist() == [0.5]


def test_accelerometer_reads_nothing_in_free_fall() -> None:
    world = _fleet(1, up_m=100.0)
    world.advance(0)
    assert world.sensors(slice(0, 1)).accel_mps2[0].tolist() == [0.0, 0.0, 0.0]
    world.advance(QUANTUM_NS)
    assert world.sensors(slice(0, 1)).accel_mps2[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_accelerometer_agrees_with_the_velocity() -> None:
    """Specific force is the change of velocity less gravity, turned into the body."""
    world = _fleet(1)
    _run(world, 0, 100)
    truth = world.truth()
    w, x, y, z = (truth[k][0] for k in ("qw", "qx", "qy", "qz"))
    before = np.array([truth[k][0] for k in ("vel_east_mps", "vel_north_mps", "vel_up_mps")])
    world.advance(100 * QUANTUM_NS)
    change = (world.sensors(slice(0, 1)).gnss_vel_enu_mps[0] - before) / 0.0025 + (0.0, 0.0, 9.80665)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert world.sensors(slice(0, 1)).accel_mps2[0] == pytest.approx(rotation.T @ change, abs=1e-9)


def test_motors_stand_and_turn_as_in_arducopters_quad_x() -> None:
    """1 front right, 2 rear left (both CCW), 3 front left, 4 rear right (both CW)."""
    quadrant = [(math.copysign(1, r.forward_m), math.copysign(1, r.left_m), r.spin) for r in IRIS.rotors]
    assert quadrant == [(1, -1, 1), (-1, 1, 1), (1, 1, -1), (-1, -1, -1)]


def test_time_only_runs_forward() -> None:
    world = _fleet(1)
    world.advance(10 * QUANTUM_NS)
    with pytest.raises(ValueError, match="forward"):
        world.advance(0)


def test_bad_bodies_are_refused_all_at_once() -> None:
    bodies = [
        Body("blue/b1", "irris", 0.0, 0.0),
        Body("blue/b1", "iris", math.nan, 0.0, -1.0, math.inf),
    ]
    with pytest.raises(InputError) as caught:
        World(bodies, quantum_ns=0, wind=Wind((0.0, math.nan, 0.0)))
    text = str(caught.value)
    for part in ("'irris'", "Did you mean 'iris'?", "vehicle", "east_m", "up_m", "heading_deg", "quantum_ns", "wind"):
        assert part in text
    assert len(caught.value.problems) == 7


def test_an_empty_world_is_refused() -> None:
    with pytest.raises(InputError, match="at least one aircraft"):
        World([])


def test_the_table_of_airframes_loads_no_compiler() -> None:
    """A scenario's schema reads the names at start-up."""
    code = "import sys, skyrange.world; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
