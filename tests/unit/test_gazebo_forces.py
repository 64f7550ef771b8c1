"""Do the sources of the Gazebo plugin compute the forces of the range's own physics? Compiled without Gazebo."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from skyrange.codec.gazebo_protocol import encode_hello
from skyrange.core.engine_sources import engine_sources
from skyrange.io.gazebo import GazeboSimulator
from skyrange.io.processes.program import run_once
from skyrange.vehicle.contract import VehicleSpec
from skyrange.vehicle.gazebo.fleet import describe_aircraft
from skyrange.world import AIRFRAMES, Body, World

COMPILER = shutil.which("g++")
pytestmark = pytest.mark.external(missing="" if COMPILER else "no g++ found")
COUNT = 48
QUANTUM_NS = 2_500_000
QUANTUM_S = QUANTUM_NS / 1e9


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    assert COMPILER is not None
    made = tmp_path_factory.mktemp("stand-in") / "stand-in"
    source = Path(__file__).with_name("gazebo_stand_in.cc")
    warnings = ("-Wall", "-Wextra", "-Werror", "-Wshadow", "-Wconversion")
    include = f"-I{engine_sources('gazebo')}"
    told = run_once(
        Path(COMPILER), "-std=c++17", "-O1", *warnings, include, str(source), "-o", str(made), deadline_s=120.0
    )
    assert told.ended == "exit 0", told.text
    return made


class Tumbling:
    """Aircraft in the air in random states, in a world of their own and in the stand-in."""

    def __init__(self, program: Path, folder: Path, seed: int, steps: int = 1) -> None:
        chance = np.random.default_rng(seed)
        names = [sorted(AIRFRAMES)[k % len(AIRFRAMES)] for k in range(COUNT)]
        self.world = World([Body(f"blue/{k}", name, 50.0 * k, 0.0, 100.0) for k, name in enumerate(names)])
        world = self.world
        world.advance(0)
        quaternion = chance.normal(size=(COUNT, 4))
        world._bodies.attitude[:] = quaternion / np.linalg.norm(quaternion, axis=1)[:, None]
        world._bodies.velocity[:] = chance.normal(size=(COUNT, 3), scale=8.0)
        world._bodies.rates[:] = chance.normal(size=(COUNT, 3), scale=4.0)
        world._bodies.rotor_radps[:] = chance.uniform(0.0, 900.0, size=(COUNT, 4))
        world.actuate(slice(0, COUNT), chance.uniform(0.0, 1.0, size=(COUNT, 4)))
        self.air = chance.normal(size=(COUNT, 3), scale=5.0)
        world.disturb(np.arange(COUNT), np.ones((COUNT, 4)), self.air)
        airframes = [AIRFRAMES[name] for name in names]
        solid = np.array([(one.mass_kg, *one.inertia_kgm2) for one in airframes])
        states = np.concatenate(
            [world._bodies.position, world._bodies.velocity, world._bodies.attitude, world._bodies.rates], axis=1
        )
        file = folder / "bodies"
        np.concatenate([solid, states], axis=1).tofile(file)
        specs = [VehicleSpec(f"blue/{k}", 1, name) for k, name in enumerate(names)]
        hello = encode_hello(list(map(describe_aircraft, specs)), [], QUANTUM_S / steps, steps, 4)
        self.one = GazeboSimulator("stand-in", [str(program), str(file)], hello, (COUNT, 7))

    def step(self) -> tuple[np.ndarray, np.ndarray]:
        """One tick in both: the world's states as the stand-in's, and the stand-in's."""
        self.world.advance(QUANTUM_NS)
        inputs = self.world.body_inputs(slice(0, COUNT))
        numbers = np.concatenate([inputs.rotor_radps, self.air, np.zeros((COUNT, 6))], axis=1)
        self.one.begin_step(0, numbers, np.zeros((0, 7)))
        states = self.one.end_step(20.0).states
        ours = self.world
        return np.concatenate([ours._bodies.position, ours._bodies.velocity, ours._bodies.rates], axis=1), states[
            :, [*range(6), 10, 11, 12]
        ]


@pytest.fixture
def tumbling(program: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Tumbling]:
    made = Tumbling(program, tmp_path, request.param)
    yield made
    made.one.close()


@pytest.mark.parametrize("tumbling", [1, 2, 3], indirect=True)
def test_forces_and_torques_are_those_of_the_world(tumbling: Tumbling) -> None:
    ours, theirs = tumbling.step()
    assert np.abs(ours[:, 3:] - theirs[:, 3:]).max() < 1e-11
    assert ours[:, :3] == pytest.approx(theirs[:, :3], abs=1e-9)


@pytest.mark.parametrize("tumbling", [4], indirect=True)
def test_impulses_act_once_whatever_the_number_of_steps(tumbling: Tumbling, program: Path, tmp_path: Path) -> None:
    impulse = np.zeros((COUNT, 13))
    impulse[:, 7:10] = (3.0, -2.0, 1.0)
    folder = tmp_path / "finer"
    folder.mkdir()
    finer = Tumbling(program, folder, 4, steps=5)
    for made, least in ((tumbling, 1e-9), (finer, 0.02)):
        still = Tumbling(program, tmp_path, 4).one if made is tumbling else Tumbling(program, folder, 4, steps=5).one
        found = []
        for one, numbers in ((made.one, impulse), (still, np.zeros_like(impulse))):
            one.begin_step(0, numbers, np.zeros((0, 7)))
            found.append(one.end_step(20.0).states[:, 3:6])
        mass = np.array([airframe.mass_kg for airframe in made.world.airframes])
        gained = (found[0] - found[1]) * mass[:, None]
        assert gained == pytest.approx(np.tile((3.0, -2.0, 1.0), (COUNT, 1)), abs=least)  # drag takes the rest
        still.close()
    finer.one.close()


@pytest.mark.parametrize("tumbling", [5], indirect=True)
def test_a_contact_is_told_from_the_aircraft_and_once_a_tick(tumbling: Tumbling) -> None:
    for tick in range(2):
        tumbling.one.begin_step(tick, np.zeros((COUNT, 13)), np.zeros((0, 7)))
        contacts = tumbling.one.end_step(20.0).contacts
        assert contacts[["vehicle", "other", "rotor", "other_rotor"]].tolist() == [(0, -7, 3, -1)]
        assert contacts["normal"].tolist() == [[0.0, -1.0, 0.0]]
        assert contacts["position_m"].tolist() == [[1.0, 2.0, 3.0]]
