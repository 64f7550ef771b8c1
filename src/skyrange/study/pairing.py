"""Pairing of runs: one scenario run with its attacks and faults and without them, compared in one folder.

Arms: *attacked* is the unchanged scenario; in *nominal* every attack and fault is present and muted; in
*sham* each is in its counterfactual state; in others some act and the rest are in theirs (`attribution.arms`). In
*honest* real aircraft fly where attacks claim that some are. Each arm is a separate run in its own process.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.assembly.build import build
from skyrange.core.errors import ComponentError, InputError, ShortfallError
from skyrange.core.files import atomic_write, expand_user
from skyrange.metrics.aircraft import DEPARTED_M
from skyrange.metrics.safety import NEAR_M
from skyrange.record.folder import make_new_folder
from skyrange.runtime.run import free_folder
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.parallel_runs import OnRunProgress, RunResult, require_level, run_all
from skyrange.twins.arms import (
    ATTACKED,
    HONEST,
    Arm,
    Selection,
    acting_attacks,
    acting_faults,
    baseline_of,
    claiming_attacks,
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
    on_progress: OnRunProgress | None = None,
) -> Pair:
    """Run a scenario with its attacks and faults and with all of them muted: `skyrange pair` in Python.

    `scenario`, `seed`, `buildings` and `changes` are those of `skyrange.run`. `out` defaults to the first free folder
    of `runs/NAME-pair`, `runs/NAME-pair-2` … `arms` selects the runs: `baseline` (attacked and the run
    that its effects are measured against), `nominal` (attacked and nominal), `sham` (the
    sham as well), `each` (each attack alone and each left out as well) or `subsets` (every subset of the attacks); the
    default is `subsets` for up to four attacks and `each` for more. `seeds` repeats all arms with that many consecutive
    seeds, beginning with the scenario's. `honest` adds the arm in which a real aircraft flies where an attack claims
    that one is and sends the same bytes (`honest.parquet`); it raises `InputError` if no attack claims any, or if no
    aircraft can fly where it is claimed. `run_reports` gives each run a report of its own beside that of the pair, as
    `skyrange report` does later. `known` are folders of complete runs, by arm and seed, that would be the same: they
    are taken over instead of flown. `jobs` is the number of parallel runs, by default one per core. Raises
    `InputError`, before anything is written, for a scenario without attacks or faults that act; `ComponentError` if a
    run failed; `ShortfallError` after Ctrl-C. The folder then holds the runs that ended.
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
        what = "all muted or sham" if scenario.acts else "none"
        expected = "an attack or a fault that acts, to compare with"
        raise InputError.one(f"scenario {scenario.name}", "attacks", what, expected)
    faults = acting_faults(scenario)
    if honest and not claiming_attacks(scenario):
        kinds = ", ".join(attack.kind for attack in scenario.attacks) or "none"
        raise InputError.one("pair", "honest", kinds, "an attack that claims an aircraft, such as remote_id.spoof")
    planned = plan_arms(attacks, arms, honest=honest)
    baseline = baseline_of(attacks, planned)
    build(scenario)  # raises errors in the scenario before a folder is created
    if honest:
        build(scenario_of(scenario, Arm(HONEST), scenario.seed))
    folder = make_new_folder(expand_user(out) if out is not None else free_folder(f"{scenario.name}-pair"))
    numbers = [scenario.seed + k for k in range(seeds)]
    flights = [(arm, number) for number in numbers for arm in planned]
    flown = [RunResult(0, "")] * len(flights)
    missing = []
    for place, (arm, number) in enumerate(flights):
        if (arm.name, number) in known:
            _take_over(known[arm.name, number], folder / folder_of(arm.name, number, numbers))
        else:
            missing.append(place)
    results = run_all(
        [
            (scenario_of(scenario, arm, number), folder / folder_of(arm.name, number, numbers))
            for arm, number in (flights[place] for place in missing)
        ],
        jobs,
        on_progress,
        report=run_reports,
    )
    for place, one in zip(missing, results, strict=True):
        flown[place] = one
    manifest = {
        "format": FORMAT,
        "name": scenario.name,
        "arms": [arm.name for arm in planned],
        "active": {arm.name: sorted(arm.active) for arm in planned},
        "attacks": {id_: state for id_, state in attacks.items() if id_ not in faults},
        "faults": faults,
        "baseline": baseline,
        "seeds": numbers,
        "near_m": near_m,
        "threshold_m": threshold_m,
        "status": "complete" if not any(one.exit_code for one in flown) else "failed",
        "runs": [
            {
                "arm": arm.name,
                "seed": number,
                "folder": folder_of(arm.name, number, numbers),
                "error": one.message or None,
            }
            for (arm, number), one in zip(flights, flown, strict=True)
        ],
    }
    with atomic_write(folder / MANIFEST) as file:
        file.write(f"{json.dumps(manifest, indent=2)}\n".encode())
    worst = max(flown, key=lambda one: one.exit_code)
    if worst.exit_code == ShortfallError.exit_code:
        raise ShortfallError(f"interrupted; the runs so far are in {folder}", folder)
    if worst.exit_code:
        at = flown.index(worst)
        raise ComponentError(f"run {flights[at][0].name}, seed {flights[at][1]}", worst.message)
    result = Pair(folder, manifest)
    _write_comparison(result, planned, near_m, threshold_m)
    return result


def _take_over(run: Path, folder: Path) -> None:
    """A run's folder at another place: files are the same on disk where the file system can, else copied."""

    def link(source: str, target: str) -> None:
        try:
            os.link(source, target)
        except OSError:
            shutil.copy2(source, target)

    shutil.copytree(run, folder, copy_function=link)


def _write_comparison(result: Pair, arms: Sequence[Arm], near_m: float, threshold_m: float) -> None:
    """Write attribution, effects, propagation and the report when all runs are complete."""

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
        mine = outcomes_of(ATTACKED, seed)
        for against in result.twins:
            rows = effect_rows(seed, against, mine, outcomes_of(against, seed), threshold_m)
            effects += [with_authors(row, named, result.faults) for row in rows]
        if result.baseline is not None and HONEST in result.arms:
            arms_of = (mine, outcomes_of(HONEST, seed), outcomes_of(result.baseline, seed))
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
