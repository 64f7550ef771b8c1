"""Tables that scoring reads, made from the results of a study."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.study.scoring.result_file import ScoreFile, ScoreSettings
from skyrange.study.scoring.scores import score_detectors
from skyrange.study.scoring.tables import ALERTS, ATTACKS, FLIGHTS, StudyTables, check_tables
from skyrange.study.sweep.folder import StudyFolder, open_folder
from skyrange.study.sweep.results import read_results, write_results

SHARES: Final = {"train": 0.4, "validation": 0.3, "test": 0.3}
"""Shares of the blocks in each split, of those that are not held out."""
_STREAM: Final = "study.split"


def make_score_tables(
    folder: StudyFolder, *, families: frozenset[str] = frozenset(), cities: frozenset[str] = frozenset()
) -> StudyTables:
    """The flights, attacks and alerts of a study. Blocks with a held-out family or city are in the test split.

    An attack is taken to be observable from its first act on an aircraft on, and its effect to begin when the aircraft
    departs from the baseline. Raises `InputError` for results that cannot be scored.
    """
    write_results(folder)
    runs = {_run(row): row for row in _rows(folder, "runs") if row["status"] == "complete"}
    acts = [row for row in _rows(folder, "acts") if _run(row) in runs]
    splits = _assign_splits(folder, runs, acts, families, cities)
    hostile = {_run(row) for row in acts if not row["fault"]}
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
                "arm": row["arm"],
                "split": splits[row["block"]],
                "city": runs[run].get("city") or "",
                "aircraft": runs[run]["vehicles"],
                "vehicle": row["vehicle"],
                "duration_s": float(row["airborne_s"]),
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
            "observable_s": row["first_s"],
            "effect_s": _effect_s(effects, _run(row), row["vehicle"], row["first_s"]),
        }
        for row in acts
        if not row["fault"]
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
    )


def score_study(
    folder: Path | str,
    settings: ScoreSettings | None = None,
    *,
    families: Collection[str] = (),
    cities: Collection[str] = (),
) -> ScoreFile:
    """Score the detectors of the study in a folder: `skyrange study score` in Python.

    Blocks with an attack of one of `families`, or over one of `cities`, are in the test split alone.
    """
    opened = open_folder(Path(folder))
    tables = make_score_tables(opened, families=frozenset(families), cities=frozenset(cities))
    names = sorted({one.id for one in opened.study.detectors} | set(tables.detectors()))
    return score_detectors(tables, settings, names, opened.study.name)


def _rows(folder: StudyFolder, table: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = read_results(folder.path, table).to_pylist()
    return rows


def _run(row: Mapping[str, Any]) -> str:
    return f"{row['block']}.{row['arm']}"


def _assign_splits(
    folder: StudyFolder, runs: Mapping[str, Mapping[str, Any]], acts: list[dict[str, Any]], families: frozenset[str],
    cities: frozenset[str],
) -> dict[str, str]:  # fmt: skip
    """The split of each block, by addressed chance: it depends on the block alone."""
    held = {row["block"] for row in acts if row["family"] in families}
    held |= {row["block"] for row in runs.values() if (row.get("city") or "") in cities}
    chance = Chance(folder.study.first_seed)
    found = {}
    for block in folder.blocks:
        u = chance.uniform4(_STREAM, hash64(block.name), 0)[0]
        drawn = (
            "train" if u < SHARES["train"] else "validation" if u < SHARES["train"] + SHARES["validation"] else "test"
        )
        found[block.name] = "test" if block.name in held else drawn
    return found


def _draw_split(chance: Chance, block: str) -> str:
    u, below = chance.uniform4(_STREAM, hash64(block), 0)[0], 0.0
    for split, share in SHARES.items():
        below += share
        if u < below:
            return split
    return "test"


def _effects(folder: StudyFolder) -> dict[tuple[str, str], float]:
    """When each aircraft of a run departed from the baseline."""
    rows = _rows(folder, "effects")
    return {(_run(row), row["vehicle"]): row["departed_s"] for row in rows if row.get("departed_s") is not None}


def _effect_s(effects: Mapping[tuple[str, str], float], run: str, vehicle: str, first_s: float) -> float:
    """The first effect of an attack, on its aircraft or on any; NaN for none. One before the attack is not its own."""
    times = [at for (of, who), at in effects.items() if of == run and (not vehicle or who == vehicle) and at >= first_s]
    return min(times, default=math.nan)
