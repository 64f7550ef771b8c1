"""Pairing of runs: one scenario run with its attacks and faults and without them, compared in one folder.

Arms: *attacked* is the unchanged scenario; in *nominal* every attack and fault is present and muted; in
*sham* each is in its counterfactual state; in others some act and the rest are in theirs (`attribution.arms`). In
*honest* real aircraft fly where attacks claim that some are. Each arm with each seed is a block of a plan.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import Field
from typing_extensions import TypedDict

from skyrange.assembly.build import build
from skyrange.core.errors import InputError, ShortfallError
from skyrange.core.files import atomic_write, expand_user
from skyrange.core.typed_json import Finite, check_type
from skyrange.metrics.aircraft import DEPARTED_M
from skyrange.metrics.safety import NEAR_M
from skyrange.record import RunRecord
from skyrange.record.schema import LEVELS, keeps
from skyrange.runtime.run import free_folder
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.scenario.toml_files import load_text, to_toml
from skyrange.study.execution.executors import Executor
from skyrange.study.execution.plan import PlannedBlock, PlannedRun, RunPlan, digest_plan
from skyrange.study.execution.plan_run import (
    OnPlanProgress,
    choose_executor,
    forget_failures,
    require_success,
    run_plan,
)
from skyrange.study.execution.store import MANIFEST as PLAN
from skyrange.study.execution.store import RunStore, claim_store
from skyrange.study.plan_size import MAX_RUNS, check_size
from skyrange.twins.arms import (
    ATTACKED,
    HONEST,
    Arm,
    Selection,
    acting_attacks,
    acting_faults,
    baseline_of,
    claiming_attacks,
    count_arms,
    plan_arms,
    scenario_of,
)
from skyrange.twins.attribution import (
    attribute,
    attribution_table,
    authors,
    departures_by_author,
    with_authors,
)
from skyrange.twins.effects import ArmOutcomes, effect_rows, effects_table
from skyrange.twins.lie_and_truth import compare_with_truth, lie_and_truth_table
from skyrange.twins.pair_folder import (
    ATTRIBUTION,
    EFFECTS,
    FORMAT,
    LIE_AND_TRUTH,
    MANIFEST,
    PROPAGATION,
    Pair,
    folder_of,
)
from skyrange.twins.propagation import absent_rows, effects_of, mark_faults, propagation_table, trace


@dataclass(frozen=True)
class PairPlan(RunPlan):
    """The runs of a pair: a block for each arm with each seed, so that the arms of one seed fly side by side."""

    scenario: Scenario
    selection: Selection | None
    seeds: tuple[int, ...]
    near_m: float = NEAR_M
    threshold_m: float = DEPARTED_M
    honest: bool = False
    run_reports: bool = True
    known: Mapping[tuple[str, int], Path] = field(default_factory=dict)
    """Folders of complete runs, by arm and seed, that would be the same."""

    kind = "pair"

    @property
    def name(self) -> str:
        """The name of the scenario."""
        return self.scenario.name

    @cached_property
    def arms(self) -> list[Arm]:
        """The arms that are flown."""
        return plan_arms(acting_attacks(self.scenario), self.selection, honest=self.honest)

    @property
    def blocks(self) -> Sequence[PlannedBlock]:
        """One for each arm with each seed, seed by seed."""
        return list(self.flights)

    @cached_property
    def flights(self) -> dict[PlannedBlock, tuple[Arm, int]]:
        """The arm and the seed of each block, in order."""
        work = work_of(self.scenario)
        return {
            PlannedBlock(f"seed-{seed}/{arm.name}", (folder_of(arm.name, seed, self.seeds),), work, alike=arm.name): (
                arm,
                seed,
            )
            for seed in self.seeds
            for arm in self.arms
        }

    def digest(self) -> str:
        """See `RunPlan.digest`."""
        return digest_plan(self.kind, self.tell(), [self.scenario])

    def tell(self) -> dict[str, Any]:
        """The scenario as TOML, and how it is flown."""
        return {
            "scenario": to_toml(self.scenario),
            "arms": self.selection,
            "seeds": len(self.seeds),
            "near_m": self.near_m,
            "threshold_m": self.threshold_m,
            "honest": self.honest,
            "run_reports": self.run_reports,
        }

    def plan_runs(self, block: PlannedBlock, store: RunStore) -> list[PlannedRun]:
        """The one run of a block."""
        arm, seed = self.flights[block]
        scenario = scenario_of(self.scenario, arm, seed)
        (folder,) = block.folders
        return [PlannedRun(folder, scenario, report=self.run_reports, same_as=self.known.get((arm.name, seed)))]

    def measure(
        self, block: PlannedBlock, records: Mapping[str, RunRecord], errors: Mapping[str, str], store: RunStore
    ) -> None:
        """Nothing: runs are kept, and compared when all have ended."""


def work_of(scenario: Scenario) -> float:
    """How long a run may take compared with others: aircraft-seconds."""
    return sum(1 for _ in scenario.fleet) * float(scenario.duration_s)


def require_level(scenario: Scenario, table: str, who: str) -> None:
    """Raise `InputError` for `who` if runs of a scenario would not keep a table that it reads."""
    level = scenario.record.level
    if not keeps({"record": {"level": level}}, table):
        enough = [kept_level for kept_level in LEVELS if keeps({"record": {"level": kept_level}}, table)]
        hint = f"It reads the {table} of each run. Add --set record.level={enough[-1]}."
        raise InputError.one(who, "record.level", level, " or ".join(reversed(enough)), hint)


def pair(
    scenario: Scenario | str | Path,
    out: str | Path | None = None,
    *,
    arms: Selection | None = None,
    seeds: int = 1,
    jobs: int | None = None,
    seed: int | None = None,
    buildings: str | Path | None = None,
    changes: Sequence[str] = (),
    near_m: float = NEAR_M,
    threshold_m: float = DEPARTED_M,
    honest: bool = False,
    run_reports: bool = True,
    known: Mapping[tuple[str, int], Path] = MappingProxyType({}),
    max_runs: int = MAX_RUNS,
    executor: Executor | None = None,
    on_progress: OnPlanProgress | None = None,
) -> Pair:
    """Run a scenario with its attacks and faults and with all of them muted: `skyrange pair` in Python.

    `scenario`, `seed`, `buildings` and `changes` are those of `skyrange.run`. `out` defaults to the first free folder
    of `runs/NAME-pair`, `runs/NAME-pair-2` …; a folder in which the same was begun is gone on with. `arms` selects the
    runs: `baseline` (attacked and the run that its effects are measured against), `nominal` (attacked and nominal),
    `sham` (the sham as well), `each` (each attack alone and each left out as well) or `subsets` (every subset of the
    attacks); the default is `subsets` for up to four attacks and `each` for more. `seeds` repeats all arms with that
    many consecutive seeds, beginning with the scenario's. `honest` adds the arm in which a real aircraft flies where an
    attack claims that one is and sends the same bytes (`honest.parquet`); it raises `InputError` if no attack claims
    any, or if no aircraft can fly where it is claimed. `run_reports` gives each run a report of its own beside that of
    the pair, as `skyrange report` does later. `known` are folders of complete runs, by arm and seed, that would be the
    same: they are taken over instead of flown. `jobs` is the number of parallel runs, by default one per core; one run
    at a time is flown in this process. `executor` flies them elsewhere. Raises `InputError`, before anything is
    written, for a scenario without attacks or faults that act, and for a folder of something else; `ComponentError` if
    a run failed; `ShortfallError` after Ctrl-C. The folder then holds the runs that ended. More runs than
    `max_runs` raise `InputError`.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario, changes, seed=seed, buildings=buildings)
    elif seed is not None or buildings is not None or changes:
        raise TypeError("seed, buildings and changes apply to a scenario's name or file; a Scenario holds its own")
    jobs = jobs if jobs is not None else os.cpu_count() or 1
    for name, value in (("seeds", seeds), ("jobs", jobs)):
        if value < 1:
            raise InputError.one("pair", name, value, "1 or more")
    require_level(scenario, "frames", "pair")  # effects are followed from frame to frame
    attacks = acting_attacks(scenario)
    if not attacks:
        given = "all muted, sham, or waiting for a start by hand" if scenario.acts else "none"
        expected = "an attack or a fault that acts, to compare with"
        raise InputError.one(f"scenario {scenario.name}", "attacks", given, expected)
    if honest and not claiming_attacks(scenario):
        kinds = ", ".join(attack.kind for attack in scenario.attacks) or "none"
        raise InputError.one("pair", "honest", kinds, "an attack that claims an aircraft, such as remote_id.spoof")
    sizes = {"arms": count_arms(attacks, arms, honest=honest), "seeds": seeds}
    check_size("pair", sizes, max_runs, "Say --max-runs N, or --arms for fewer arms.")
    plan = PairPlan(
        scenario,
        arms,
        tuple(scenario.seed + k for k in range(seeds)),
        near_m,
        threshold_m,
        honest,
        run_reports,
        known,
    )
    build(scenario)  # raises errors in the scenario before a folder is created
    if honest and plan.arms:
        build(scenario_of(scenario, Arm(HONEST), scenario.seed))
    store = claim_store(plan, expand_user(out) if out is not None else free_folder(f"{scenario.name}-pair"))
    forget_failures(store)
    try:
        result = run_plan(plan, store, executor if executor is not None else choose_executor(jobs), on_progress)
    except ShortfallError:
        _write_manifest(plan, store, "interrupted")
        raise
    manifest = _write_manifest(plan, store, "failed" if result.failures else "complete")
    require_success(plan, result)
    flown = Pair(store.path, manifest)
    _write_comparison(flown, plan.arms)
    return flown


def resume_pair(store: RunStore, executor: Executor, on_progress: OnPlanProgress | None = None) -> Pair:
    """Go on with the pair in a folder: `skyrange resume`. Raises the errors of `pair`."""
    told: _Told = check_type(store.told, _Told, str(store.path), f"{PLAN}: told")
    return pair(
        load_text(told["scenario"]),
        store.path,
        arms=told["arms"],
        seeds=told["seeds"],
        near_m=told["near_m"],
        threshold_m=told["threshold_m"],
        honest=told["honest"],
        run_reports=told["run_reports"],
        max_runs=max(MAX_RUNS, int(store.manifest["blocks"])),
        executor=executor,
        on_progress=on_progress,
    )


class _Told(TypedDict):
    """What `PairPlan.tell` says."""

    scenario: str
    arms: Selection | None
    seeds: Annotated[int, Field(ge=1)]
    near_m: Finite
    threshold_m: Finite
    honest: bool
    run_reports: bool


def _write_manifest(plan: PairPlan, store: RunStore, status: str) -> dict[str, Any]:
    """Write `pair.json`, which says what became of each run that is finished."""
    errors = {result.name: result.errors[0] for result in store.list_failures()}
    finished = store.finished()
    runs = [
        {"arm": arm.name, "seed": seed, "folder": block.folders[0], "error": errors.get(block.name)}
        for block, (arm, seed) in plan.flights.items()
        if block.name in finished
    ]
    limits = {"near_m": plan.near_m, "threshold_m": plan.threshold_m}
    manifest = _describe(plan.scenario, plan.arms, plan.seeds) | limits | {"status": status, "runs": runs}
    _write_json(manifest, store.path)
    return manifest


def compare_arms(folder: Path, scenario: Scenario, arms: Sequence[Arm], seed: int) -> Pair:
    """Make a pair of the complete runs of one seed in a folder, each in one that is named by its arm: write manifest,
    tables and report.
    """
    runs = [{"arm": arm.name, "seed": seed, "folder": arm.name, "error": None} for arm in arms]
    limits = {"near_m": NEAR_M, "threshold_m": DEPARTED_M}
    manifest = _describe(scenario, arms, [seed]) | limits | {"status": "complete", "runs": runs}
    _write_json(manifest, folder)
    result = Pair(folder, manifest)
    _write_comparison(result, arms)
    return result


def _describe(scenario: Scenario, arms: Sequence[Arm], seeds: Sequence[int]) -> dict[str, Any]:
    """Entries of the manifest."""
    attacks, faults = acting_attacks(scenario), acting_faults(scenario)
    return {
        "format": FORMAT,
        "name": scenario.name,
        "arms": [arm.name for arm in arms],
        "active": {arm.name: sorted(arm.active) for arm in arms},
        "attacks": {id_: state for id_, state in attacks.items() if id_ not in faults},
        "faults": faults,
        "baseline": baseline_of(attacks, arms),
        "seeds": list(seeds),
    }


def _write_json(manifest: Mapping[str, Any], folder: Path) -> None:
    with atomic_write(folder / MANIFEST) as file:
        file.write(f"{json.dumps(manifest, indent=2)}\n".encode())


def _write_comparison(result: Pair, arms: Sequence[Arm]) -> None:
    """Write attribution, effects, propagation and the report when all runs are complete."""
    near_m, threshold_m = float(result.manifest["near_m"]), float(result.manifest["threshold_m"])

    @cache
    def measured_of(arm: str, seed: int) -> ArmOutcomes:
        return ArmOutcomes.read(result.run(arm, seed), near_m)

    def outcomes_of(arm: str, seed: int) -> ArmOutcomes:
        return replace(measured_of(arm, seed))  # positions are read by each copy, and go with it

    attributed = attribute(outcomes_of, result.seeds, arms, result.baseline, threshold_m, result.faults)
    named = authors(attributed)
    effects: list[dict[str, Any]] = []
    propagation: list[dict[str, Any]] = []
    truths: list[dict[str, Any]] = []
    for seed in result.seeds:
        attacked = result.run(ATTACKED, seed)
        departed = departures_by_author(attributed, seed)
        traced = trace(attacked, seed, near_m, departed)
        if result.baseline is not None:
            traced += absent_rows(attacked, result.run(result.baseline, seed), seed, departed)
        attacked_outcomes = outcomes_of(ATTACKED, seed)
        for against in result.twins:
            rows = effect_rows(seed, against, attacked_outcomes, outcomes_of(against, seed), threshold_m)
            effects += [with_authors(row, named, result.faults) for row in rows]
        if result.baseline is not None and HONEST in result.arms:
            arms_of = (attacked_outcomes, outcomes_of(HONEST, seed), outcomes_of(result.baseline, seed))
            truths += compare_with_truth(seed, *arms_of, threshold_m)
        propagation += sorted([*traced, *effects_of(traced, attributed, seed)], key=_time_ns)
    _write(effects_table(effects), result.path / EFFECTS)
    _write(propagation_table(mark_faults(propagation, result.faults)), result.path / PROPAGATION)
    _write(attribution_table(attributed), result.path / ATTRIBUTION)
    if HONEST in result.arms:
        _write(lie_and_truth_table(truths), result.path / LIE_AND_TRUTH)
    from skyrange.report.pair.page import write_comparison

    write_comparison(result, result.report)


def _time_ns(row: Mapping[str, Any]) -> int:
    return int(row["at_ns"])


def _write(table: pa.Table, path: Path) -> None:
    with atomic_write(path) as file:
        pq.write_table(table, file)
