"""Are the aircraft of several runs listed, and made, as those of each run alone?"""

from __future__ import annotations

from dataclasses import replace

import pytest

from skyrange.assembly.aircraft import Aircraft, list_aircraft, make_aircraft
from skyrange.scenario.shipped import load


def test_the_aircraft_of_several_runs_are_rows_of_one_world() -> None:
    seeds = (5, 6, 7)
    scenarios = [load("crossing", [f"seed={seed}"]) for seed in seeds]
    lists = [list_aircraft(scenario, run) for run, scenario in enumerate(scenarios)]
    alone = list_aircraft(scenarios[2])
    assert lists[2].bodies == [replace(body, run=2) for body in alone.bodies]
    assert lists[2].specs == [replace(spec, run=2) for spec in alone.specs]
    assert {body.seed for body in alone.bodies} == {spec.seed for spec in alone.specs} == {7}
    world, mounts = make_aircraft(scenarios[0], None, lists, motion=False)
    (mount,) = mounts
    count = len(alone.bodies)
    assert (world.runs, world.rows_of(2), mount.rows) == (3, slice(2 * count, 3 * count), slice(0, 3 * count))
    assert world.of_run(1).vehicles == tuple(body.vehicle for body in alone.bodies)
    assert list(mount.engine.vehicles[count : 2 * count]) == [f"1|{spec.vehicle}" for spec in alone.specs]
    assert [port.run for port in mount.engine.ports] == [run for run in range(3) for _ in range(count)]


def test_only_the_builtin_autopilot_flies_several_runs() -> None:
    scenario = load("crossing")
    lists = [list_aircraft(scenario, run) for run in range(2)]
    others = [Aircraft(one.bodies, one.specs, ["ardupilot"] * len(one.specs)) for one in lists]
    with pytest.raises(ValueError, match="ardupilot"):
        make_aircraft(scenario, None, others, motion=False)


def test_some_vehicles_are_listed_alone() -> None:
    scenario = load("crossing")
    first, *_ = list_aircraft(scenario).bodies
    assert [body.vehicle for body in list_aircraft(scenario, flown={first.vehicle}).bodies] == [first.vehicle]
