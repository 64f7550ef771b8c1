"""Attribution: for every effect on every aircraft, how each attack and each fault relates to it.

The question is always the same: is the effect there if exactly these attacks act, and all others are replaced by their
counterfactuals? The definitions are those of component causes: a set of attacks is *sufficient* if the effect is there
when exactly these act, and *minimal* if no smaller part of it is (Rothman, "Causes", Am. J. Epidemiology 104 (1976)
587-592). Sets that were not run are filled in where a monotone effect leaves no choice: one that is there with some
attacks is there with more, one that is absent is absent with fewer. Other sets stay unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.metrics.exact_difference import repeats_to_the_byte
from skyrange.record.schema import arrow_schema
from skyrange.twins.arms import NOMINAL, SHAM, Arm
from skyrange.twins.columns import PAIR_TABLES
from skyrange.twins.effects import (
    NAMES,
    PLACEBO_LEVEL,
    ArmOutcomes,
    Limits,
    distances,
    floors,
    limits,
    onsets_ns,
)

Attacks = frozenset[str]
Relation = Literal["both", "necessary", "sufficient", "joint", "redundant", "none", "unknown"]
"""How one attack relates to an effect that is there when all attacks act:

- `both`: necessary and sufficient. The effect is there with it alone and gone without it.
- `joint`: the effect needs it, and needs others with it; all that the effect needs are joint.
- `necessary`: the effect is gone without it; beside it one or another suffices, or the runs do not tell what it needs.
- `sufficient`: the effect is there with it alone; it was not left out.
- `redundant`: it is part of a minimal set, and without it another set suffices.
- `none`: it is part of no minimal set.
- `unknown`: the runs do not tell.
"""


def relations(present: Mapping[Attacks, bool]) -> dict[str, Relation]:
    """The relation of every attack to one effect.

    `present` says for each set of attacks that was run whether the effect is there; the largest set holds all attacks.
    In the empty set, the baseline, the effect is absent by definition. Raises `ValueError` if the effect is not there
    when all act: then there is nothing to attribute.
    """
    everyone = max(present, key=len)
    if not present[everyone]:
        raise ValueError("the effect is not there when all attacks act")
    known = complete(present)
    minimal = _minimal_sets(known)
    all_known = len(known) == 2 ** len(everyone)
    relation_of: dict[str, Relation] = {}
    for attack in sorted(everyone):
        alone, without = known.get(frozenset({attack})), known.get(everyone - {attack})
        if alone:
            relation_of[attack] = "both" if without is False else "sufficient" if without is None else "redundant"
        elif without is False:
            joint = alone is False and all_known and len(minimal) == 1 and attack in minimal[0]
            relation_of[attack] = "joint" if joint else "necessary"
        elif all_known:
            relation_of[attack] = "redundant" if any(attack in active for active in minimal) else "none"
        else:
            relation_of[attack] = "unknown"
    return relation_of


def complete(present: Mapping[Attacks, bool]) -> dict[Attacks, bool]:
    """`present` with the empty set and every set that a monotone effect determines; what was run keeps its value."""
    known = {**present, frozenset(): False}
    with_effect = [active for active, has_effect in known.items() if has_effect]
    without_effect = [active for active, has_effect in known.items() if not has_effect]
    for active in subsets(max(present, key=len)):
        if active not in known:
            with_fewer, with_more = (
                any(other <= active for other in with_effect),
                any(active <= other for other in without_effect),
            )
            if with_fewer != with_more:  # both only where what was run is not monotone: then nothing is determined
                known[active] = with_fewer
    return known


def subsets(attacks: Attacks) -> Iterator[Attacks]:
    """All subsets, the smallest first, in the order of their names."""
    for size in range(len(attacks) + 1):
        yield from map(frozenset, combinations(sorted(attacks), size))


def _minimal_sets(known: Mapping[Attacks, bool]) -> list[Attacks]:
    """The sets with the effect of which no smaller part has it."""
    with_effect = [active for active, has_effect in known.items() if has_effect]
    return [active for active in with_effect if not any(other < active for other in with_effect)]


Floats = NDArray[np.float64]

COLUMNS: Final = PAIR_TABLES["attribution"]
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
        fleet = [outcomes.vehicle for outcomes in reference.measured]
        related = relate(Comparison(seed, fleet, away, departed_ns, found_limits), has_baseline=baseline is not None)
        rows += [row | {"fault": row["attack"] in faults} for row in related]
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
        key: Authors((), "not enough placebos") if key in undecided else summarise(relation_of)
        for key, relation_of in grouped.items()
    }


def departures_by_author(rows: Sequence[Mapping[str, Any]], seed: int) -> dict[str, dict[str, int]]:
    """By vehicle and attack that relates to its departure, when the vehicle departed, in ns."""
    departures: dict[str, dict[str, int]] = {}
    for row in rows:
        named = row["relation"] not in ("none", "unknown")
        if row["seed"] == seed and row["outcome"] == "departure" and named:
            departures.setdefault(row["vehicle"], {})[row["attack"]] = round(row["departed_s"] * NS_PER_S)
    return departures


def with_authors(
    row: Mapping[str, Any], named: Mapping[tuple[int, str], Authors], faults: Collection[str] = ()
) -> dict[str, Any]:
    """A row of `effects.parquet` with the authors of its aircraft's effect, attacks and `faults` apart.

    A departure from the twin that is no effect, because placebos depart as far, is attributed to nothing: `none`.
    """
    by_whom = named.get((row["seed"], row["vehicle"]))
    if by_whom is None:
        return {**row, "attacks": [], "faults": [], "attribution": None if row["departed_s"] is None else "none"}
    return {
        **row,
        "attacks": [author for author in by_whom.attacks if author not in faults],
        "faults": [author for author in by_whom.attacks if author in faults],
        "attribution": by_whom.attribution,
    }


def unknown_subsets(active: Mapping[str, Sequence[str]]) -> int:
    """The number of subsets of the attacks that were not run. `active` are the acting attacks by name of the arm."""
    run: set[frozenset[str]] = {frozenset(attacks) for attacks in active.values()} | {frozenset()}
    return int(2 ** max(map(len, run)) - len(run))


def summarise(relation_of: Mapping[str, Relation]) -> Authors:
    """One word for the relations of all attacks to one effect.

    One attack gives its own relation. Several give `redundant` if each of them is, otherwise `joint`; `unknown` if that
    is all that is known.
    """
    named = {
        attack: relation for attack, relation in sorted(relation_of.items()) if relation not in ("none", "unknown")
    }
    if not named:
        return Authors((), "unknown" if "unknown" in relation_of.values() else "none")
    kinds = set(named.values())
    if len(kinds) == 1 and (len(named) == 1 or kinds <= {"redundant", "joint"}):
        return Authors(tuple(named), kinds.pop())
    return Authors(tuple(named), "joint")


def attribution_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as the table of `attribution.parquet`."""
    return pa.Table.from_pylist([dict(row) for row in rows], schema=arrow_schema("attribution", COLUMNS))


def relate(comparison: Comparison, *, has_baseline: bool) -> list[dict[str, Any]]:
    """The rows of one seed: those of every outcome that differs by more than its limit when all attacks act.

    Where the placebos are too few to call that an effect, every relation is unknown.
    """
    everyone = max(comparison.away, key=len)
    rows = []
    for k, vehicle in enumerate(comparison.fleet):
        for outcome in NAMES:
            difference, limit = comparison.away[everyone][outcome][k], comparison.limits.of[outcome][k]
            if not difference > limit:  # NaN is no effect
                continue
            departed_ns = comparison.departed_ns[everyone][k] if outcome == "departure" else None
            present = {active: bool(away[outcome][k] > limit) for active, away in comparison.away.items()}
            level = float(comparison.limits.levels[outcome][k])
            related: Mapping[str, Relation] = dict.fromkeys(everyone, "unknown")
            if has_baseline and level <= PLACEBO_LEVEL:
                related = relations(present)
            for attack in sorted(everyone):
                without = everyone - {attack}
                shift_s = _shift_s(comparison, without, k) if outcome == "departure" else None
                rows.append(
                    {
                        "seed": comparison.seed,
                        "vehicle": vehicle,
                        "outcome": outcome,
                        "attack": attack,
                        "relation": related[attack],
                        "shift": None if not shift_s else "advanced" if shift_s < 0.0 else "delayed",
                        "shift_s": shift_s,
                        "difference": float(difference),
                        "departed_s": None if departed_ns is None else departed_ns / NS_PER_S,
                        "limit": float(limit),
                        "placebos": int(comparison.limits.placebos[outcome][k]),
                        "level": level,
                        "shown": level <= PLACEBO_LEVEL,
                        "alone": _value(comparison.away, frozenset({attack}), outcome, k),
                        "without": _value(comparison.away, without, outcome, k) if without or not has_baseline else 0.0,
                    }
                )
    return rows


def _shift_s(comparison: Comparison, without: Attacks, k: int) -> float | None:
    """Departure with all attacks minus departure without one of them; `None` where either is not known."""
    with_it = comparison.departed_ns[max(comparison.away, key=len)][k]
    without_it = comparison.departed_ns[without][k] if without in comparison.departed_ns else None
    return None if with_it is None or without_it is None else (with_it - without_it) / NS_PER_S


def _value(away: Mapping[Attacks, Mapping[str, Floats]], active: Attacks, outcome: str, k: int) -> float | None:
    distances = away.get(active)
    return None if distances is None or np.isnan(distances[outcome][k]) else float(distances[outcome][k])
