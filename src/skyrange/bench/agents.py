"""Speed of the learning environment: worlds of `HoldTheMission` with random policies, alone and side by side."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any, Final

from skyrange.env import HoldTheMission, HoldTheMissionWorlds, RandomPolicy, play

SIZES: Final = (1, 16, 64, 256)
"""Worlds; 1 is `HoldTheMission`."""


def measure(sizes: Sequence[int], aircraft: int) -> Iterator[dict[str, Any]]:
    """Play one episode in as many worlds as each of `sizes`; a row for each, in processor time.

    `steps_per_s` counts the steps of all worlds. The shares are those of the kernels' flight, of building the worlds,
    of policies, and of the rest: reading actions, observations, rewards and infos.
    """
    environment = HoldTheMission(aircraft=aircraft)
    play(environment, _policies(environment, 0), seed=1)  # compiles
    for size in sizes:
        yield _measure_worlds(size, aircraft) if size > 1 else _measure_alone(environment)


def _policies(environment: HoldTheMission | HoldTheMissionWorlds, world: int) -> dict[str, RandomPolicy]:
    spaces = environment.action_spaces
    return {agent: RandomPolicy(spaces[agent], 10 * world + place) for place, agent in enumerate(spaces)}


def _measure_alone(environment: HoldTheMission) -> dict[str, Any]:
    episodes, policies, steps = 4, _policies(environment, 0), 0
    began = time.process_time()
    for episode in range(episodes):
        observations, _ = environment.reset(seed=1 + episode)
        while environment.agents:
            actions = {agent: policies[agent](observations[agent]) for agent in environment.agents}
            observations = environment.step(actions).observations
            steps += 1
    return {"worlds": 1, "steps_per_s": round(steps / (time.process_time() - began), 1)}


def _measure_worlds(size: int, aircraft: int) -> dict[str, Any]:
    worlds = HoldTheMissionWorlds(size, aircraft=aircraft)
    policies = [_policies(worlds, world) for world in range(size)]
    steps, acts_s = 0, 0.0
    began = time.process_time()
    seen = {world: observations for world, (observations, _) in worlds.reset({n: 1 + n for n in range(size)}).items()}
    built_s = time.process_time() - began
    flown_s = worlds.flight_cpu_s
    while worlds.under_way:
        asked = time.process_time()
        actions = {
            world: {agent: policies[world][agent](seen[world][agent]) for agent in worlds.agents}
            for world in worlds.under_way
        }
        acts_s += time.process_time() - asked
        results = worlds.step(actions)
        steps += len(results)
        seen = {world: result.observations for world, result in results.items()}
    whole_s = time.process_time() - began
    flight_s = worlds.flight_cpu_s - flown_s
    shares = {
        "flight": flight_s, "building": built_s, "policies": acts_s, "rest": whole_s - flight_s - built_s - acts_s,
    }  # fmt: skip
    return {
        "worlds": size,
        "steps_per_s": round(steps / whole_s, 1),
        "shares": {name: round(seconds / whole_s, 3) for name, seconds in shares.items()},
    }
