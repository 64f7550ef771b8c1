"""Do episodes of the learning environment fly on real frames, repeat to the byte, and record what agents do?"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test
from pettingzoo.utils import parallel_to_aec

import skyrange
from skyrange.codec.mavlink import decode
from skyrange.core.errors import InputError
from skyrange.env import (
    HoldTheMission,
    Quiet,
    RandomPolicy,
    ScriptedBlue,
    ScriptedRed,
    describe_observation,
    make_scenario,
    play,
)
from skyrange.scenario import Operator, Origin, Scenario

pytestmark = pytest.mark.rotating

AUTO, RTL, LAND = 3.0, 6.0, 9.0
BLUE = "blue_blue"


def short(**arguments: Any) -> HoldTheMission:
    """Two aircraft, 24 seconds: take-off and the first leg."""
    return HoldTheMission(make_scenario(2, duration_s=24), **arguments)


def two_operators() -> Scenario:
    (blue,) = make_scenario(2).operators
    first, second = blue.vehicles
    return Scenario(
        name="two",
        duration_s=12,
        origin=Origin(lat=47.3977, lon=8.5456),
        operators=(Operator(id="blue", vehicles=(first,)), Operator(id="green", vehicles=(second,))),
    )


def fly(
    environment: HoldTheMission, script: Mapping[int, Mapping[str, Any]], *, seed: int | None = 4
) -> list[dict[str, Any]]:
    """Fly an episode with actions at some steps (from 1 on), none else; what each step returned, by name."""
    environment.reset(seed=seed)
    nothing = {
        agent: 0 if agent == "red" else np.zeros(len(environment.aircraft_of[agent]), dtype=np.int64)
        for agent in environment.possible_agents
    }
    steps: list[dict[str, Any]] = []
    while environment.agents:
        actions = {**nothing, **script.get(len(steps) + 1, {})}
        names = ("observations", "rewards", "terminations", "truncations", "infos")
        steps.append(dict(zip(names, environment.step(actions), strict=True)))
    return steps


def seen(step: Mapping[str, Any], row: int = 0, agent: str = BLUE) -> Mapping[str, float]:
    return describe_observation(step["observations"][agent])[row]


def as_bytes(steps: list[dict[str, Any]]) -> list[Any]:
    return [
        ({agent: one.tobytes() for agent, one in step["observations"].items()}, step["rewards"], step["infos"])
        for step in steps
    ]


def at_random(environment: HoldTheMission, steps: int, seed: int) -> dict[int, dict[str, Any]]:
    policies = {agent: RandomPolicy(environment.action_space(agent), seed) for agent in environment.possible_agents}
    none = np.zeros((0, 0), dtype=np.float32)
    return {step: {agent: policy(none) for agent, policy in policies.items()} for step in range(1, steps + 1)}


@pytest.mark.parametrize("make", [short, lambda: HoldTheMission(two_operators())], ids=["one", "two operators"])
def test_pettingzoo_finds_nothing_wrong(make: Callable[[], HoldTheMission]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(make(), num_cycles=40)
        parallel_seed_test(make, num_cycles=10)


def test_agents_can_also_act_in_turn() -> None:
    """The step is flown when the last agent of a round has acted."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        in_turn = parallel_to_aec(short())
        in_turn.reset(seed=4)
        for _ in range(6):
            in_turn.step(0 if in_turn.agent_selection == "red" else np.zeros(2, dtype=np.int64))
    observation = in_turn.observe(BLUE)
    assert observation.tobytes() == fly(short(), {})[2]["observations"][BLUE].tobytes()


def test_equal_seeds_and_actions_give_equal_episodes_to_the_byte(tmp_path: Path) -> None:
    def brief(**arguments: Any) -> HoldTheMission:
        return HoldTheMission(make_scenario(2, duration_s=14), **arguments)

    script = at_random(brief(), 14, seed=11)
    found = []
    for number, record_to in enumerate((tmp_path / "a", tmp_path / "b", None)):
        environment = brief(record_to=record_to)
        if number == 1:
            fly(environment, {}, seed=99)  # an episode before it changes nothing
        found.append(fly(environment, script))
    records = [skyrange.load(tmp_path / name) for name in ("a/episode-00000", "b/episode-00001")]
    assert records[0].manifest["digests"] == records[1].manifest["digests"]
    assert [record.status for record in records] == ["complete", "complete"]
    assert as_bytes(found[0]) == as_bytes(found[1]) == as_bytes(found[2])
    other = fly(brief(), script, seed=5)
    assert as_bytes(other) != as_bytes(found[0])


@pytest.mark.slow
def test_later_episodes_have_seeds_that_follow_from_the_given_one() -> None:
    first, second = short(), short()
    for environment in (first, second):
        environment.reset(seed=8)
    again = [as_bytes(fly(environment, {}, seed=None)) for environment in (first, second)]
    assert again[0] == again[1]
    assert as_bytes(fly(first, {}, seed=8)) != again[0]


def test_a_commanded_mode_is_a_labelled_frame_that_its_victim_obeys(tmp_path: Path) -> None:
    steps = fly(short(record_to=tmp_path), {14: {"red": 1}})
    assert seen(steps[12])["mode"] == AUTO
    assert seen(steps[13])["mode"] == LAND
    assert seen(steps[13])["foreign_acks"] == 1
    assert seen(steps[-1], row=1)["mode"] == AUTO
    record = skyrange.load(tmp_path / "episode-00000")
    (label,) = record.table("labels").to_pylist()
    assert (label["attack"], label["action"], label["at_ns"]) == ("red", "inject", 13_001_000_000)
    rows = record.table("frames").to_pylist()
    frame = next(
        one for one in rows if f"{one['link']}|{one['direction']}|{one['sender']}|{one['serial']}" == label["frame"]
    )
    assert (frame["link"], frame["direction"], frame["fate"]) == ("gcs:blue/b1", "fwd", "delivered")
    payloads = {one["payload_id"]: one["payload"] for one in record.table("payloads").to_pylist()}
    message = decode(payloads[frame["payload_id"]])
    assert (message.get_type(), message.get_srcSystem(), message.param2) == ("COMMAND_LONG", 254, LAND)
    events = [(one["kind"], one["about"]) for one in record.table("events").to_pylist()]
    assert ("event.red_action", "blue/b1") in events


def test_operators_command_by_frames_too_and_their_acts_are_events(tmp_path: Path) -> None:
    acts: dict[int, dict[str, Any]] = {14: {"red": 1}, 15: {BLUE: [1, 0]}, 18: {BLUE: [2, 0]}}
    steps = fly(short(record_to=tmp_path), acts)
    assert [seen(steps[step - 1])["mode"] for step in (14, 16, 19)] == [LAND, AUTO, RTL]
    record = skyrange.load(tmp_path / "episode-00000")
    events = record.table("events").to_pylist()
    commands = [one for one in events if one["kind"] == "event.defence_act"]
    assert [one["about"] for one in commands] == [BLUE, BLUE]
    assert ["inject" in str(one["data"]) for one in commands] == [True, True]
    chosen = [one["about"] for one in events if one["kind"] == "event.blue_action"]
    assert chosen == ["blue/b1", "blue/b1"]


def test_a_block_keeps_commands_of_strange_systems_from_the_aircraft_for_ten_seconds() -> None:
    steps = fly(short(), {10: {BLUE: [3, 0]}, 14: {"red": 1}, 21: {"red": 1}})
    assert seen(steps[13])["mode"] == AUTO
    assert seen(steps[13])["foreign_acks"] == 0
    assert seen(steps[20])["mode"] == LAND


def test_a_dropped_link_is_silent_at_the_station_and_the_adversary_still_sees_the_aircraft() -> None:
    steps = fly(short(), {step: {"red": 6} for step in (14, 15, 16)})
    assert [seen(steps[step - 1], row=1)["frames"] > 0 for step in (13, 15, 16, 18)] == [True, False, False, True]
    assert seen(steps[15], row=1)["heartbeat_age_s"] > 2.5
    assert seen(steps[15], row=1, agent="red")["frames"] > 0
    assert seen(steps[15])["frames"] > 0


def test_a_drift_moves_the_aircraft_and_not_what_it_reports(tmp_path: Path) -> None:
    environment = short(record_to=tmp_path)
    hostile = fly(environment, {step: {"red": 2} for step in range(13, 25)})
    record = skyrange.load(tmp_path / "episode-00000")
    last = [one for one in record.table("truth").to_pylist() if one["vehicle"] == "blue/b1"][-1]
    reported = seen(hostile[-1])
    assert reported["east_m"] - last["east_m"] > 8.0
    assert abs(reported["east_m"] - seen(fly(short(), {})[-1])["east_m"]) < 4.0
    labels = record.table("labels").to_pylist()
    assert [(one["attack"], one["action"]) for one in labels] == [("red", "sensor")]


def test_a_false_reaction_costs_and_one_after_a_hostile_act_does_not() -> None:
    quiet = fly(short(), {})
    false = fly(short(), {12: {BLUE: [3, 3]}})
    assert false[11]["rewards"][BLUE] == pytest.approx(quiet[11]["rewards"][BLUE] - 0.2)
    assert false[11]["rewards"]["red"] == pytest.approx(quiet[11]["rewards"]["red"])
    justified = fly(short(), {11: {"red": 3}, 12: {BLUE: [3, 0]}})
    assert justified[10]["rewards"]["red"] == pytest.approx(quiet[10]["rewards"]["red"] - 0.01)
    assert justified[11]["rewards"][BLUE] == pytest.approx(quiet[11]["rewards"][BLUE])


def test_an_episode_ends_when_all_have_landed_and_each_mission_is_worth_one() -> None:
    environment = HoldTheMission(aircraft=1)
    steps = fly(environment, {})
    assert steps[-1]["terminations"] == {"red": True, BLUE: True}
    assert steps[-1]["truncations"] == {"red": False, BLUE: False}
    assert sum(step["rewards"][BLUE] for step in steps) == pytest.approx(1.0)
    assert sum(step["rewards"]["red"] for step in steps) == pytest.approx(-1.0)
    assert steps[-1]["infos"][BLUE]["progress"] == {"blue/b1": 1.0}
    assert fly(short(), {})[-1]["truncations"] == {"red": True, BLUE: True}


@pytest.mark.slow
def test_scripted_policies_are_better_than_doing_nothing() -> None:
    environment = HoldTheMission(aircraft=1)
    returns = {
        (bool(red), bool(blue)): play(
            environment,
            {"red": ScriptedRed() if red else Quiet("red"), BLUE: ScriptedBlue() if blue else Quiet(BLUE)},
            seed=3,
        )
        for red in (False, True)
        for blue in (False, True)
    }
    assert returns[True, False]["red"] > returns[False, False]["red"] + 0.5
    assert returns[True, True][BLUE] > returns[True, False][BLUE] + 0.5
    assert returns[False, True] == returns[False, False]


def test_an_episode_that_is_left_is_recorded_as_interrupted(tmp_path: Path) -> None:
    environment = short(record_to=tmp_path)
    environment.reset(seed=1)
    environment.step({"red": 0, BLUE: [0, 0]})
    environment.reset()
    environment.close()
    environment.close()
    records = [skyrange.load(tmp_path / f"episode-0000{number}") for number in (0, 1)]
    assert [record.status for record in records] == ["interrupted", "interrupted"]
    assert records[0].manifest["environment"] == {
        "task": "hold-the-mission", "agents": ["red", BLUE], "step_ns": 1_000_000_000,
    }  # fmt: skip


def test_a_folder_that_exists_is_not_written_to(tmp_path: Path) -> None:
    short(record_to=tmp_path).reset(seed=1)
    with pytest.raises(InputError, match="episode-00000"):
        short(record_to=tmp_path).reset(seed=1)


def test_a_fork_in_mid_episode_continues_identically() -> None:
    from skyrange.record.write.memory_observer import MemoryObserver

    environment = short()
    environment.reset(seed=2)
    for _ in range(13):
        environment.step({"red": 1, BLUE: [1, 0]})
    assert environment._episode is not None
    kernel = environment._episode._kernel
    first, second = MemoryObserver(), MemoryObserver()
    twin = kernel.fork([first])
    again = kernel.fork([second])
    for one in (twin, again):
        one.advance(18_000_000_000)
        one.finish()
    assert [repr(one) for one in first.frames] == [repr(one) for one in second.frames]
    assert len(first.labels) == len(second.labels) == 5
