"""Batches of runs: which scenarios may fly together as runs of one kernel, and their wirings over one shared world."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Final

from skyrange.assembly.aircraft import describe_engines, list_aircraft, make_aircraft
from skyrange.assembly.build import NOTHING_MORE, Additions, BuiltScenario, build
from skyrange.assembly.optics import list_sensors, scan_bytes_per_s
from skyrange.core import elementary_python
from skyrange.kernel import EngineMount
from skyrange.radio.contract import BUILTIN
from skyrange.scenario.model.scenario import Scenario
from skyrange.world import World

_SHARED: Final = ("duration_s", "start_utc", "origin", "city", "wind", "sensors", "autopilots", "record")
"""What runs of one batch have in common: the world that they share is made of it."""

MOST_RUNS: Final = 256
MOST_AIRCRAFT: Final = 512
MOST_AIRCRAFT_S: Final = 60_000.0
"""Simulated seconds of all aircraft of a batch: what they record is in memory."""
MOST_SCAN_BYTES: Final = 200e6
"""Bytes of all scans of a batch, for the same reason."""


@dataclass(frozen=True, slots=True)
class BuiltBatch:
    """Several runs ready to fly in one kernel."""

    runs: Sequence[BuiltScenario]
    """By number. The world of each wiring is its own part of `world`."""
    world: World
    engines: Sequence[EngineMount]

    def close(self) -> None:
        """As `BuiltScenario.close`, of every run."""
        for run in self.runs:
            run.close()


def explain_alone(scenario: Scenario) -> str:
    """Why a scenario cannot fly in a batch; "" if it can."""
    others = sorted({vehicle.autopilot for _, vehicle in scenario.fleet} - {"builtin"})
    if others:
        return f"its autopilots are {', '.join(others)}, and a batch has builtin ones"
    if scenario.radio is not None and scenario.radio.plugin is not BUILTIN:
        return f"its radio medium is {scenario.radio.engine}, and a batch has builtin ones"
    return ""


def is_shared(key: str) -> bool:
    """Whether a path of the scenario, as `--set` has it, or "scenario" or "buildings", changes what runs share."""
    return key.split(".", 1)[0] in (*_SHARED, "scenario", "buildings")


def count_together(scenario: Scenario) -> int:
    """How many runs of a scenario fly together at best; 1 where it flies alone.

    More cost memory, and gain less and less: what a run has for itself is then most of its time.
    """
    if explain_alone(scenario):
        return 1
    aircraft = sum(1 for _ in scenario.fleet)
    seconds = aircraft * float(scenario.duration_s)
    most = min(MOST_RUNS, MOST_AIRCRAFT // aircraft, MOST_AIRCRAFT_S // seconds)
    scans = elementary_python.add_up(map(scan_bytes_per_s, list_sensors(scenario))) * float(scenario.duration_s)
    return int(max(min(most, MOST_SCAN_BYTES // scans if scans else most), 1))


def batch_key(scenario: Scenario) -> Hashable:
    """What the scenarios of one batch have in common. Real aircraft on claimed tracks are moved in every tick: runs
    without them would wait for it.
    """
    return scenario.model_dump_json(include=set(_SHARED)), any(attack.honest for attack in scenario.attacks)


def build_batch(scenarios: Sequence[Scenario], additions: Sequence[Additions] | None = None) -> BuiltBatch:
    """Build scenarios with the same `batch_key` as runs of one batch. Raises the errors of `build`.

    `additions` of each are placed beside what it declares. Raises `ValueError` for scenarios that cannot fly
    together.
    """
    if len({batch_key(scenario) for scenario in scenarios}) != 1 or any(map(explain_alone, scenarios)):
        raise ValueError("scenarios that cannot fly in one batch")
    own = additions if additions is not None else [NOTHING_MORE] * len(scenarios)
    runs = [build(scenario, placed, aircraft=False) for scenario, placed in zip(scenarios, own, strict=True)]
    first = runs[0]
    aircraft = [list_aircraft(run.scenario, number, honest=run.honest) for number, run in enumerate(runs)]
    world, engines = make_aircraft(first.scenario, first.city, aircraft, motion=False)
    for number, run in enumerate(runs):
        run.wiring.world, run.wiring.engines = world.of_run(number), engines
        run.header["engines"] = describe_engines(engines)
    return BuiltBatch(runs, world, engines)
