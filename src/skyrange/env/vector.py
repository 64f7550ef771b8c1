"""One team of the task "hold the mission" as a Gymnasium `VectorEnv`; policies play the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.env.outcomes import Rewards
from skyrange.env.policies import Policy, Quiet
from skyrange.env.task import WHO, Infos
from skyrange.env.worlds import HoldTheMissionWorlds
from skyrange.scenario.model.scenario import Scenario

MakePolicy = Callable[[str, int], Policy]
"""Returns a new policy of an agent for an episode in the world of that number."""


def make_quiet(agent: str, world: int) -> Policy:
    """A policy that does nothing."""
    return Quiet(agent)


class HoldTheMissionVector(VectorEnv):  # type: ignore[misc] # its base is Any where it is not installed
    """Worlds of `HoldTheMission` as one agent sees them.

    - Observation: float32 (worlds, aircraft, features). Action: one of the agent's actions for each world.
    - `make_policy` makes the policies of all other agents, new ones for each episode.
    - An episode that has ended begins anew with the next step, whose action of that world is ignored and whose reward
      is 0 (Gymnasium's `AutoresetMode.NEXT_STEP`).
    - World `i` is `HoldTheMission` with the seed `seed + i`, and then with those that follow from it.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "hold_the_mission_v0",
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        agent: str = "blue_blue",
        scenario: Scenario | str | Path | None = None,
        *,
        make_policy: MakePolicy = make_quiet,
        aircraft: int | None = None,
        step_s: float = 1.0,
        rewards: Rewards | None = None,
    ) -> None:
        """Prepare `num_envs` worlds; the arguments after `make_policy` are those of `HoldTheMission`.

        Raises `InputError` for a value that does not fit, an unknown agent, and a scenario that cannot fly together
        with others.
        """
        self._worlds = worlds = HoldTheMissionWorlds(
            num_envs, scenario, aircraft=aircraft, step_s=step_s, rewards=rewards
        )
        if agent not in worlds.agents:
            raise InputError.one(WHO, "agent", agent, f"an agent: {', '.join(worlds.agents)}")
        self.agent = agent
        self._others = [other for other in worlds.agents if other != agent]
        self._make_policy = make_policy
        self.num_envs = num_envs
        self.single_action_space = worlds.action_spaces[agent]
        self.single_observation_space = worlds.observation_spaces[agent]
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._policies: dict[int, dict[str, Policy]] = {}
        self._seen: dict[int, Mapping[str, NDArray[np.float32]]] = {}
        """By world, what all agents observed last."""

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode in all worlds; returns observations and infos.

        `seed` is that of world 0, one more for each further world, or a sequence of the seeds of all worlds. Without
        it, seeds follow as in `HoldTheMission.reset`. `options` are not read.
        """
        seeds: Sequence[int | None]
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, (int, np.integer)):
            seeds = [int(seed) + world for world in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InputError.one(WHO, "seed", f"{len(seeds)} seeds", f"a seed, or {self.num_envs} of them")
        infos: dict[str, Any] = {}
        self._begin(dict(enumerate(seeds)), infos)
        return self._stack(), infos

    def step(
        self, actions: Any
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Fly one step in every world, or begin an episode where the last one has ended.

        Returns observations, rewards (float64), terminations and truncations, one of each world, and infos.
        """
        if not self._policies:
            raise InputError.one(WHO, "step", "no episode is under way", "a call of reset before")
        chosen = np.asarray(actions)
        if len(chosen) != self.num_envs:
            raise InputError.one(WHO, "actions", f"{len(chosen)} actions", f"one for each of {self.num_envs} worlds")
        live = self._worlds.under_way
        ended = [world for world in range(self.num_envs) if world not in live]
        results = self._worlds.step({world: self._act(world, chosen[world]) for world in live}) if live else {}
        rewards = np.zeros(self.num_envs)
        flags = np.zeros((2, self.num_envs), dtype=np.bool_)
        infos: dict[str, Any] = {}
        for world, result in results.items():
            self._seen[world] = result.observations
            rewards[world] = result.rewards[self.agent]
            flags[:, world] = result.terminations[self.agent], result.truncations[self.agent]
            self._inform(infos, result.infos, world)
        self._begin(dict.fromkeys(ended), infos)
        return self._stack(), rewards, flags[0], flags[1], infos

    def close_extras(self, **kwargs: Any) -> None:
        """End all episodes."""
        self._worlds.close()

    def _begin(self, seeds: Mapping[int, int | None], infos: dict[str, Any]) -> None:
        for world, (observations, own) in self._worlds.reset(seeds).items():
            self._seen[world] = observations
            self._policies[world] = {other: self._make_policy(other, world) for other in self._others}
            self._inform(infos, own, world)

    def _act(self, world: int, action: Any) -> dict[str, Any]:
        seen, policies = self._seen[world], self._policies[world]
        return {**{other: policies[other](seen[other]) for other in self._others}, self.agent: action}

    def _inform(self, infos: dict[str, Any], own: Infos, world: int) -> None:
        infos.update(self._add_info(infos, own[self.agent], world))

    def _stack(self) -> NDArray[np.float32]:
        return np.stack([self._seen[world][self.agent] for world in range(self.num_envs)])
