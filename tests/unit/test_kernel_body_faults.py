"""Do body faults disturb the world while their fault acts, and leave it alone to the bit at all other times?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from skyrange.contracts.components import BodyAct, BodyHook, Disturbances
from skyrange.contracts.links import Act, LinkSpec
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import Time
from skyrange.kernel import EngineMount, Kernel, Wiring
from skyrange.world.airframes import IRIS
from skyrange.world.bodies import Body, Wind
from skyrange.world.world import World
from tests.probes.toys import MS, Climber, Log

FLEET = ["blue/b1", "blue/b2", "green/g1"]


class Hoverer(Climber):
    """Commands hover thrust to every motor; `moves` may be set."""

    def finish(self, tick: Time, wall_deadline_s: float) -> Any:
        done = super().finish(tick, wall_deadline_s)
        done.outbox.departures.clear()
        done.actuators = np.full((len(self.vehicles), 4), IRIS.hover_command)
        return done


@dataclass
class Weather:
    """Halves the thrust of motor 2, and blows upwards."""

    name: str
    vehicles: Sequence[str]
    share: float = 0.5
    up_mps: float = 3.0
    says: str = ""
    calls: int = 0

    def on_bodies(self, now: Time, bodies: Disturbances) -> Sequence[BodyAct]:
        bodies.thrust_share[:, 1] = self.share
        bodies.wind_enu_mps[:, 2] = self.up_mps
        self.calls += 1
        return [BodyAct(self.says or vehicle, "wind") for vehicle in self.vehicles] if self.calls == 1 else []


def rig(*plans: Act, gusty: bool = False, moves: Sequence[str] = ()) -> tuple[Kernel, World, Log]:
    bodies = [Body(vehicle, "iris", 10.0 * k, 0.0, 50.0, seed=3) for k, vehicle in enumerate(FLEET)]
    world = World(bodies, wind=Wind((2.0, 0.0, 0.0), 10.0 if gusty else 0.0))
    engine = Hoverer("hover", FLEET)
    engine.moves = moves
    links = [LinkSpec(f"autopilot:{v}", f"{v}.proxy", f"{v}.autopilot") for v in FLEET]
    log = Log()
    return Kernel(Wiring(1, links, world=world, acts=plans, engines=[EngineMount(engine, slice(None))]), [log]), (
        world
    ), log  # fmt: skip


def plan(*faults: BodyHook, muted: bool = False, id_: str = "storm") -> Act:
    return Act(id_, 20 * MS, 40 * MS, muted, role="fault", body_hooks=faults)


def state(world: World) -> dict[str, list[bytes]]:
    return {name: [value.tobytes() for value in column] for name, column in world.truth().items()}


@pytest.mark.parametrize("gusty", [False, True])
def test_the_world_is_disturbed_from_the_tick_of_the_start_to_that_of_the_stop(gusty: bool) -> None:
    kernel, world, _ = rig(plan(Weather("w", ["green/g1"])), gusty=gusty)
    clean, quiet, _ = rig(gusty=gusty)
    for until in (20 * MS, 39 * MS, 41 * MS):
        kernel.advance(until)
        clean.advance(until)
        wind, still = world.truth()["wind_up_mps"], quiet.truth()["wind_up_mps"]
        assert (wind - still).tolist() == pytest.approx([0.0, 0.0, 0.0 if until > 40 * MS else 3.0])
        ours, theirs = state(world), state(quiet)
        assert [column[:2] for column in ours.values()] == [column[:2] for column in theirs.values()], "the others"
        if until == 20 * MS:
            assert ours["up_m"] == theirs["up_m"], "what is set at a tick moves bodies from there on"
        if until == 39 * MS:
            assert ours["rate_y_radps"][2] != theirs["rate_y_radps"][2], "motor 2 is at the rear"
    rotors = world.sensors(slice(None)).rotor_radps
    assert rotors[0].tobytes() == quiet.sensors(slice(None)).rotor_radps[0].tobytes()


def test_a_weak_motor_settles_at_the_root_of_its_share_and_recovers() -> None:
    kernel, world, _ = rig(Act("weak", 20 * MS, 400 * MS, role="fault", body_hooks=[Weather("w", ["blue/b1"])]))
    kernel.advance(399 * MS)
    rotor = world.sensors(slice(None)).rotor_radps[0]
    assert rotor[1] / rotor[0] == pytest.approx(np.sqrt(0.5), rel=1e-3)
    kernel.advance(900 * MS)
    rotor = world.sensors(slice(None)).rotor_radps[0]
    assert rotor[1] == pytest.approx(rotor[0], rel=1e-6)


def test_faults_multiply_thrust_and_add_wind() -> None:
    kernel, world, _ = rig(plan(Weather("a", FLEET[:2], 0.5, 3.0)), plan(Weather("b", FLEET[1:], 0.5, -1.0), id_="two"))
    kernel.advance(30 * MS)
    assert world.truth()["wind_up_mps"].tolist() == [3.0, 2.0, -1.0]
    assert world._bodies.speed_share[:, 1] == pytest.approx([np.sqrt(0.5), 0.5, np.sqrt(0.5)])


@pytest.mark.parametrize("gusty", [False, True])
def test_muted_it_leaves_the_world_the_same_to_the_bit(gusty: bool) -> None:
    fault = Weather("w", FLEET)
    kernel, world, log = rig(plan(fault, muted=True), gusty=gusty)
    clean, quiet, _ = rig(gusty=gusty)
    kernel.advance(300 * MS)
    clean.advance(300 * MS)
    assert state(world) == state(quiet)
    assert log.labels == []
    assert fault.calls == 0, "it is not asked"


def test_acts_are_labelled_as_those_of_a_fault_with_an_id_of_their_own() -> None:
    kernel, _, log = rig(plan(Weather("w", ["blue/b1", "green/g1"])))
    kernel.advance(60 * MS)
    assert [(label.at_ns, label.actor, label.action, label.fault) for label in log.labels] == [
        (20 * MS, "w", "body", True)
    ] * 2
    assert [str(label.frame) for label in log.labels] == ["wind:blue/b1|fwd|w|0", "wind:green/g1|fwd|w|0"]


def test_a_fork_goes_on_alike_and_apart() -> None:
    kernel, world, _ = rig(plan(Weather("w", ["blue/b1"])), gusty=True)
    kernel.advance(25 * MS)
    twin = kernel.fork([])
    assert isinstance(twin._world, World)
    kernel.advance(300 * MS)
    assert state(twin._world) != state(world)
    twin.advance(300 * MS)
    assert state(twin._world) == state(world)


def test_what_cannot_be_is_an_error() -> None:
    with pytest.raises(InputError, match="a vehicle"):
        rig(plan(Weather("w", ["blue/b9"])))
    with pytest.raises(InputError, match="each vehicle once"):
        rig(plan(Weather("w", ["blue/b1", "blue/b1"])))
    with pytest.raises(InputError, match="a name that no other body fault has"):
        rig(plan(Weather("w", ["blue/b1"]), Weather("w", ["blue/b2"])))
    with pytest.raises(InputError, match="an aircraft that the world moves"):
        rig(plan(Weather("w", FLEET)), moves=["blue/b2"])
    with pytest.raises(InputError, match="only a benign fault acts on bodies"):
        rig(Act("storm", body_hooks=[Weather("w", FLEET)]))
    kernel, _, _ = rig(plan(Weather("w", ["blue/b1"], says="blue/b2")))
    with pytest.raises(ComponentError, match="not its own"):
        kernel.advance(60 * MS)
