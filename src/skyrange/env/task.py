"""The task "hold the mission": who its agents are, what they may do and see, and what a step is worth to each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.chance import Chance
from skyrange.core.elementary_python import add_up
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.extras import missing_module
from skyrange.core.ids import hash64, operator_of, vehicle_id
from skyrange.core.time import Time, from_seconds, to_seconds
from skyrange.env.acts import RED, BlueAct, RedAct, blue_agent
from skyrange.env.observations import FEATURES
from skyrange.env.outcomes import Outcomes, Rewards
from skyrange.scenario.model.fleet import Start, Vehicle
from skyrange.scenario.model.operators import Operator
from skyrange.scenario.model.plan import square
from skyrange.scenario.model.scenario import Origin, Scenario, Wind
from skyrange.scenario.shipped import load as load_scenario

try:
    from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space
except ImportError as error:
    raise missing_module(error.name or "gymnasium", "env", "skyrange.env") from error

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]
WHO: Final = "environment"
MAX_SEED: Final = 2**63 - 1
MAX_AIRCRAFT: Final = 100
_APART_M = 40.0
_SIDE_M = 25.0
_ALT_M = 10.0
_DEPART_S = 4.0


class Choices(NamedTuple):
    """What all agents do in a step."""

    red: tuple[str, RedAct | None]
    """The aircraft and the act; "" and None for nothing."""
    blue: Mapping[str, Mapping[str, BlueAct]]
    """By agent and aircraft."""


class StepResult(NamedTuple):
    """What a step of one world returns, each by agent, as a PettingZoo `ParallelEnv` does."""

    observations: Observations
    rewards: dict[str, float]
    terminations: dict[str, bool]
    truncations: dict[str, bool]
    infos: Infos

    @property
    def is_last(self) -> bool:
        """Whether the episode has ended."""
        return any(self.terminations.values()) or any(self.truncations.values())


def make_scenario(aircraft: int = 3, *, duration_s: float = 75.0, seed: int = 1) -> Scenario:
    """A fleet of the operator `blue`, whose aircraft (1 to 100) fly squares of 25 m side by side, 10 m high.

    Each departs at 4 s, and would land after about a minute. `duration_s` is the longest an episode lasts in simulated
    seconds. Raises `InputError` for another number of aircraft.
    """
    if isinstance(aircraft, bool) or not isinstance(aircraft, int) or not 1 <= aircraft <= MAX_AIRCRAFT:
        raise InputError.one(WHO, "aircraft", aircraft, f"a whole number from 1 to {MAX_AIRCRAFT}")
    vehicles = tuple(
        Vehicle(
            id=f"b{number + 1}",
            start=Start(east_m=number * _APART_M, north_m=0.0),
            plan=square(_SIDE_M, _ALT_M),
            depart_s=_DEPART_S,
        )
        for number in range(aircraft)
    )
    return Scenario(
        name="hold-the-mission",
        seed=seed,
        duration_s=duration_s,
        origin=Origin(lat=47.3977, lon=8.5456),
        wind=Wind(speed_mps=2.0),
        operators=(Operator(id="blue", vehicles=vehicles),),
    )


def check_scenario(scenario: Scenario) -> None:
    """Raise `InputError` for a scenario that this task cannot be played on."""
    problems = []
    for operator in scenario.operators:
        if operator.signing != "off":
            expected = "'off', because the commands of the agents are not signed"
            problems.append(Problem(f"operators.{operator.id}.signing", repr(operator.signing), expected))
    for operator, vehicle in scenario.fleet:
        where = f"operators.{operator.id}.vehicles.{vehicle.id}"
        if vehicle.autopilot != "builtin":
            problems.append(
                Problem(f"{where}.autopilot", repr(vehicle.autopilot), "'builtin', which repeats to the byte")
            )
        if vehicle.plan.mode == "guided":
            problems.append(Problem(f"{where}.plan.mode", "'guided'", "'auto', because agents command the mode AUTO"))
    if problems:
        raise InputError(f"scenario {scenario.name}", problems)


class Task:
    """Agents, spaces and rewards of the task on one scenario."""

    def __init__(
        self, scenario: Scenario | str | Path | None, aircraft: int | None, step_s: float, rewards: Rewards | None
    ) -> None:
        """As `HoldTheMission`. Raises `InputError`."""
        if scenario is not None and aircraft is not None:
            raise InputError.one(WHO, "aircraft", aircraft, "nothing, because the scenario has its aircraft")
        if isinstance(step_s, bool) or not isinstance(step_s, (int, float)) or not 0.1 <= step_s <= 60:
            raise InputError.one(WHO, "step_s", step_s, "a number of seconds from 0.1 to 60")
        if rewards is not None and not isinstance(rewards, Rewards):
            raise InputError.one(WHO, "rewards", rewards, "skyrange.env.Rewards")
        if scenario is None:
            scenario = make_scenario(3 if aircraft is None else aircraft)
        elif not isinstance(scenario, Scenario):
            scenario = load_scenario(scenario)
        check_scenario(scenario)
        self.scenario = scenario
        self.rewards = rewards or Rewards()
        self.step_ns = from_seconds(step_s)
        if from_seconds(scenario.duration_s) < self.step_ns:
            expected = f"at most the scenario's duration of {scenario.duration_s:g} s"
            raise InputError.one(WHO, "step_s", step_s, expected)
        self.vehicles: Sequence[str] = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet]
        """All aircraft, in the order of red's actions."""
        operators = list(dict.fromkeys(map(operator_of, self.vehicles)))
        self.aircraft_of: Mapping[str, Sequence[str]] = {
            RED: self.vehicles,
            **{
                blue_agent(operator): [name for name in self.vehicles if operator_of(name) == operator]
                for operator in operators
            },
        }
        """By agent, the aircraft in the order of the rows of its observations, and of a blue agent's actions."""
        self.agents = list(self.aircraft_of)
        self.action_spaces: dict[str, Space[Any]] = {
            agent: Discrete(1 + len(RedAct) * len(rows)) if agent == RED else MultiDiscrete([len(BlueAct)] * len(rows))
            for agent, rows in self.aircraft_of.items()
        }
        low = np.array([feature.low for feature in FEATURES], dtype=np.float32)
        high = np.array([feature.high for feature in FEATURES], dtype=np.float32)
        self.observation_spaces: dict[str, Space[Any]] = {
            agent: Box(np.tile(low, (len(rows), 1)), np.tile(high, (len(rows), 1)))
            for agent, rows in self.aircraft_of.items()
        }

    def find_agent(self, agent: str) -> str:
        """The name of an agent; `InputError` for an unknown one."""
        if agent not in self.aircraft_of:
            expected = f"an agent: {', '.join(self.agents)}"
            raise InputError.one(WHO, "agent", agent, expected, nearest(str(agent), self.agents))
        return agent

    def read_actions(self, actions: Mapping[str, Any], where: str = "actions") -> Choices:
        """What the actions of all agents mean. Raises `InputError` for one that is missing or not in its space."""
        for agent in actions:
            self.find_agent(agent)
        chosen = {agent: self._read_action(agent, actions, where) for agent in self.agents}
        red = int(chosen.pop(RED))
        place, act = divmod(red - 1, len(RedAct))
        return Choices(
            (self.vehicles[place], RedAct(act)) if red else ("", None),
            {
                agent: dict(zip(self.aircraft_of[agent], map(BlueAct, action), strict=True))
                for agent, action in chosen.items()
            },
        )

    def _read_action(self, agent: str, actions: Mapping[str, Any], where: str) -> Any:
        """The action of an agent, a number or a list of numbers."""
        space = self.action_spaces[agent]
        if agent not in actions:
            raise InputError.one(WHO, f"{where}.{agent}", "missing", f"an action of {space}")
        value = np.asarray(actions[agent])
        wanted = () if agent == RED else (len(self.aircraft_of[agent]),)
        whole = value.dtype.kind in "iu" and value.shape == wanted
        most = space.n if isinstance(space, Discrete) else len(BlueAct)
        if not whole or (value < 0).any() or (value >= most).any():
            raise InputError.one(WHO, f"{where}.{agent}", repr(actions[agent]), f"an action of {space}")
        return value.tolist()

    def reward(
        self, choices: Choices, begun: Time, scores: Mapping[str, float], outcomes: Outcomes
    ) -> dict[str, float]:
        """By agent, what the step that began at `begun` is worth; `scores` are those of `Outcomes.end_step`."""
        _, act = choices.red
        rewards = {RED: -add_up(scores.values()) - self.rewards.hostile_act * (act is not None)}
        for agent, acts in choices.blue.items():
            reactions = [name for name, blue_act in acts.items() if blue_act is not BlueAct.NOTHING]
            cost = self.rewards.false_reaction * outcomes.count_false(begun, reactions)
            rewards[agent] = add_up(scores[name] for name in acts) - cost
        return rewards

    def inform(self, now: Time, outcomes: Outcomes) -> Infos:
        """The infos of all agents."""
        return {
            agent: {
                "time_s": to_seconds(now),
                "progress": {name: progress.share for name, progress in outcomes.progress.items()},
                "mishaps": {name: list(kinds) for name, kinds in outcomes.mishaps.items()},
            }
            for agent in self.agents
        }

    def end_step(
        self, choices: Choices, begun: Time, now: Time, scores: Mapping[str, float], outcomes: Outcomes,
        observations: Observations,
    ) -> StepResult:  # fmt: skip
        """The result of a step from `begun` to `now`."""
        over = outcomes.over
        late = now + self.step_ns > from_seconds(self.scenario.duration_s)
        return StepResult(
            observations,
            self.reward(choices, begun, scores, outcomes),
            dict.fromkeys(self.agents, over),
            dict.fromkeys(self.agents, late and not over),
            self.inform(now, outcomes),
        )


def check_seed(seed: Any) -> int:
    """A seed as a whole number; `InputError` where it is none from 0 to `MAX_SEED`."""
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed <= MAX_SEED:
        raise InputError.one(WHO, "seed", seed, f"a whole number from 0 to {MAX_SEED}")
    return int(seed)


class Seeds:
    """The seeds of one episode after another."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._since = 0

    def next(self, seed: int | None = None) -> int:
        """The seed of the next episode: `seed` where it is given, else one that follows from the last given one."""
        if seed is not None:
            self._seed, self._since = check_seed(seed), 0
        chosen = self._seed
        if self._since:
            first, *_ = Chance(self._seed).uniform4("env.episode", hash64(WHO), self._since, 0)
            chosen = int(first * 2**53)
        self._since += 1
        return chosen
