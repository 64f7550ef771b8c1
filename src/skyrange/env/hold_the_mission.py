"""The task "hold the mission" as a PettingZoo `ParallelEnv`: operators keep missions going against an adversary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.extras import missing_module
from skyrange.env.episode import Episode
from skyrange.env.outcomes import Rewards
from skyrange.env.task import WHO, Infos, Observations, Seeds, StepResult, Task, check_seed
from skyrange.scenario.model.scenario import Scenario

try:
    from gymnasium.spaces import Space
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise missing_module(error.name or "pettingzoo", "env", "skyrange.env") from error


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
        if render_mode is not None:
            raise InputError.one(WHO, "render_mode", render_mode, "None")
        self._task = task = Task(scenario, aircraft, step_s, rewards)
        self._record_to = Path(record_to) if record_to is not None else None
        self.scenario = task.scenario
        self.vehicles: Sequence[str] = task.vehicles
        """All aircraft, in the order of red's actions."""
        self.aircraft_of: Mapping[str, Sequence[str]] = task.aircraft_of
        """By agent, the aircraft in the order of the rows of its observations, and of a blue agent's actions."""
        self.possible_agents = list(task.agents)
        self.agents: list[str] = []
        self.action_spaces: dict[str, Space[Any]] = task.action_spaces
        self.observation_spaces: dict[str, Space[Any]] = task.observation_spaces
        self._seeds = Seeds(self.scenario.seed)
        self._episodes = 0
        self._episode: Episode | None = None

    def observation_space(self, agent: str) -> Space[Any]:
        """The space of an agent's observations; `InputError` for an unknown agent."""
        return self.observation_spaces[self._task.find_agent(agent)]

    def action_space(self, agent: str) -> Space[Any]:
        """The space of an agent's actions; `InputError` for an unknown agent."""
        return self.action_spaces[self._task.find_agent(agent)]

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Begin an episode; returns observations and infos by agent.

        `seed` (0 to 2⁶³ - 1) is that of the run. Without it, the first episode has the scenario's seed, and each later
        one a seed that follows from the last given one and the number of episodes since. `options` are not read. An
        unfinished episode ends, and its record is marked interrupted.
        """
        if seed is not None:
            check_seed(seed)
        self.close()
        out = None if self._record_to is None else self._record_to / f"episode-{self._episodes:05d}"
        scenario = self.scenario.model_copy(update={"seed": self._seeds.next(seed)})
        self._episode = Episode(scenario, self._task.step_ns, self._task.rewards, out)
        self._episodes += 1
        self.agents = list(self.possible_agents)
        return self._episode.observe(), self._task.inform(self._episode.now, self._episode.parts.outcomes)

    def step(self, actions: Mapping[str, Any]) -> StepResult:
        """Fly one step; returns observations, rewards, terminations, truncations and infos by agent.

        `actions` has the action of every live agent. Raises `InputError` for one that is missing or not in its space,
        and where no episode is under way.
        """
        episode = self._episode
        if episode is None or not self.agents:
            raise InputError.one(WHO, "step", "no episode is under way", "a call of reset before")
        choices = self._task.read_actions(actions)
        begun = episode.now
        try:
            scores = episode.step(choices)
        except BaseException:
            self.agents = []
            raise
        result = self._task.end_step(choices, begun, episode.now, scores, episode.parts.outcomes, episode.observe())
        if result.is_last:
            self.agents = []
            episode.close("complete")
        return result

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
            raise InputError.one(WHO, "state", "no episode is under way", "a call of reset before")
        observations = self._episode.observe()
        return np.concatenate([observations[agent].ravel() for agent in self.possible_agents])
