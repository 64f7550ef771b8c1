"""Is each of many worlds what `HoldTheMission` is alone, whenever its episodes end and begin?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from skyrange.core.errors import ComponentError, InputError
from skyrange.env import (
    HoldTheMission,
    HoldTheMissionVector,
    HoldTheMissionWorlds,
    Quiet,
    RandomPolicy,
    ScriptedBlue,
    ScriptedRed,
    StepResult,
    make_scenario,
)
from skyrange.env.policies import Policy
from skyrange.scenario.model.plan import square
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load

pytestmark = pytest.mark.rotating

BLUE = "blue_blue"
SHORT = make_scenario(2, duration_s=16)


def low_scenario() -> Scenario:
    """One aircraft that flies 6 m high, so that it has landed a few seconds after red orders it to."""
    scenario = make_scenario(1, duration_s=27)
    (blue,) = scenario.operators
    (vehicle,) = blue.vehicles
    low = vehicle.model_copy(update={"plan": square(25.0, 6.0), "depart_s": 1.0})
    return scenario.model_copy(update={"operators": (blue.model_copy(update={"vehicles": (low,)}),)})


LANDS = low_scenario()


def require_equal(one: StepResult, other: StepResult) -> None:
    assert one[1:] == other[1:]
    require_equal_observations(one.observations, other.observations)


def require_equal_observations(one: Mapping[str, Any], other: Mapping[str, Any]) -> None:
    assert one.keys() == other.keys()
    for agent, observation in one.items():
        assert observation.dtype == other[agent].dtype
        assert observation.tobytes() == other[agent].tobytes(), agent


class Player:
    """A world alone, and the policies that play it there and among others."""

    def __init__(self, environment: HoldTheMission, number: int) -> None:
        self.environment = environment
        self.number = number
        self.policies = {
            agent: RandomPolicy(environment.action_space(agent), 10 * number + place)
            for place, agent in enumerate(environment.possible_agents)
        }
        self.actions: dict[str, Any] = {}
        self.steps = 0
        """Of this episode."""

    def choose(self) -> dict[str, Any]:
        """The actions of the next step; in world 1 the aircraft is ordered to land once it flies."""
        self.actions = {agent: policy(np.zeros(0, np.float32)) for agent, policy in self.policies.items()}
        if self.number == 1:
            self.steps += 1
            self.actions = {"red": int(self.steps > 6), BLUE: [0] * len(self.environment.vehicles)}
        return self.actions


def test_each_world_is_hold_the_mission_alone() -> None:
    worlds = HoldTheMissionWorlds(3, SHORT)
    players = [Player(HoldTheMission(SHORT), number) for number in range(3)]
    for world, (observations, infos) in worlds.reset({0: 7, 1: 8, 2: 2**62}).items():
        alone, told = players[world].environment.reset(seed=[7, 8, 2**62][world])
        require_equal_observations(alone, observations)
        assert infos == told
    for _ in range(16):
        results = worlds.step({player.number: player.choose() for player in players})
        for player in players:
            require_equal(player.environment.step(player.actions), results[player.number])
    assert worlds.under_way == []
    assert all(result.is_last for result in results.values())


def test_episodes_end_and_begin_by_themselves() -> None:
    scenario = LANDS.model_copy(update={"duration_s": 15.0})
    worlds = HoldTheMissionWorlds(3, scenario)
    players = [Player(HoldTheMission(scenario), number) for number in range(3)]
    worlds.reset()
    for player in players:
        player.environment.reset(seed=1 + player.number)
    begun: dict[int, int] = {}
    for step in range(20):
        results = worlds.step({player.number: player.choose() for player in players})
        for player in players:
            require_equal(player.environment.step(player.actions), results[player.number])
        ended = [world for world, result in results.items() if result.is_last]
        for world, (observations, _) in worlds.reset(dict.fromkeys(ended)).items():
            require_equal_observations(players[world].environment.reset()[0], observations)
            begun[world] = step
            players[world].steps = 0
    assert begun[1] < begun[0] == begun[2]
    assert worlds.groups > 1
    worlds.close()
    assert worlds.under_way == []


def test_attacks_of_a_scenario_act_in_every_world() -> None:
    scenario = load("gnss.drift", ["duration_s=30"])
    worlds, alone = HoldTheMissionWorlds(2, scenario), HoldTheMission(scenario)
    worlds.reset({0: 3, 1: 4})
    alone.reset(seed=4)
    quiet = {agent: Quiet(agent)(np.zeros((len(worlds.aircraft_of[agent]), 1), np.float32)) for agent in worlds.agents}
    for _ in range(20):
        require_equal(alone.step(quiet), worlds.step({0: quiet, 1: quiet})[1])


class OneAgent(gymnasium.Env):  # type: ignore[misc]
    """`HoldTheMission` as one agent sees it, the adversary being `ScriptedRed`."""

    def __init__(self) -> None:
        self.environment = HoldTheMission(LANDS)
        self.action_space = self.environment.action_space(BLUE)
        self.observation_space = self.environment.observation_space(BLUE)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        self.red = ScriptedRed()
        self.seen, infos = self.environment.reset(seed)
        return self.seen[BLUE], infos[BLUE]

    def step(self, action: Any) -> tuple[Any, ...]:
        result = self.environment.step({"red": self.red(self.seen["red"]), BLUE: action})
        self.seen = result.observations
        return tuple(part[BLUE] for part in result)


def scripted(agent: str, world: int) -> Policy:
    return ScriptedRed()


@pytest.mark.parametrize("policy", [Quiet(BLUE), ScriptedBlue()])
def test_the_vector_environment_is_gymnasiums_over_single_ones(policy: Policy) -> None:
    """With and without a defence: without one, the first episodes end early and others begin."""
    vector, single = HoldTheMissionVector(2, BLUE, LANDS, make_policy=scripted), SyncVectorEnv([OneAgent] * 2)
    assert vector.action_space == single.action_space
    assert vector.observation_space == single.observation_space
    (one, told), (other, infos) = vector.reset(seed=5), single.reset(seed=5)
    ended = 0
    for _ in range(30):
        assert one.tobytes() == other.tobytes()
        assert one.dtype == other.dtype
        assert repr(told) == repr(infos)
        actions = np.stack([policy(observation) for observation in one])
        one, *mine, told = vector.step(actions)
        other, *theirs, infos = single.step(actions)
        for array, expected in zip(mine, theirs, strict=True):
            assert (array == expected).all()
            assert array.dtype == expected.dtype
        ended += int((mine[1] | mine[2]).sum())
    assert ended > 0
    vector.close()


def test_a_flight_that_fails_ends_the_episodes_of_its_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = HoldTheMissionWorlds(2, SHORT)
    worlds.reset()
    group, _ = worlds._places[0]

    def fail(until: int) -> None:
        raise ComponentError("kernel", "failed")

    monkeypatch.setattr(group._kernel, "advance", fail)
    quiet = {"red": 0, BLUE: [0, 0]}
    with pytest.raises(ComponentError, match="failed"):
        worlds.step({0: quiet, 1: quiet})
    assert worlds.under_way == []


def test_what_does_not_fit_is_named_and_nothing_is_flown() -> None:
    for count in (0, 1.5, True):
        with pytest.raises(InputError, match=r"count: .*a whole number of worlds"):
            HoldTheMissionWorlds(count)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="expected 'builtin'"):
        HoldTheMissionWorlds(2, load("rid-spoofing", ["operators.*.vehicles.*.autopilot=ardupilot"]))
    with pytest.raises(InputError, match="an agent: red, blue_blue"):
        HoldTheMissionVector(2, "green")
    worlds = HoldTheMissionWorlds(2, SHORT)
    quiet = {"red": 0, BLUE: [0, 0]}
    with pytest.raises(InputError, match="call reset before"):
        worlds.step({0: quiet})
    with pytest.raises(InputError, match="a whole number from 0 to 1"):
        worlds.reset({2: 1})
    worlds.reset()
    for actions, named in [
        ({0: quiet}, "nothing for the worlds"),
        ({0: quiet, 1: quiet, 2: quiet}, "worlds whose episode is under way"),
        ({0: quiet, 1: {"red": 0}}, r"actions\.1\.blue_blue"),
        ({0: quiet, 1: {"red": 99, BLUE: [0, 0]}}, r"actions\.1\.red"),
    ]:
        with pytest.raises(InputError, match=named):
            worlds.step(actions)  # type: ignore[arg-type]
    assert worlds.under_way == [0, 1]
    vector = HoldTheMissionVector(2, BLUE, SHORT)
    with pytest.raises(InputError, match="a call of reset before"):
        vector.step(np.zeros((2, 2), np.int64))
    with pytest.raises(InputError, match="a seed, or 2 of them"):
        vector.reset(seed=[1])
    vector.reset(seed=[1, None])
    with pytest.raises(InputError, match="one for each of 2 worlds"):
        vector.step(np.zeros((1, 2), np.int64))
