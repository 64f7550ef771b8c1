"""The task "hold the mission" as a PettingZoo `ParallelEnv`: operators keep missions going against an adversary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, nearest
from skyrange.core.ids import hash64, operator_of, vehicle_id
from skyrange.core.time import from_seconds, to_seconds
from skyrange.env.acts import RED, BlueAct, RedAct, blue_agent
from skyrange.env.episode import Episode, check_scenario
from skyrange.env.observations import FEATURES
from skyrange.env.outcomes import Rewards
from skyrange.scenario.model.fleet import Start, Vehicle
from skyrange.scenario.model.operators import Operator
from skyrange.scenario.model.plan import square
from skyrange.scenario.model.scenario import Origin, Scenario, Wind
from skyrange.scenario.shipped import load as load_scenario

MAX_AIRCRAFT = 100
_APART_M = 40.0
_SIDE_M = 25.0
_ALT_M = 10.0
_DEPART_S = 4.0


def make_scenario(aircraft: int = 3, *, duration_s: float = 75.0, seed: int = 1) -> Scenario:
    """A fleet of the operator `blue`, whose aircraft (1 to 100) fly squares of 25 m side by side, 10 m high.

    Each departs at 4 s, and would land after about a minute. `duration_s` is the longest an episode lasts in simulated
    seconds. Raises `InputError` for another number of aircraft.
    """
    if isinstance(aircraft, bool) or not isinstance(aircraft, int) or not 1 <= aircraft <= MAX_AIRCRAFT:
        raise InputError.one("environment", "aircraft", aircraft, f"a whole number from 1 to {MAX_AIRCRAFT}")
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


try:
    from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space
    from pettingzoo import ParallelEnv
except ImportError as error:
    _hint = "Install it with: pip install 'skyrange[env]'"
    raise InputError.one("skyrange.env", "import", error.name or "pettingzoo", "an installed package", _hint) from error

Observations = dict[str, NDArray[np.float32]]
_WHO = "environment"
_MAX_SEED = 2**63 - 1


class HoldTheMission(ParallelEnv):  # type: ignore[misc] # PettingZoo has no type information
    """Operators keep their missions going, and one adversary disturbs them.

    Agents: `red`, and `blue_ID` for each operator ID of the scenario. All act at the beginning of each step.

    - Action of `red`: 0 for nothing, else 1 + 3 · aircraft + act, with an aircraft of `vehicles` by number and a
      `RedAct`.
    - Action of a blue agent: a `BlueAct` for each of its aircraft.
    - Observation: float32 (aircraft, features), the aircraft in the order of `aircraft_of`, the features of `FEATURES`,
      read from the MAVLink frames of a step: at its ground station for a blue agent, at all companions for red.
    - Reward: see `Rewards`. Red gets what all blue agents lose by progress and mishaps and the reverse, less the costs
      of its acts. They follow from the truth, which no agent observes.
    - An episode terminates when every aircraft has landed or crashed, and is truncated at the scenario's duration.
    - Infos, equal for all agents: `time_s`, and by aircraft `progress` (0 to 1) and `mishaps`: from the truth, to
      evaluate with and not to act on.

    Equal seeds and actions give equal episodes, to the byte.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "hold_the_mission_v0", "render_modes": []}
    render_mode: str | None = None

    def __init__(
        self,
        scenario: Scenario | str | Path | None = None,
        *,
        aircraft: int | None = None,
        step_s: float = 1.0,
        rewards: Rewards | None = None,
        record_to: str | Path | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Prepare a task; `reset` builds the first episode.

        `scenario` is a `Scenario`, the name of a shipped one, or a TOML file; the default is `make_scenario(aircraft)`,
        with 3 aircraft. `step_s` is the simulated time of a step in seconds, 0.1 to 60. With `record_to`, episode N is
        recorded in the run folder `record_to/episode-N`, numbered from 0 with five digits; without it, episodes leave
        no files. Raises `InputError` for a value that does not fit, and for a scenario with signed MAVLink, guided
        plans or other autopilots than the builtin one.
        """
        if scenario is not None and aircraft is not None:
            raise InputError.one(_WHO, "aircraft", aircraft, "nothing, because the scenario has its aircraft")
        if render_mode is not None:
            raise InputError.one(_WHO, "render_mode", render_mode, "None")
        if isinstance(step_s, bool) or not isinstance(step_s, (int, float)) or not 0.1 <= step_s <= 60:
            raise InputError.one(_WHO, "step_s", step_s, "a number of seconds from 0.1 to 60")
        if rewards is not None and not isinstance(rewards, Rewards):
            raise InputError.one(_WHO, "rewards", rewards, "skyrange.env.Rewards")
        if scenario is None:
            scenario = make_scenario(3 if aircraft is None else aircraft)
        elif not isinstance(scenario, Scenario):
            scenario = load_scenario(scenario)
        check_scenario(scenario)
        self.scenario = scenario
        self._rewards = rewards or Rewards()
        self._step_ns = from_seconds(step_s)
        if from_seconds(scenario.duration_s) < self._step_ns:
            expected = f"at most the scenario's duration of {scenario.duration_s:g} s"
            raise InputError.one(_WHO, "step_s", step_s, expected)
        self._record_to = Path(record_to) if record_to is not None else None
        self.vehicles: Sequence[str] = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet]
        """All aircraft, in the order of red's actions."""
        operators = list(dict.fromkeys(map(operator_of, self.vehicles)))
        self.aircraft_of: Mapping[str, Sequence[str]] = {
            RED: self.vehicles,
            **{blue_agent(one): [name for name in self.vehicles if operator_of(name) == one] for one in operators},
        }
        """By agent, the aircraft in the order of the rows of its observations, and of a blue agent's actions."""
        self.possible_agents = list(self.aircraft_of)
        self.agents: list[str] = []
        self.action_spaces: dict[str, Space[Any]] = {
            agent: Discrete(1 + len(RedAct) * len(rows)) if agent == RED else MultiDiscrete([len(BlueAct)] * len(rows))
            for agent, rows in self.aircraft_of.items()
        }
        low = np.array([one.low for one in FEATURES], dtype=np.float32)
        high = np.array([one.high for one in FEATURES], dtype=np.float32)
        self.observation_spaces: dict[str, Space[Any]] = {
            agent: Box(np.tile(low, (len(rows), 1)), np.tile(high, (len(rows), 1)))
            for agent, rows in self.aircraft_of.items()
        }
        self._seed = scenario.seed
        self._since_seed = 0
        self._episodes = 0
        self._episode: Episode | None = None

    def observation_space(self, agent: str) -> Space[Any]:
        """The space of an agent's observations; `InputError` for an unknown agent."""
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> Space[Any]:
        """The space of an agent's actions; `InputError` for an unknown agent."""
        return self.action_spaces[self._known(agent)]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observations, dict[str, dict[str, Any]]]:
        """Begin an episode; returns observations and infos by agent.

        `seed` (0 to 2⁶³ - 1) is that of the run. Without it, the first episode has the scenario's seed, and each later
        one a seed that follows from the last given one and the number of episodes since. `options` are not read. An
        unfinished episode ends, and its record is marked interrupted.
        """
        if seed is not None:
            if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed <= _MAX_SEED:
                raise InputError.one(_WHO, "seed", seed, f"a whole number from 0 to {_MAX_SEED}")
            self._seed, self._since_seed = int(seed), 0
        self.close()
        chosen = self._seed
        if self._since_seed:
            first, *_ = Chance(self._seed).uniform4("env.episode", hash64(_WHO), self._since_seed, 0)
            chosen = int(first * 2**53)
        out = None if self._record_to is None else self._record_to / f"episode-{self._episodes:05d}"
        scenario = self.scenario.model_copy(update={"seed": chosen})
        self._episode = Episode(scenario, self._step_ns, self._rewards, out)
        self._since_seed += 1
        self._episodes += 1
        self.agents = list(self.possible_agents)
        return self._observe(self._episode), self._inform(self._episode)

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Fly one step; returns observations, rewards, terminations, truncations and infos by agent.

        `actions` has the action of every live agent. Raises `InputError` for one that is missing or not in its space,
        and where no episode is under way.
        """
        episode = self._episode
        if episode is None or not self.agents:
            raise InputError.one(_WHO, "step", "no episode is under way", "a call of reset before")
        for agent in actions:
            self._known(agent)
        chosen = {agent: self._read_action(agent, actions) for agent in self.agents}
        red = int(chosen.pop(RED))
        place, act = divmod(red - 1, len(RedAct))
        hostile = (self.vehicles[place], RedAct(act)) if red else ("", None)
        blue = {
            agent: dict(zip(self.aircraft_of[agent], map(BlueAct, action), strict=True))
            for agent, action in chosen.items()
        }
        begun = episode.now
        try:
            scores = episode.step(hostile, blue)
        except BaseException:
            self.agents = []
            raise
        outcomes = episode.parts.outcomes
        rewards = {RED: -sum(scores.values()) - self._rewards.hostile_act * bool(red)}
        for agent, acts in blue.items():
            reactions = [name for name, one in acts.items() if one is not BlueAct.NOTHING]
            cost = self._rewards.false_reaction * outcomes.count_false(begun, reactions)
            rewards[agent] = sum(scores[name] for name in acts) - cost
        over, late = outcomes.over, episode.out_of_time
        observations, infos = self._observe(episode), self._inform(episode)
        live = list(self.agents)
        if over or late:
            self.agents = []
            episode.close("complete")
        return (
            observations,
            rewards,
            dict.fromkeys(live, over),
            dict.fromkeys(live, late and not over),
            infos,
        )

    def close(self) -> None:
        """End the episode that is under way; its record is marked interrupted."""
        if self._episode is not None:
            self._episode.close("interrupted")
            self._episode = None
        self.agents = []

    def render(self) -> None:
        """Nothing is drawn: a recorded episode has a run's folder, which `skyrange report` and viewers read."""

    def state(self) -> NDArray[np.float32]:
        """The observations of all agents in one vector, in the order of `possible_agents`."""
        if self._episode is None:
            raise InputError.one(_WHO, "state", "no episode is under way", "a call of reset before")
        found = self._observe(self._episode)
        return np.concatenate([found[agent].ravel() for agent in self.possible_agents])

    def _known(self, agent: str) -> str:
        if agent not in self.aircraft_of:
            expected = f"an agent: {', '.join(self.possible_agents)}"
            raise InputError.one(_WHO, "agent", agent, expected, nearest(str(agent), self.possible_agents))
        return agent

    def _read_action(self, agent: str, actions: Mapping[str, Any]) -> Any:
        """The action of an agent, a number or a list of numbers."""
        space = self.action_spaces[agent]
        if agent not in actions:
            raise InputError.one(_WHO, f"actions.{agent}", "missing", f"an action of {space}")
        value = np.asarray(actions[agent])
        wanted = () if agent == RED else (len(self.aircraft_of[agent]),)
        whole = value.dtype.kind in "iu" and value.shape == wanted
        most = space.n if isinstance(space, Discrete) else len(BlueAct)
        if not whole or (value < 0).any() or (value >= most).any():
            raise InputError.one(_WHO, f"actions.{agent}", repr(actions[agent]), f"an action of {space}")
        return value.tolist()

    def _observe(self, episode: Episode) -> Observations:
        return {agent: episode.parts.monitors[agent].read() for agent in self.possible_agents}

    def _inform(self, episode: Episode) -> dict[str, dict[str, Any]]:
        outcomes = episode.parts.outcomes
        return {
            agent: {
                "time_s": to_seconds(episode.now),
                "progress": {name: one.share for name, one in outcomes.progress.items()},
                "mishaps": {name: list(kinds) for name, kinds in outcomes.mishaps.items()},
            }
            for agent in self.possible_agents
        }
