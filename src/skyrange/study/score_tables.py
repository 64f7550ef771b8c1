"""Tables that scoring reads, made from the results of a study."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from skyrange.core.errors import InputError, Problem, nearest
from skyrange.dataset.members import HELD_OUT, HeldOut, Traits, split_of
from skyrange.scoring.result_file import ScoreFile, ScoreSettings
from skyrange.scoring.scores import score_detectors
from skyrange.scoring.tables import ALERTS, ATTACKS, FLIGHTS, INTRUSIONS, NOMINAL, StudyTables, check_tables
from skyrange.study.design.model import Study
from skyrange.study.folder import StudyFolder, open_folder
from skyrange.study.learned_detectors import learn_detectors, write_models
from skyrange.study.results import cluster_blocks, read_results, write_results


def make_score_tables(folder: StudyFolder, held_out: HeldOut | None = None) -> StudyTables:
    """The flights, attacks, harmless intrusions and alerts of a study. Blocks with a held-out family, city or number of
    aircraft are in the test split; without `held_out` these are those of the study's file.

    An attack is taken to be observable from its first act on an aircraft on, and its effect to begin when the aircraft
    departs from the baseline. Raises `InputError` for results that cannot be scored.
    """
    write_results(folder)
    runs = {_run(row): row for row in _rows(folder, "runs") if row["status"] == "complete"}
    if any(row.get("flight") is None for row in runs.values()):
        hint = "Fly it again; its report needs no more than it has."
        raise InputError.one(f"study {folder.study.name}", "results", "without flights", "those of this version", hint)
    acts = [row for row in _rows(folder, "acts") if _run(row) in runs]
    clusters = cluster_blocks(folder, runs.values())
    splits = _assign_splits(folder, runs, clusters, held_out_of(folder.study) if held_out is None else held_out)
    own_from_s = _own_from(folder.study, runs, acts)
    attacked = [row for row in acts if not row["fault"] and not row["harmless_intrusion"]]
    hostile = {_run(row) for row in attacked}
    faulty = {_run(row) for row in acts if row["fault"]}
    fleets: dict[str, set[str]] = {}
    flights = []
    for row in _rows(folder, "aircraft"):
        run = _run(row)
        if run not in runs:
            continue
        fleets.setdefault(run, set()).add(row["vehicle"])
        flights.append(
            {
                "run": run,
                "block": row["block"],
                "cluster": clusters[row["block"]],
                "flight": runs[run]["flight"],
                "arm": row["arm"],
                "split": splits[row["block"]],
                "city": runs[run].get("city") or "",
                "aircraft": runs[run]["vehicles"],
                "vehicle": row["vehicle"],
                "duration_s": float(row["airborne_s"]),
                "own_from_s": own_from_s.get(run, 0.0),
                "shared_s": _shared_s(row, own_from_s.get(run, 0.0)),
                "hostile": run in hostile,
                "fault": run in faulty,
            }
        )
    effects = _effects(folder)
    attacks = [
        {
            "run": _run(row),
            "vehicle": row["vehicle"],
            "attack_id": row["attack"],
            "kind": row["kind"],
            "family": row["family"],
            "active_s": row["first_s"],
            "stop_s": row["last_s"],
            "effect_end_s": row["effect_end_s"],
            "observable_s": row["first_s"],
            "effect_s": _effect_s(effects.get(_run(row), {}), row["vehicle"], row["first_s"]),
        }
        for row in attacked
    ]
    intrusions = [
        {
            "run": _run(row),
            "vehicle": row["vehicle"],
            "attack_id": row["attack"],
            "kind": row["kind"],
            "active_s": row["first_s"],
            "stop_s": row["last_s"],
        }
        for row in acts
        if row["harmless_intrusion"]
    ]
    alerts = [
        {
            "run": _run(row),
            "detector": row["detector"],
            "time_s": row["time_s"],
            "subject": row["subject"] if row["subject"] in fleets.get(_run(row), ()) else "",
            "kind": row["kind"],
            "score": row["score"],
        }
        for row in _rows(folder, "alerts")
        if _run(row) in runs
    ]
    return check_tables(
        pa.Table.from_pylist(flights, FLIGHTS),
        pa.Table.from_pylist(attacks, ATTACKS),
        pa.Table.from_pylist(alerts, ALERTS),
        pa.Table.from_pylist(intrusions, INTRUSIONS),
    )


def score_study(
    folder: Path | str,
    settings: ScoreSettings | None = None,
    *,
    families: Collection[str] = (),
    cities: Collection[str] = (),
    fleet_sizes: Collection[int] = (),
) -> ScoreFile:
    """Train and score the detectors of the study in a folder: `skyrange study score` in Python.

    Models of learned detectors, with their cards, go to its folder `models`.

    Blocks with an attack of one of `families`, over one of `cities`, or with one of these numbers of aircraft are in
    the test split alone. Without any of them, what the study's file holds out is. Raises `InputError` for one that no
    run of the study has.
    """
    opened = open_folder(Path(folder))
    held_out = HeldOut(frozenset(families), frozenset(cities), frozenset(fleet_sizes))
    tables = make_score_tables(opened, held_out_of(opened.study) if held_out == HeldOut() else held_out)
    check_held_traits(opened, held_out)
    names = {detector.id for detector in opened.study.detectors} | set(tables.detectors())
    reduced = {detector.id: detector.plugin.reduced for detector in opened.study.detectors}
    if opened.study.learned is None:
        return score_detectors(tables, settings, sorted(names), opened.study.name, reduced)
    learned = learn_detectors(opened, tables)
    alerts = pa.concat_tables([tables.alerts, learned.alerts])
    tables = check_tables(tables.flights, tables.attacks, alerts, tables.intrusions)
    scores = score_detectors(tables, settings, sorted({*names, *learned.models}), opened.study.name, reduced)
    write_models(opened, learned, tables, scores)
    return scores


def held_out_of(study: Study) -> HeldOut:
    """What the file of a study holds out."""
    held_out = study.held_out
    return HeldOut(frozenset(held_out.families), frozenset(held_out.cities), frozenset(held_out.aircraft))


def check_held_traits(folder: StudyFolder, held_out: HeldOut) -> None:
    """Raise `InputError` for a family, city or number of aircraft that no run of the study in a folder has.

    It reads the results that were written last.
    """
    traits = [_traits(row) for row in _rows(folder, "runs") if row["status"] == "complete"]
    families = sorted({name for run_traits in traits for name in run_traits.families})
    cities, sizes = (
        sorted({run_traits.city for run_traits in traits}),
        sorted({run_traits.fleet_size for run_traits in traits}),
    )
    problems = []
    for axis, wanted, known in (("family", held_out.families, families), ("city", held_out.cities, cities)):
        problems += [
            Problem(f"held-out {axis}", name, f"one of {', '.join(known)}", nearest(name, known))
            for name in sorted(wanted - set(known))
        ]
    problems += [
        Problem("held-out fleet", str(size), f"one of {', '.join(map(str, sizes))}")
        for size in sorted(held_out.fleet_sizes - set(sizes))
    ]
    if problems:
        raise InputError(f"study {folder.study.name}", problems)


def _rows(folder: StudyFolder, table: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = read_results(folder.path, table).to_pylist()
    return rows


def _run(row: Mapping[str, Any]) -> str:
    return f"{row['block']}.{row['arm']}"


def _own_from(
    study: Study, runs: Mapping[str, Mapping[str, Any]], acts: Sequence[Mapping[str, Any]]
) -> dict[str, float]:
    """When each run begins to differ from the nominal one of its block: with its first act; a sham with the first
    attack of its block, whose times it has. Runs that repeat to the byte are equal before; what others lose of their
    hours is on the safe side.

    Runs of blocks without a nominal one are not among them, nor those without an act, nor those of arms that have
    defences or changes of their own.
    """
    alike = {arm.id: arm for arm in study.arms if not arm.defences and not arm.changes}
    first: dict[str, float] = {}
    attacked: dict[str, float] = {}
    for row in acts:
        at = float(row["first_s"])
        first[_run(row)] = min(first.get(_run(row), math.inf), at)
        if not row["fault"] and not row["harmless_intrusion"]:
            attacked[row["block"]] = min(attacked.get(row["block"], math.inf), at)
    for run, row in runs.items():
        arm = alike.get(row["arm"])
        if arm is not None and arm.attacks == "sham" and row["block"] in attacked:
            first[run] = min(first.get(run, math.inf), attacked[row["block"]])
    return {
        run: at for run, at in first.items() if runs[run]["arm"] in alike and f"{runs[run]['block']}.{NOMINAL}" in runs
    }


def _shared_s(row: Mapping[str, Any], own_from_s: float) -> float:
    """The airborne time of an aircraft before its run differs from the nominal one."""
    takeoff_s = row["takeoff_s"]
    return 0.0 if takeoff_s is None else min(max(own_from_s - float(takeoff_s), 0.0), float(row["airborne_s"]))


def _assign_splits(
    folder: StudyFolder,
    runs: Mapping[str, Mapping[str, Any]],
    clusters: Mapping[str, str],
    held_out: HeldOut,
) -> dict[str, str]:
    """The split of each block: that of a data set of the study, except that what is held out is in the test split."""
    traits: dict[str, list[Traits]] = {}
    for row in runs.values():
        traits.setdefault(clusters[row["block"]], []).append(_traits(row))
    seed = folder.study.first_seed
    splits = {name: split_of(name, traits.get(name, ()), seed, held_out) for name in dict.fromkeys(clusters.values())}
    parts = {name: "test" if split.startswith(HELD_OUT) else split for name, split in splits.items()}
    return {block: parts[cluster] for block, cluster in clusters.items()}


def _traits(row: Mapping[str, Any]) -> Traits:
    return Traits(frozenset((row.get("families") or "").split()), row.get("city") or "", row["vehicles"])


def _effects(folder: StudyFolder) -> dict[str, dict[str, float]]:
    """By run: when each aircraft departed from the baseline."""
    departed_s: dict[str, dict[str, float]] = {}
    for row in _rows(folder, "effects"):
        if row.get("departed_s") is not None:
            departed_s.setdefault(_run(row), {})[row["vehicle"]] = row["departed_s"]
    return departed_s


def _effect_s(departed: Mapping[str, float], vehicle: str, first_s: float) -> float:
    """The first effect of an attack, on its aircraft or on any; NaN for none. One before the attack is not its own."""
    times = [at for aircraft, at in departed.items() if (not vehicle or aircraft == vehicle) and at >= first_s]
    return min(times, default=math.nan)
