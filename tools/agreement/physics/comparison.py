"""Flights of scenarios in the range's own physics and in Gazebo's, with one seed, and what differs between them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from skyrange.assembly.build import build
from skyrange.core.files import atomic_write
from skyrange.parity.flights import with_autopilot
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly
from tools.agreement.physics.flights import RunDifference, compare_runs

OnStep = Callable[[str, int, int], None]
"""Called with what is being done, how many steps are done, and how many there are."""

SCENARIOS: Final = ("squares", "head-on", "wind")
"""Shipped scenarios that are compared unless others are named."""
FINE_STEPS: Final = 5
"""Steps of Gazebo in a tick, in the runs that show what the length of a step changes."""
RESULTS: Final = "physics.json"


@dataclass(frozen=True, slots=True)
class ComparedScenario:
    """A scenario in both. `repeated` is a second run in Gazebo against the first, `fine` one with `FINE_STEPS` steps
    in each tick against the first; `None` if these were not flown.
    """

    name: str
    title: str
    duration_s: float
    seed: int
    difference: RunDifference
    repeated: RunDifference | None = None
    fine: RunDifference | None = None


@dataclass(frozen=True, slots=True)
class PhysicsComparison:
    """All scenarios, and the versions of the programs that flew them."""

    scenarios: tuple[ComparedScenario, ...]
    gazebo: str
    """Its name and version ("Gazebo 11.1.0")."""
    physics: str
    """Physics engine of Gazebo ("ode")."""
    arducopter: str


def compare(
    folder: Path,
    names: Sequence[str] = SCENARIOS,
    changes: Sequence[str] = (),
    *,
    again: str = SCENARIOS[0],
    on_step: OnStep | None = None,
) -> PhysicsComparison:
    """Fly the scenarios `names`, shipped ones or files, with ArduCopter in both kinds of physics, into `folder`.

    The scenario `again` is flown twice more in Gazebo: unchanged, and with finer steps. Raises `InputError` without
    Gazebo, its plugin or ArduCopter, and the errors of `study.runs.fly`.
    """
    loaded = {name: load(name, changes) for name in names}
    runs = [
        (name, kind, steps)
        for name in names
        for kind, steps in (
            ("ardupilot", 1),
            ("gazebo", 1),
            *([("again", 1), ("fine", FINE_STEPS)] if name == again else []),
        )
    ]
    scenarios = [(f"{loaded[name].name}-{kind}", _in_physics(loaded[name], kind, steps)) for name, kind, steps in runs]
    for _, scenario in scenarios:
        build(scenario).close()  # raises errors in the last one before the first one flies
    flown: dict[tuple[str, str], RunRecord] = {}
    for done, ((name, kind, _), (place, scenario)) in enumerate(zip(runs, scenarios, strict=True)):
        if on_step is not None:
            on_step(f"{scenario.name}, {kind}", done, len(runs))
        flown[name, kind] = fly(scenario, folder / place, report=False)
    compared = tuple(
        ComparedScenario(
            name=Path(name).stem,
            title=loaded[name].name,
            duration_s=loaded[name].duration_s,
            seed=loaded[name].seed,
            difference=compare_runs(flown[name, "ardupilot"], flown[name, "gazebo"]),
            repeated=_against(flown, name, "again"),
            fine=_against(flown, name, "fine"),
        )
        for name in names
    )
    (engine,) = flown[names[0], "gazebo"].manifest["engines"]
    gazebo = engine["gazebo"]
    title = f"Gazebo {'Sim ' if gazebo['flavour'] == 'sim' else ''}{gazebo['version']}"
    found = PhysicsComparison(compared, title, gazebo["physics"], engine["version"])
    with atomic_write(folder / RESULTS) as file:
        file.write(json.dumps(results(found), indent=1).encode())
    return found


def results(found: PhysicsComparison) -> dict[str, Any]:
    """All differences as plain data."""
    return asdict(found)


def _in_physics(scenario: Scenario, kind: str, steps: int) -> Scenario:
    if kind == "ardupilot":
        return with_autopilot(scenario, kind)
    options = {"steps_per_tick": steps}
    autopilots = scenario.autopilots.with_options("gazebo", options, f"{scenario.name} in Gazebo")
    return with_autopilot(scenario.model_copy(update={"autopilots": autopilots}), "gazebo")


def _against(flown: dict[tuple[str, str], RunRecord], name: str, kind: str) -> RunDifference | None:
    return compare_runs(flown[name, "gazebo"], flown[name, kind]) if (name, kind) in flown else None
