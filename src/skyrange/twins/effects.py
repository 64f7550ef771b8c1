"""Effects on each aircraft: outcomes that are compared between arms, and differences between a run and its twin.

An outcome is declared here, not found: after two trajectories have parted nearly everything about them differs. An
aircraft's outcome differs between two runs by a distance of zero or more. It counts as an effect if that distance is
beyond the largest that placebos make of it: the sham of all attacks, compared with the nominal run, over all seeds.

Of K placebos and one more, each is the largest as likely as another: without any effect, the limit is exceeded with a
probability of 1/(K + 1). An effect is shown if that is at most `PLACEBO_LEVEL`, which takes 19 placebos; a claim takes
`CLAIM_PLACEBOS`, because each aircraft has a limit for each outcome. Where all runs repeat to the byte none is needed:
two runs without the attack are the same, so what differs is due to it. That holds as long as the shams themselves
change no outcome; where they do, their number counts as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.metrics.aircraft import Measured, Ticks, departures, measure, read_ticks
from skyrange.metrics.safety import WALLS_M
from skyrange.metrics.time_series import read_notes
from skyrange.record.read.run import RunRecord
from skyrange.record.schema import arrow_schema
from skyrange.twins.columns import PAIR_TABLES

PLACEBO_LEVEL: Final = 0.05
"""The largest probability with which a difference that is no effect may exceed its limit."""
ENOUGH_PLACEBOS: Final = math.ceil(1.0 / PLACEBO_LEVEL) - 1
"""Placebos from which a limit has this level: the largest of K is exceeded in 1 of K + 1 cases."""
CLAIM_PLACEBOS: Final = 300
"""Placebos on which a claim rests: a difference that is no effect exceeds the largest of them in 1 of 301 cases. With
fewer, a run of many aircraft and outcomes has differences beyond a limit by chance.
"""
SEPARATION_M: Final = WALLS_M
"""Separations above this count as equal: aircraft that are far apart anyway have no effect on each other's safety."""
ENERGY_SHARE: Final = 0.01
"""An energy differs if it does so by more than this share of the baseline's."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One declared outcome."""

    name: str
    unit: str
    about: str


OUTCOMES: Final = (
    Outcome("departure", "m", "largest distance from the aircraft's position in the other run at the same time"),
    Outcome("delay", "s", "difference between the touchdowns that end the missions, where both are complete"),
    Outcome(
        "separation",
        "m",
        "difference between the least distances to another aircraft in the air, up to `SEPARATION_M`",
    ),
    Outcome("mission", "", "1 where the outcomes of the mission differ, otherwise 0"),
    Outcome("mishaps", "", "difference between the numbers of near misses and collisions"),
    Outcome("energy", "J", "difference between the energies drawn from the battery"),
    Outcome("decisions", "", "decisions of any kind that were made more or fewer times, in total"),
)
"""The outcomes in the order in which they are reported."""
NAMES: Final = tuple(outcome.name for outcome in OUTCOMES)


@dataclass(frozen=True)
class ArmOutcomes:
    """The outcomes of all aircraft in one run, in the manifest's order."""

    record: RunRecord
    measured: Sequence[Measured]
    """The measures of each aircraft. They take long and little memory, the positions the opposite."""

    @classmethod
    def read(cls, record: RunRecord, near_m: float) -> ArmOutcomes:
        """Measure a run."""
        return cls(record, measure(record, read_ticks(record), near_m))

    @cached_property
    def ticks(self) -> Ticks:
        """The true positions."""
        return read_ticks(self.record)

    @cached_property
    def decisions(self) -> list[dict[str, int]]:
        """How often each kind of decision was made about each aircraft."""
        counts: dict[str, dict[str, int]] = {aircraft.vehicle: {} for aircraft in self.measured}
        for row in read_notes(self.record, "decisions"):
            vehicle_counts = counts.get(row.about.split(".", 1)[0])
            if vehicle_counts is not None:
                vehicle_counts[row.kind] = vehicle_counts.get(row.kind, 0) + 1
        return list(counts.values())


def distances(a: ArmOutcomes, b: ArmOutcomes) -> dict[str, Floats]:
    """(n,) by outcome: the distance between two runs, NaN where an aircraft does not have that outcome in both."""
    pairs = list(zip(a.measured, b.measured, strict=True))
    return {
        "departure": departures(a.ticks, b.ticks)[0],
        "delay": _between(
            [aircraft.landed_s if aircraft.outcome == "complete" else None for aircraft in a.measured],
            [aircraft.landed_s if aircraft.outcome == "complete" else None for aircraft in b.measured],
        ),
        "separation": _between(
            [_capped(aircraft.min_separation_m) for aircraft in a.measured],
            [_capped(aircraft.min_separation_m) for aircraft in b.measured],
        ),
        "mission": np.array([float(first.outcome != second.outcome) for first, second in pairs]),
        "mishaps": np.array(
            [
                abs(first.near_misses - second.near_misses) + abs(first.collisions - second.collisions)
                for first, second in pairs
            ],
            dtype=np.float64,
        ),
        "energy": _between(
            [aircraft.energy_j for aircraft in a.measured], [aircraft.energy_j for aircraft in b.measured]
        ),
        "decisions": np.array(
            [
                float(sum(abs(first.get(kind, 0) - second.get(kind, 0)) for kind in {*first, *second}))
                for first, second in zip(a.decisions, b.decisions, strict=True)
            ]
        ),
    }


def onsets_ns(a: ArmOutcomes, b: ArmOutcomes, limits_m: Floats) -> list[int | None]:
    """When each aircraft was first farther than its limit from its position in the other run; `None` for never."""
    first = departures(a.ticks, b.ticks, limits_m)[1]
    return [None if at_ns < 0 else int(at_ns) for at_ns in first]


def floors(baseline: ArmOutcomes, threshold_m: float) -> dict[str, Floats]:
    """(n,) by outcome: the least difference that counts, whatever the placebos say.

    For `departure` and `separation` the pair's `threshold_m`; for `delay` the period of the recorded truth; for
    `energy` `ENERGY_SHARE`; counts may not differ at all.
    """
    count = len(baseline.measured)
    period_s = float(np.diff(baseline.ticks.time_ns[:2]).sum()) / NS_PER_S
    energy_j = np.array([ENERGY_SHARE * (aircraft.energy_j or 0.0) for aircraft in baseline.measured])
    given = {"departure": threshold_m, "separation": threshold_m, "delay": period_s}
    return {name: np.full(count, given.get(name, 0.0)) for name in NAMES} | {"energy": energy_j}


class Limits(NamedTuple):
    """The largest differences that are no effects, of the n aircraft of a run."""

    of: Mapping[str, Floats]
    """(n,) by outcome."""
    placebos: Mapping[str, NDArray[np.int64]]
    """(n,) by outcome, number of placebos that have that outcome."""
    levels: Mapping[str, Floats]
    """(n,) by outcome, the probability with which a difference that is no effect exceeds the limit."""


def limits(placebos: Sequence[Mapping[str, Floats]], floor: Mapping[str, Floats], *, repeats: bool) -> Limits:
    """The limits of each outcome: the least difference that counts, or the largest that a placebo makes.

    `placebos` has, for each seed, the distances between the sham and the nominal run, NaN where an aircraft does not
    have the outcome in both. `repeats` says whether all runs repeat to the byte.
    """
    of, counts, levels = {}, {}, {}
    for name, least in floor.items():
        samples = np.array([placebo[name] for placebo in placebos]).reshape(len(placebos), len(least))
        known = ~np.isnan(samples)
        highest = np.where(known, samples, 0.0).max(axis=0, initial=0.0)
        counts[name] = known.sum(axis=0).astype(np.int64)
        levels[name] = np.where(repeats & (highest <= least), 0.0, 1.0 / (counts[name] + 1.0))
        of[name] = np.maximum(least, highest)
    return Limits(of, counts, levels)


def _capped(separation_m: float | None) -> float | None:
    return None if separation_m is None else min(separation_m, SEPARATION_M)


def _between(first: Sequence[float | None], second: Sequence[float | None]) -> Floats:
    values = [[np.nan if value is None else value for value in row] for row in (first, second)]
    differences: Floats = np.abs(np.array(values[0], dtype=np.float64) - np.array(values[1], dtype=np.float64))
    return differences


Floats = NDArray[np.float64]

COLUMNS: Final = PAIR_TABLES["effects"]
"""The columns of `effects.parquet`, which has a row per seed, twin and aircraft."""

MEASURES: Final = ("delay_s", "extra_distance_m", "extra_energy_j", "departure_m")
"""Columns whose values are averaged over seeds."""
CHANGES: Final = ("near_misses", "collisions", "min_separation_m", "min_wall_m")
"""Columns whose differences from the twin are averaged over seeds."""


def effect_rows(
    seed: int, against: str, attacked: ArmOutcomes, twin: ArmOutcomes, threshold_m: float
) -> list[dict[str, Any]]:
    """The rows of one pair of runs; their authors are filled in by `attribute.with_authors`."""
    rows = []
    away_m, first_ns = departures(attacked.ticks, twin.ticks, threshold_m)
    for k, (a, b) in enumerate(zip(attacked.measured, twin.measured, strict=True)):
        done = a.outcome == b.outcome == "complete" and a.landed_s is not None and b.landed_s is not None
        row: dict[str, Any] = {"seed": seed, "against": against, "vehicle": a.vehicle, "nearest": a.nearest}
        for name in ("outcome", "near_misses", "collisions"):
            row[name], row[f"{name}_twin"] = getattr(a, name), getattr(b, name)
        for name in ("landed_s", "finished_s", "distance_m", "energy_j", "min_separation_m", "min_wall_m"):
            stem, unit = name.rsplit("_", 1)
            row[name], row[f"{stem}_twin_{unit}"] = getattr(a, name), getattr(b, name)
        row["delay_s"] = round((a.landed_s or 0.0) - (b.landed_s or 0.0), 9) if done else None
        row["extra_distance_m"] = a.distance_m - b.distance_m
        known = a.energy_j is not None and b.energy_j is not None
        row["extra_energy_j"] = (a.energy_j or 0.0) - (b.energy_j or 0.0) if known else None
        row["departure_m"] = float(away_m[k])
        row["departed_s"] = float(first_ns[k]) / NS_PER_S if first_ns[k] >= 0 else None
        rows.append(row)
    return rows


def effects_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as the table of `effects.parquet`."""
    return pa.Table.from_pylist([dict(row) for row in rows], schema=arrow_schema("effects", COLUMNS))
