"""Baseline policies of both teams, random and scripted, and a function that plays an episode with policies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.core.errors import InputError
from skyrange.env.acts import RED, BlueAct, RedAct
from skyrange.env.observations import describe

if TYPE_CHECKING:
    from skyrange.env.hold_the_mission import HoldTheMission

Policy = Callable[[NDArray[np.float32]], Any]
"""Chooses an agent's action by its observation (aircraft, features)."""
_HELD: Final = frozenset(float(COPTER_MODE_NUMBERS[name]) for name in ("AUTO", "GUIDED", "RTL"))
"""Modes in which the scripted operator leaves an aircraft alone."""
_SILENT_S: Final = 2.0


@dataclass(slots=True)
class RandomPolicy:
    """Chooses any action of a space with equal chance, by a generator of its own."""

    space: Any
    """A Gymnasium space: `environment.action_space(agent)`, of which it takes a copy."""
    seed: int

    def __post_init__(self) -> None:
        self.space = deepcopy(self.space)
        self.space.seed(self.seed)

    def __call__(self, observation: NDArray[np.float32]) -> Any:
        """The action."""
        return self.space.sample()


@dataclass(slots=True)
class Quiet:
    """Does nothing: the floor of both teams."""

    agent: str

    def __call__(self, observation: NDArray[np.float32]) -> Any:
        """The action."""
        return 0 if self.agent == RED else np.zeros(len(observation), dtype=np.int64)


@dataclass(slots=True)
class ScriptedRed:
    """Commands the mode of one flying aircraft after another, then cuts the link of its victim, so that nobody helps.

    It looks for an aircraft that is armed, higher than 5 m and in AUTO, commands its mode for one step, and drops its
    frames for `cut_steps` steps.
    """

    cut_steps: int = 6
    pause_steps: int = 10
    """Steps without an act after each victim."""
    _victim: int = field(default=-1, init=False)
    _step: int = field(default=0, init=False)
    _times: dict[int, int] = field(default_factory=dict, init=False)
    """By row, how often it was the victim: the next one is one of those that were it least often."""

    def __post_init__(self) -> None:
        for name in ("cut_steps", "pause_steps"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 0:
                raise InputError.one("ScriptedRed", name, value, "a whole number, at least 0")

    def __call__(self, observation: NDArray[np.float32]) -> int:
        """The action."""
        if self._victim < 0:
            candidates = [
                row
                for row, aircraft in enumerate(describe(observation))
                if aircraft["armed"] and aircraft["up_m"] > 5.0 and aircraft["mode"] == COPTER_MODE_NUMBERS["AUTO"]
            ]
            if not candidates:
                return 0
            self._victim, self._step = min(candidates, key=lambda row: (self._times.get(row, 0), row)), 0
            self._times[self._victim] = self._times.get(self._victim, 0) + 1
        self._step += 1
        act = RedAct.MODE if self._step == 1 else RedAct.LINK
        action = 1 + len(RedAct) * self._victim + act if self._step <= 1 + self.cut_steps else 0
        if self._step >= 1 + self.cut_steps + self.pause_steps:
            self._victim = -1
        return action


@dataclass(slots=True)
class ScriptedBlue:
    """Commands AUTO where an aircraft in the air has left it for a mode that the operator did not command.

    Where the aircraft has answered a command of a strange system, it blocks those first. It does nothing about an
    aircraft whose telemetry is silent: no command would arrive.
    """

    _blocked: dict[int, int] = field(default_factory=dict, init=False)
    """By row, steps that a block still lasts."""
    _waits: dict[int, int] = field(default_factory=dict, init=False)
    """By row, steps until it commands again."""

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.int64]:
        """The action."""
        acts = np.zeros(len(observation), dtype=np.int64)
        for row, aircraft in enumerate(describe(observation)):
            self._blocked[row] = max(self._blocked.get(row, 0) - 1, 0)
            self._waits[row] = max(self._waits.get(row, 0) - 1, 0)
            if aircraft["heartbeat_age_s"] > _SILENT_S:
                continue
            strayed = (
                aircraft["armed"] and aircraft["up_m"] > 1.0 and aircraft["mode"] not in _HELD and aircraft["mode"] >= 0
            )
            if aircraft["foreign_acks"] and not self._blocked[row]:
                acts[row], self._blocked[row] = BlueAct.BLOCK, 9
            elif strayed and not self._waits[row]:
                acts[row], self._waits[row] = BlueAct.RESUME, 2
        return acts


def play(environment: HoldTheMission, policies: Mapping[str, Policy], *, seed: int | None = None) -> dict[str, float]:
    """Play one episode, with a policy for each agent; returns the sum of rewards by agent.

    Raises `InputError` for an agent without a policy.
    """
    for agent in environment.possible_agents:
        if agent not in policies:
            raise InputError.one("play", f"policies.{agent}", "missing", "a policy for each agent")
    observations, _ = environment.reset(seed=seed)
    returns = dict.fromkeys(environment.possible_agents, 0.0)
    while environment.agents:
        actions = {agent: policies[agent](observations[agent]) for agent in environment.agents}
        observations, rewards, *_ = environment.step(actions)
        for agent, reward in rewards.items():
            returns[agent] += reward
    return returns
