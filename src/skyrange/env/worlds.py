"""Many worlds of the task "hold the mission" side by side, each of them what `HoldTheMission` is alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from gymnasium.spaces import Space

from skyrange.assembly.batches import explain_alone
from skyrange.core.errors import InputError
from skyrange.env.episode import EpisodeGroup
from skyrange.env.outcomes import Rewards
from skyrange.env.task import MAX_SEED, WHO, Infos, Observations, Seeds, StepResult, Task
from skyrange.scenario.model.scenario import Scenario

MOST_TOGETHER: Final = 128
"""Worlds of one kernel: more are slower, because their state leaves the processor's cache."""


class HoldTheMissionWorlds:
    """A number of worlds, in each of which an episode of `HoldTheMission` is played.

    Actions, observations, rewards and infos of a world are those of `HoldTheMission` with the same seed and the same
    actions, to the byte. Worlds whose episodes began with the same call of `reset` fly in one kernel, which is several
    times as fast; each episode ends by itself, and a new one begins when `reset` is called for its world. The more
    worlds begin together, the faster. Episodes are not recorded: play one with `HoldTheMission` for that.
    """

    def __init__(
        self,
        count: int,
        scenario: Scenario | str | Path | None = None,
        *,
        aircraft: int | None = None,
        step_s: float = 1.0,
        rewards: Rewards | None = None,
    ) -> None:
        """Prepare `count` worlds; `reset` begins episodes. The other arguments are those of `HoldTheMission`.

        Raises `InputError` for a value that does not fit, and for a scenario that cannot fly together with others.
        """
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise InputError.one(WHO, "count", count, "a whole number of worlds, at least 1")
        self._task = task = Task(scenario, aircraft, step_s, rewards)
        self.scenario = task.scenario
        if reason := explain_alone(self.scenario):
            hint = "Play it with HoldTheMission, in several processes"
            raise InputError.one(WHO, "scenario", self.scenario.name, f"one that can fly together: {reason}", hint)
        self.count = count
        self.vehicles: Sequence[str] = task.vehicles
        """All aircraft, in the order of red's actions."""
        self.aircraft_of: Mapping[str, Sequence[str]] = task.aircraft_of
        """By agent, the aircraft in the order of the rows of its observations, and of a blue agent's actions."""
        self.agents = list(task.agents)
        """All agents of each world."""
        self.action_spaces: dict[str, Space[Any]] = task.action_spaces
        self.observation_spaces: dict[str, Space[Any]] = task.observation_spaces
        self._seeds = [Seeds((self.scenario.seed + world) % (MAX_SEED + 1)) for world in range(count)]
        self._places: dict[int, tuple[EpisodeGroup, int]] = {}
        """By world whose episode is under way: its group, and its number in that."""
        self._past_flight_s = 0.0

    @property
    def under_way(self) -> list[int]:
        """The worlds whose episodes are under way, in order."""
        return sorted(self._places)

    @property
    def groups(self) -> int:
        """How many kernels fly."""
        return len({id(group) for group, _ in self._places.values()})

    @property
    def flight_cpu_s(self) -> float:
        """Processor time for which kernels have flown, in seconds: the rest is that of building, acts and rewards."""
        groups = {id(group): group for group, _ in self._places.values()}
        return self._past_flight_s + sum(group.flight_cpu_s for group in groups.values())

    def reset(self, seeds: Mapping[int, int | None] | None = None) -> dict[int, tuple[Observations, Infos]]:
        """Begin an episode in some worlds; returns observations and infos of each.

        `seeds` has the seed of each of these worlds by number, `None` for one that follows from its last as in
        `HoldTheMission.reset`; the first of world `i` is the scenario's plus `i`. Without `seeds` it is all worlds.
        Episodes that are under way there end.
        """
        chosen = dict.fromkeys(range(self.count)) if seeds is None else dict(seeds)
        for world in chosen:
            if isinstance(world, bool) or not isinstance(world, int) or not 0 <= world < self.count:
                raise InputError.one(WHO, "world", world, f"a whole number from 0 to {self.count - 1}")
        if not chosen:
            return {}
        scenarios = [
            self.scenario.model_copy(update={"seed": self._seeds[world].next(seed)}) for world, seed in chosen.items()
        ]
        for world in chosen:
            self._end(world)
        begun = {}
        worlds = list(chosen)
        for first in range(0, len(worlds), MOST_TOGETHER):
            together = slice(first, first + MOST_TOGETHER)
            group = EpisodeGroup(scenarios[together], self._task.step_ns, self._task.rewards)
            for number, world in enumerate(worlds[together]):
                self._places[world] = group, number
                begun[world] = group.observe(number), self._task.inform(group.now, group.parts[number].outcomes)
        return begun

    def step(self, actions: Mapping[int, Mapping[str, Any]]) -> dict[int, StepResult]:
        """Fly one step of every world whose episode is under way; returns what `HoldTheMission.step` does, by world.

        `actions` has the actions of all agents of each of these worlds. Raises `InputError` for one that is missing or
        not in its space, and for a world whose episode is not under way; then nothing is flown.
        """
        live = self.under_way
        strange = [world for world in actions if world not in self._places]
        if strange or not live:
            expected = f"worlds whose episode is under way, {live}: call reset before"
            raise InputError.one(WHO, "actions", strange, expected)
        missing = [world for world in live if world not in actions]
        if missing:
            raise InputError.one(WHO, "actions", f"nothing for the worlds {missing}", "the actions of all agents there")
        choices = {world: self._task.read_actions(actions[world], f"actions.{world}") for world in live}
        groups: dict[int, tuple[EpisodeGroup, dict[int, int]]] = {}
        for world in live:
            group, number = self._places[world]
            groups.setdefault(id(group), (group, {}))[1][number] = world
        results = {}
        for group, worlds in groups.values():
            begun = group.now
            try:
                scores = group.step({number: choices[world] for number, world in worlds.items()})
            except BaseException:
                for world in worlds.values():
                    self._end(world)
                raise
            for number, world in worlds.items():
                outcomes, seen = group.parts[number].outcomes, group.observe(number)
                result = self._task.end_step(choices[world], begun, group.now, scores[number], outcomes, seen)
                results[world] = result
                if result.is_last:
                    self._end(world)
        return dict(sorted(results.items()))

    def close(self) -> None:
        """End all episodes."""
        for world in self.under_way:
            self._end(world)

    def _end(self, world: int) -> None:
        group, _ = self._places.pop(world, (None, 0))
        if group is not None and not any(other is group for other, _ in self._places.values()):
            group.close()
            self._past_flight_s += group.flight_cpu_s
