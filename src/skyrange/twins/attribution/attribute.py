"""Attribution: for every effect on every aircraft, how each attack and each fault relates to it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.metrics.flight_identity import repeats_to_the_byte
from skyrange.record.schema import NAME, Column, arrow_schema
from skyrange.twins.attribution.arms import NOMINAL, SHAM, Arm
from skyrange.twins.attribution.outcomes import (
    NAMES,
    PLACEBO_LEVEL,
    ArmOutcomes,
    Limits,
    distances,
    floors,
    limits,
    onsets_ns,
)
from skyrange.twins.attribution.relations import Attacks, Relation, relations

Floats = NDArray[np.float64]

COLUMNS: Final[tuple[Column, ...]] = (
    Column("seed", pa.int64(), "", "seed of the runs"),
    Column("vehicle", NAME, "", "operator/vehicle"),
    Column("outcome", NAME, "", "the declared outcome that the attacks changed"),
    Column("attack", NAME, "", "the id of the attack, or of the fault where `fault` is true"),
    Column("fault", pa.bool_(), "", "whether `attack` is the id of a benign fault"),
    Column("relation", NAME, "", "both, necessary, sufficient, joint, redundant, none or unknown"),
    Column("shift", NAME, "", "advanced or delayed: the departure begins earlier or later with the attack", True),
    Column("shift_s", pa.float64(), "s", "departure with all attacks minus departure without this one", True),
    Column("difference", pa.float64(), "", "distance of the outcome from the baseline when all attacks act"),
    Column("departed_s", pa.float64(), "s", "of a departure: when it exceeded the limit", True),
    Column("limit", pa.float64(), "", "the distance beyond which it is an effect"),
    Column("placebos", pa.int32(), "", "number of placebos from which the limit is known"),
    Column("level", pa.float64(), "", "probability with which a difference that is no effect exceeds the limit"),
    Column("shown", pa.bool_(), "", "whether that is at most 0.05; else there are not enough placebos"),
    Column("alone", pa.float64(), "", "the distance when only this attack acts; null if that was not run", True),
    Column("without", pa.float64(), "", "the distance when all but this attack act; null if that was not run", True),
)
"""Columns of `attribution.parquet`: one row per seed, aircraft, effect and attack."""


@dataclass(frozen=True, slots=True)
class Authors:
    """Who is to be named for an aircraft's effect: the summary that stands in `effects.parquet`."""

    attacks: tuple[str, ...]
    """The attacks and faults that relate to it, in order of their names; none for an effect without an author."""
    attribution: Relation | Literal["not enough placebos"]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Runs of one seed compared with its baseline: by set of acting attacks, what differs and since when."""

    seed: int
    fleet: Sequence[str]
    away: Mapping[Attacks, Mapping[str, Floats]]
    """By outcome (n,) distances from the baseline."""
    departed_ns: Mapping[Attacks, Sequence[int | None]]
    """(n,) when each aircraft departed from the baseline."""
    limits: Limits
    """The largest distances that are no effects."""


def attribute(
    outcomes_of: Callable[[str, int], ArmOutcomes],
    seeds: Sequence[int],
    arms: Sequence[Arm],
    baseline: str | None,
    threshold_m: float,
    faults: Collection[str] = (),
) -> list[dict[str, Any]]:
    """The rows of `attribution.parquet`; `faults` are the ids that name benign faults.

    `outcomes_of` gives the outcomes of an arm, by name, and a seed; only those of two runs are held at a time.
    `baseline` names the arm with all attacks in their counterfactual states. Without one every relation is unknown, and
    distances are from the nominal run.
    """
    names = {arm.name for arm in arms}
    placebos = (
        [distances(outcomes_of(SHAM, seed), outcomes_of(NOMINAL, seed)) for seed in seeds]
        if {SHAM, NOMINAL} <= names
        else []
    )
    rows: list[dict[str, Any]] = []
    for seed in seeds:
        reference = outcomes_of(baseline or NOMINAL, seed)
        found_limits = limits(
            placebos, floors(reference, threshold_m), repeats=repeats_to_the_byte(reference.record.manifest)
        )
        away: dict[Attacks, Mapping[str, Floats]] = {}
        departed_ns: dict[Attacks, Sequence[int | None]] = {}
        for arm in arms:
            if arm.active:
                run = outcomes_of(arm.name, seed)
                away[arm.active] = distances(run, reference)
                departed_ns[arm.active] = onsets_ns(run, reference, found_limits.of["departure"])
        fleet = [one.vehicle for one in reference.measured]
        found = relate(Comparison(seed, fleet, away, departed_ns, found_limits), baseline is not None)
        rows += [row | {"fault": row["attack"] in faults} for row in found]
    return rows


def authors(rows: Sequence[Mapping[str, Any]]) -> dict[tuple[int, str], Authors]:
    """By seed and aircraft, the authors of its first effect in the order of `NAMES`, which is its departure if any."""
    first: dict[tuple[int, str], str] = {}
    for row in rows:
        key = (row["seed"], row["vehicle"])
        if key not in first or NAMES.index(row["outcome"]) < NAMES.index(first[key]):
            first[key] = row["outcome"]
    grouped: dict[tuple[int, str], dict[str, Relation]] = {}
    for row in rows:
        key = (row["seed"], row["vehicle"])
        if row["outcome"] == first[key]:
            grouped.setdefault(key, {})[row["attack"]] = row["relation"]
    undecided = {
        (row["seed"], row["vehicle"])
        for row in rows
        if row["outcome"] == first[row["seed"], row["vehicle"]] and not row["shown"]
    }
    return {
        key: Authors((), "not enough placebos") if key in undecided else summarise(found)
        for key, found in grouped.items()
    }


def departures_by_author(rows: Sequence[Mapping[str, Any]], seed: int) -> dict[str, dict[str, int]]:
    """By vehicle and attack that relates to its departure, when the vehicle departed, in ns."""
    found: dict[str, dict[str, int]] = {}
    for row in rows:
        named = row["relation"] not in ("none", "unknown")
        if row["seed"] == seed and row["outcome"] == "departure" and named:
            found.setdefault(row["vehicle"], {})[row["attack"]] = round(row["departed_s"] * NS_PER_S)
    return found


def with_authors(
    row: Mapping[str, Any], named: Mapping[tuple[int, str], Authors], faults: Collection[str] = ()
) -> dict[str, Any]:
    """A row of `effects.parquet` with the authors of its aircraft's effect, attacks and `faults` apart.

    A departure from the twin that is no effect, because placebos depart as far, is attributed to nothing: `none`.
    """
    found = named.get((row["seed"], row["vehicle"]))
    if found is None:
        return {**row, "attacks": [], "faults": [], "attribution": None if row["departed_s"] is None else "none"}
    return {
        **row,
        "attacks": [author for author in found.attacks if author not in faults],
        "faults": [author for author in found.attacks if author in faults],
        "attribution": found.attribution,
    }


def unknown_subsets(active: Mapping[str, Sequence[str]]) -> int:
    """The number of subsets of the attacks that were not run. `active` are the acting attacks by name of the arm."""
    run: set[frozenset[str]] = {frozenset(attacks) for attacks in active.values()} | {frozenset()}
    return int(2 ** max(map(len, run)) - len(run))


def summarise(found: Mapping[str, Relation]) -> Authors:
    """One word for the relations of all attacks to one effect.

    One attack gives its own relation. Several give `redundant` if each of them is, otherwise `joint`; `unknown` if that
    is all that is known.
    """
    named = {attack: relation for attack, relation in sorted(found.items()) if relation not in ("none", "unknown")}
    if not named:
        return Authors((), "unknown" if "unknown" in found.values() else "none")
    kinds = set(named.values())
    if len(kinds) == 1 and (len(named) == 1 or kinds <= {"redundant", "joint"}):
        return Authors(tuple(named), kinds.pop())
    return Authors(tuple(named), "joint")


def attribution_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as the table of `attribution.parquet`."""
    return pa.Table.from_pylist([dict(row) for row in rows], schema=arrow_schema("attribution", COLUMNS))


def relate(found: Comparison, has_baseline: bool) -> list[dict[str, Any]]:
    """The rows of one seed: those of every outcome that differs by more than its limit when all attacks act.

    Where the placebos are too few to call that an effect, every relation is unknown.
    """
    everyone = max(found.away, key=len)
    rows = []
    for k, vehicle in enumerate(found.fleet):
        for outcome in NAMES:
            difference, limit = found.away[everyone][outcome][k], found.limits.of[outcome][k]
            if not difference > limit:  # NaN is no effect
                continue
            departed_ns = found.departed_ns[everyone][k] if outcome == "departure" else None
            held = {active: bool(away[outcome][k] > limit) for active, away in found.away.items()}
            level = float(found.limits.levels[outcome][k])
            related: Mapping[str, Relation] = dict.fromkeys(everyone, "unknown")
            if has_baseline and level <= PLACEBO_LEVEL:
                related = relations(held)
            for attack in sorted(everyone):
                without = everyone - {attack}
                shift_s = _shift_s(found, without, k) if outcome == "departure" else None
                rows.append(
                    {
                        "seed": found.seed,
                        "vehicle": vehicle,
                        "outcome": outcome,
                        "attack": attack,
                        "relation": related[attack],
                        "shift": None if not shift_s else "advanced" if shift_s < 0.0 else "delayed",
                        "shift_s": shift_s,
                        "difference": float(difference),
                        "departed_s": None if departed_ns is None else departed_ns / NS_PER_S,
                        "limit": float(limit),
                        "placebos": int(found.limits.placebos[outcome][k]),
                        "level": level,
                        "shown": level <= PLACEBO_LEVEL,
                        "alone": _value(found.away, frozenset({attack}), outcome, k),
                        "without": _value(found.away, without, outcome, k) if without or not has_baseline else 0.0,
                    }
                )
    return rows


def _shift_s(found: Comparison, without: Attacks, k: int) -> float | None:
    """Departure with all attacks minus departure without one of them; `None` where either is not known."""
    with_it = found.departed_ns[max(found.away, key=len)][k]
    without_it = found.departed_ns[without][k] if without in found.departed_ns else None
    return None if with_it is None or without_it is None else (with_it - without_it) / NS_PER_S


def _value(away: Mapping[Attacks, Mapping[str, Floats]], active: Attacks, outcome: str, k: int) -> float | None:
    found = away.get(active)
    return None if found is None or np.isnan(found[outcome][k]) else float(found[outcome][k])
