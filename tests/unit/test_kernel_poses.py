"""Does an engine that moves its vehicles itself fly in a range, and is it blamed for poses that cannot be?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from skyrange.contracts.components import BodyInputs, EngineBase, Finished, InstanceStatus, Poses, Sensors, Source
from skyrange.contracts.links import LinkSpec
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.kernel import EngineMount, Kernel, Wiring
from skyrange.record import MemoryObserver, Recorder, load
from skyrange.world import AIRFRAMES, Body, World
from tests.unit.record_sample import HEADER

FLEET = ["blue/b1", "blue/b2", "green/g1"]
RADIUS_M = 4.0


class Rounds(EngineBase):
    """Flies some of its vehicles in circles by its own reckoning at 50 Hz, and has the world hover the others."""

    service_ns: Time = 20 * NS_PER_MS
    clock: Literal["lockstep", "wall"] = "lockstep"
    repeatable: Literal["bytes", "outcome"] = "bytes"
    preroll_ns: Time = 0

    def __init__(self, name: str, vehicles: Sequence[str], moves: Sequence[str] = ()) -> None:
        self.name = name
        self.vehicles: Sequence[str] = list(vehicles)
        self.moves: Sequence[str] = list(moves)
        self.ports: Sequence[Port] = [Port(f"{v}.autopilot", f"autopilot:{v}") for v in vehicles]
        self.dies_ns: Time | None = None
        self.spoils: dict[str, float] = {}
        self.seen: list[tuple[float, ...]] = []

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        self.seen.append(tuple(sensors.gnss_enu_m[0].tolist()))

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        n = len(self.vehicles)
        dead = self.dies_ns is not None and tick >= self.dies_ns
        moved = np.array([v in self.moves for v in self.vehicles])
        t = tick / NS_PER_S
        place = np.array([(100.0 * i + RADIUS_M * math.cos(t), RADIUS_M * math.sin(t), 30.0) for i in range(n)])
        speed = np.tile((-RADIUS_M * math.sin(t), RADIUS_M * math.cos(t), 0.0), (n, 1))
        poses = Poses(
            moved & (tick % self.service_ns == 0 and not dead), place, speed,
            np.tile((math.cos(0.5 * t), 0.0, 0.0, math.sin(0.5 * t)), (n, 1)), np.tile((0.0, 0.0, 1.0), (n, 1)),
        )  # fmt: skip
        for name, value in self.spoils.items():
            getattr(poses, name)[-1] = value
        motors = np.where(moved & dead, 0.0, AIRFRAMES["iris"].hover_command)[:, None] * np.ones((n, 4))
        lost = [InstanceStatus.DEAD if m and dead else InstanceStatus.READY for m in moved.tolist()]
        return Finished(motors, Outbox(), lost, poses if self.moves else None)


class Simulated(Rounds):
    """Flies by its own reckoning under the world's forces, at every tick."""

    source = Source.SIMULATOR
    service_ns: Time = 2_500_000

    def __init__(self, name: str, vehicles: Sequence[str], moves: Sequence[str] = ()) -> None:
        super().__init__(name, vehicles, moves)
        self.inputs: list[tuple[Time, BodyInputs]] = []

    def set_body_inputs(self, tick: Time, inputs: BodyInputs) -> None:
        assert len(self.seen) == len(self.inputs)  # before `begin`
        self.inputs.append((tick, inputs))


def _kernel(*engines: Rounds, observers: Sequence[Any] = (), on_silent: str = "stop") -> Kernel:
    world = World([Body(v, "iris", 100.0 * i + RADIUS_M, 0.0, 30.0) for i, v in enumerate(FLEET)])
    wiring = Wiring(
        seed=1,
        links=[LinkSpec(f"autopilot:{v}", f"{v}.proxy", f"{v}.autopilot") for v in FLEET],
        world=world,
        engines=[EngineMount(e, np.array([FLEET.index(v) for v in e.vehicles])) for e in engines],
        on_silent=on_silent,
    )
    return Kernel(wiring, observers)


def _columns(seen: MemoryObserver, row: int) -> list[tuple[float, ...]]:
    return [tuple(float(column[row]) for column in tick.columns.values()) for tick in seen.truth]


def test_one_engine_may_move_some_of_its_vehicles_and_leave_others_to_the_world() -> None:
    seen = MemoryObserver()
    engine = Rounds("mixed", ["green/g1", "blue/b1"], moves=["blue/b1"])
    _kernel(engine, Rounds("plain", ["blue/b2"]), observers=[seen]).advance(2 * NS_PER_S)
    assert {tick.sources for tick in seen.truth} == {(Source.KINEMATIC, Source.DYNAMIC, Source.DYNAMIC)}
    last = seen.truth[-1].columns
    # rows of the engine in its own order: b1 is its second, round 100 m east
    wanted = (100.0 + RADIUS_M * math.cos(2.0), RADIUS_M * math.sin(2.0), 30.0)
    assert [last[name][0] for name in ("east_m", "north_m", "up_m")] == pytest.approx(wanted, abs=0.001)
    assert last["up_m"][2] > 30.0  # a full battery lifts it


def test_the_others_fly_to_the_bit_as_without_it() -> None:
    def flown(moves: Sequence[str]) -> MemoryObserver:
        seen = MemoryObserver()
        one = Rounds("one", FLEET[:1], moves)
        _kernel(one, Rounds("two", FLEET[1:]), observers=[seen]).advance(2 * NS_PER_S)
        return seen

    led, free = flown(FLEET[:1]), flown([])
    assert _columns(led, 0) != _columns(free, 0)
    assert [_columns(led, row) for row in (1, 2)] == [_columns(free, row) for row in (1, 2)]


def test_its_sensors_read_where_it_has_been_put() -> None:
    engine = Rounds("one", FLEET, FLEET)
    _kernel(engine).advance(NS_PER_S)
    where = [(RADIUS_M * math.cos(k / 400.0), RADIUS_M * math.sin(k / 400.0), 30.0) for k in range(401)]
    assert np.array(engine.seen[1:]) == pytest.approx(np.array(where[1:]), abs=0.001)


def test_a_fork_flies_on_alike() -> None:
    stem, branch = MemoryObserver(), MemoryObserver()
    kernel = _kernel(Rounds("one", FLEET[:2], FLEET[1:2]), Rounds("two", FLEET[2:]), observers=[stem])
    kernel.advance(NS_PER_S)  # a pose has just been imposed: it waits for the next tick
    twin = kernel.fork([branch])
    stem.truth.clear()
    kernel.advance(2 * NS_PER_S)
    twin.advance(2 * NS_PER_S)
    assert [_columns(stem, row) for row in range(3)] == [_columns(branch, row) for row in range(3)]
    assert stem.truth[-1].sources == branch.truth[-1].sources == ("dynamic", "kinematic", "dynamic")


def test_what_a_dead_instance_flew_falls() -> None:
    seen = MemoryObserver()
    engine = Rounds("one", FLEET, FLEET[:1])
    engine.dies_ns = NS_PER_S
    _kernel(engine, observers=[seen], on_silent="continue").advance(6 * NS_PER_S)
    kinds = [(note.kind, note.about) for _, _, note in seen.notes]
    assert kinds == [("event.engine_dead", FLEET[0]), ("event.contact", FLEET[0]), ("event.crash", FLEET[0])]
    sources = [tick.sources[0] for tick in seen.truth]
    assert sources == ["kinematic"] * 10 + ["dynamic"] * 51
    assert seen.truth[-1].columns["up_m"][0] == 0.0


@pytest.mark.parametrize(
    ("spoils", "said"),
    [
        (
            {"position_enu_m": math.nan},
            r"engine bad: imposed on green/g1 the position_enu_m \[nan, nan, nan\].*0\.0000 s",
        ),
        ({"vel_enu_mps": math.inf}, r"engine bad: imposed on green/g1 the vel_enu_mps"),
        ({"attitude": 0.0}, r"engine bad: .*attitude \[0\.0, 0\.0, 0\.0, 0\.0\], expected a quaternion of length 1"),
        ({"rates_radps": 1e9}, r"engine bad: .*rates_radps"),
    ],
)
def test_a_pose_that_cannot_be_ends_the_run_and_blames_its_engine(spoils: dict[str, float], said: str) -> None:
    bad = Rounds("bad", FLEET[1:], FLEET[1:])
    bad.spoils = spoils
    with pytest.raises(ComponentError, match=said) as caught:
        _kernel(Rounds("good", FLEET[:1]), bad).advance(NS_PER_S)
    assert caught.value.exit_code == 3


def test_a_pose_of_what_the_world_moves_blames_the_engine() -> None:
    bad = Rounds("bad", FLEET, FLEET[:1])
    bad.spoils = {"fresh": True}
    with pytest.raises(ComponentError, match="engine bad: imposed a pose on green/g1, which the world moves"):
        _kernel(bad).advance(NS_PER_S)


def test_an_engine_moves_none_but_its_own() -> None:
    with pytest.raises(InputError, match=r"one\.moves: blue/b2 — expected a vehicle of its own"):
        _kernel(Rounds("one", FLEET[:1], FLEET[1:2]))


def test_the_record_says_what_moved_each(tmp_path: Path) -> None:
    recorder, seen = Recorder.open(tmp_path / "run", HEADER), MemoryObserver()
    engine = Rounds("one", FLEET, FLEET[:1])
    engine.dies_ns = NS_PER_S // 2
    _kernel(engine, observers=[recorder, seen], on_silent="continue").advance(NS_PER_S)
    recorder.close()
    record = load(tmp_path / "run")
    table = record.table("truth")
    by_vehicle: dict[str, list[str]] = {}
    for vehicle, source in zip(table.column("vehicle").to_pylist(), table.column("source").to_pylist(), strict=True):
        by_vehicle.setdefault(vehicle, []).append(source)
    count = len(by_vehicle[FLEET[0]])
    assert by_vehicle[FLEET[0]] == ["kinematic"] * (count // 2) + ["dynamic"] * (count - count // 2)
    assert set(by_vehicle[FLEET[1]] + by_vehicle[FLEET[2]]) == {"dynamic"}
    assert record.manifest["digests"]["truth"] == seen.digests.truth  # which hold the source too
    for tick in range(len(seen.truth)):
        seen.truth[tick] = seen.truth[tick]._replace(sources=("dynamic",) * 3)
    assert record.manifest["digests"]["truth"] != seen.digests.truth


def test_a_simulator_is_told_what_acts_on_its_bodies_and_keeps_those_of_dead_autopilots() -> None:
    engine, other = Simulated("sim", FLEET[1:], FLEET[1:]), Rounds("rounds", FLEET[:1])
    engine.dies_ns = NS_PER_S // 2
    seen = MemoryObserver()
    _kernel(engine, other, observers=[seen], on_silent="continue").advance(NS_PER_S)
    assert [tick for tick, _ in engine.inputs] == list(range(0, NS_PER_S + 1, 2_500_000))
    assert engine.inputs[-1][1].world_position_enu_m.shape == (3, 3)
    assert set(seen.truth[-1].sources) == {Source.DYNAMIC, Source.SIMULATOR}
    assert list(seen.truth[-1].sources).count(Source.SIMULATOR) == 2
    spinning = [inputs.rotor_radps.min() for _, inputs in engine.inputs]
    assert spinning[200] > 100.0
    assert spinning[-1] < 0.1 * spinning[200]  # a dead autopilot gives no commands
