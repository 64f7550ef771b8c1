"""Plan of the simulated flights that logs are held against: each flight with each autopilot and each seed."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Final

import tomli_w
from pydantic import Field
from typing_extensions import TypedDict

from skyrange.assembly.batches import count_together
from skyrange.assembly.build import build
from skyrange.codec.mission import format_waypoints
from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.core.typed_json import Finite
from skyrange.flightlog.conversion import MISSION, Conversion
from skyrange.flightlog.flights import split_flights
from skyrange.flightlog.run_folder import read_run
from skyrange.parity.flights import with_autopilot
from skyrange.parity.logs.choice import JudgedFlight
from skyrange.parity.logs.measures import DescribedMeasures, FlightMeasures, measure_flight
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text
from skyrange.study.execution.plan import PlannedBlock, PlannedRun, RunPlan, digest_plan
from skyrange.study.execution.store import RunStore
from skyrange.study.plan_size import MAX_RUNS

KIND: Final = "parity log"
_INPUTS: Final = "flights"
_STREAMS: Final = "operator"
"""Telemetry that the simulated ground stations request: it has all messages that are compared."""


class ToldFlight(TypedDict):
    """One flight of a log, as the plan's manifest has it."""

    name: Annotated[str, Field(pattern=r"^[\w-]{1,64}$")]
    """A folder of the plan is called so."""
    scenario: str
    """TOML."""
    mission: str
    """The text of the mission's file."""
    log: DescribedMeasures
    judged_from_s: Finite
    """Seconds of the log; -1 for all of it."""
    estimates: str
    """What is estimated, in words."""


class ToldPlan(TypedDict):
    """What `LogParityPlan.tell` says."""

    flights: list[ToldFlight]
    seeds: dict[Annotated[str, Field(pattern="^(builtin|ardupilot)$")], Annotated[int, Field(ge=1, le=MAX_RUNS)]]
    """By autopilot."""
    unjudged: dict[str, str]
    firmware: str


class FlownFlight(TypedDict):
    """What is stored of a simulated flight."""

    outcome: str
    measures: DescribedMeasures | None


@dataclass(frozen=True)
class LogParityPlan(RunPlan):
    """The simulated flights: a block for each."""

    flights: tuple[ToldFlight, ...]
    seeds: Mapping[str, int]
    """By autopilot: how many seeds, from 1 on."""
    unjudged: Mapping[str, str]
    firmware: str

    kind = KIND

    @property
    def name(self) -> str:
        """The name of the first flight, or how many there are."""
        return self.flights[0]["name"] if len(self.flights) == 1 else f"{len(self.flights)} flights"

    @property
    def blocks(self) -> Sequence[PlannedBlock]:
        """One for each flight, autopilot and seed."""
        return list(self.runs)

    @cached_property
    def runs(self) -> dict[PlannedBlock, tuple[int, str, int]]:
        """The number of the flight, the autopilot and the seed of each block."""
        runs = {}
        for number, flight in enumerate(self.flights):
            work = float(tomllib.loads(flight["scenario"])["duration_s"])
            for autopilot, seeds in self.seeds.items():
                for seed in range(1, seeds + 1):
                    name = name_run(flight["name"], autopilot, seed)
                    block = PlannedBlock(name, (name,), work, alike=f"{flight['name']}/{autopilot}")
                    runs[block] = number, autopilot, seed
        return runs

    @cached_property
    def together(self) -> int:
        """See `RunPlan`: as many as of the first flight, since all have one aircraft."""
        with TemporaryDirectory(prefix="skyrange-") as made:
            self.write_missions(Path(made))
            return max(count_together(self.load(0, Path(made), autopilot)) for autopilot in self.seeds)

    def digest(self) -> str:
        """See `RunPlan.digest`."""
        return digest_plan(self.kind, self.tell(), ())

    def tell(self) -> dict[str, Any]:
        """The scenarios, missions and measures of all flights, and how they are flown."""
        told: ToldPlan = {
            "flights": list(self.flights),
            "seeds": dict(self.seeds),
            "unjudged": dict(self.unjudged),
            "firmware": self.firmware,
        }
        return dict(told)

    def write_missions(self, folder: Path) -> None:
        """Write the missions that the scenarios name below a folder."""
        for flight in self.flights:
            place = folder / _INPUTS / flight["name"]
            place.mkdir(parents=True, exist_ok=True)
            if flight["mission"]:
                with atomic_write(place / MISSION) as file:
                    file.write(flight["mission"].encode())

    def load(self, number: int, folder: Path, autopilot: str = "builtin", seed: int = 1) -> Scenario:
        """The scenario of a flight, whose missions are below `folder`."""
        flight = self.flights[number]
        scenario = load_text(flight["scenario"], flight["name"], folder / _INPUTS / flight["name"], seed=seed)
        return with_autopilot(scenario, autopilot).model_copy(update={"record": scenario.record})

    def check(self, finished: Set[str] = frozenset()) -> None:
        """Raise `InputError` for a scenario that cannot be built with one of the autopilots.

        Flights whose runs are all `finished`, by name, need no autopilot any more.
        """
        with TemporaryDirectory(prefix="skyrange-") as made:
            self.write_missions(Path(made))
            for number, flight in enumerate(self.flights):
                failed: dict[str, InputError] = {}
                for autopilot, seeds in self.seeds.items():
                    if all(name_run(flight["name"], autopilot, seed + 1) in finished for seed in range(seeds)):
                        continue
                    try:
                        build(self.load(number, Path(made), autopilot))
                    except InputError as error:
                        failed[autopilot] = error
                others = [autopilot for autopilot in self.seeds if autopilot not in failed]
                for fault in failed.values():
                    if not others:
                        raise fault
                    (first, *further) = fault.problems
                    hint = f"{first.hint} --autopilot {others[0]} does without it."
                    raise InputError(fault.who, [replace(first, hint=hint), *further]) from fault

    def plan_runs(self, block: PlannedBlock, store: RunStore) -> list[PlannedRun]:
        """The one run of a block."""
        number, autopilot, seed = self.runs[block]
        (folder,) = block.folders
        return [PlannedRun(folder, self.load(number, store.path, autopilot, seed))]

    def measure(
        self, block: PlannedBlock, records: Mapping[str, RunRecord], errors: Mapping[str, str], store: RunStore
    ) -> dict[str, Any] | None:
        """The measures of the run by the log of its ground station."""
        for record in records.values():
            return dict(measure_run(record))
        return None

    def reduce(self, block: PlannedBlock, records: Mapping[str, RunRecord], root: Path) -> int:
        """Delete all runs but those of the first seed."""
        _, _, seed = self.runs[block]
        if seed > 1:
            for folder in block.folders:
                shutil.rmtree(root / folder, ignore_errors=True)
        return 0


def name_run(flight: str, autopilot: str, seed: int) -> str:
    """The name of the block of a run, which is its folder as well."""
    return f"{flight}/{autopilot}/seed-{seed}"


def measure_run(record: RunRecord) -> FlownFlight:
    """The measures of a simulated flight, from the log that its ground station would have written."""
    flights = split_flights(read_run(record.path))
    measures = measure_flight(flights[0], whole=True) if flights else None
    outcomes = ", ".join(str(outcome.get("state") or "unfinished") for outcome in record.outcomes.values())
    return {"outcome": outcomes, "measures": None if measures is None else measures.describe()}


def _format_scenario(conversion: Conversion) -> str:
    """The scenario as TOML, with all telemetry that is compared."""
    scenario = dict(conversion.scenario)
    scenario["operators"] = [operator | {"streams": _STREAMS} for operator in scenario["operators"]]
    return tomli_w.dumps(scenario)


def tell_flight(judged: JudgedFlight, measures: FlightMeasures) -> ToldFlight:
    """A flight as the plan's manifest has it."""
    conversion = judged.conversion
    return {
        "name": judged.name,
        "scenario": _format_scenario(conversion),
        "mission": format_waypoints(conversion.mission) if conversion.mission is not None else "",
        "log": measures.describe(),
        "judged_from_s": max(judged.judged_from_s, -1.0),
        "estimates": "; ".join(
            f"{fact.subject} {fact.value}, {fact.reason}" for fact in conversion.facts if fact.kind == "estimated"
        ),
    }
