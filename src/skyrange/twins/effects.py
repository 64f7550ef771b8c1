"""Effects on each aircraft: outcomes that are compared between arms, and differences between a run and its twin.

An outcome is declared here, not found: after two trajectories have parted nearly everything about them differs. An
aircraft's outcome differs between two runs by a distance of zero or more. It counts as an effect if that distance is
beyond the largest that placebos make of it: the sham of all attacks, compared with the nominal run, over all seeds.

Of K placebos and one more, each is the largest as likely as another: without any effect, the limit is exceeded with a
probability of 1/(K + 1). An effect is shown if that is at most `PLACEBO_LEVEL`, which takes 19 placebos. Where all runs
repeat to the byte none is needed: two runs without the attack are the same, so what differs is due to it. That holds
as long as the shams themselves change no outcome; where they do, their number counts as well.
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
from skyrange.record.schema import NAME, Column, arrow_schema

PLACEBO_LEVEL: Final = 0.05
"""The largest probability with which a difference that is no effect may exceed its limit."""
ENOUGH_PLACEBOS: Final = math.ceil(1.0 / PLACEBO_LEVEL) - 1
"""Placebos from which a limit has this level: the largest of K is exceeded in 1 of K + 1 cases."""
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
        counts: dict[str, dict[str, int]] = {one.vehicle: {} for one in self.measured}
        for row in read_notes(self.record, "decisions"):
            own = counts.get(row.about.split(".", 1)[0])
            if own is not None:
                own[row.kind] = own.get(row.kind, 0) + 1
        return list(counts.values())


def distances(a: ArmOutcomes, b: ArmOutcomes) -> dict[str, Floats]:
    """(n,) by outcome: the distance between two runs, NaN where an aircraft does not have that outcome in both."""
    pairs = list(zip(a.measured, b.measured, strict=True))
    return {
        "departure": departures(a.ticks, b.ticks)[0],
        "delay": _between(
            [one.landed_s if one.outcome == "complete" else None for one in a.measured],
            [one.landed_s if one.outcome == "complete" else None for one in b.measured],
        ),
        "separation": _between(
            [_capped(one.min_separation_m) for one in a.measured], [_capped(one.min_separation_m) for one in b.measured]
        ),
        "mission": np.array([float(one.outcome != other.outcome) for one, other in pairs]),
        "mishaps": np.array(
            [abs(one.near_misses - other.near_misses) + abs(one.collisions - other.collisions) for one, other in pairs],
            dtype=np.float64,
        ),
        "energy": _between([one.energy_j for one in a.measured], [one.energy_j for one in b.measured]),
        "decisions": np.array(
            [
                float(sum(abs(mine.get(kind, 0) - other.get(kind, 0)) for kind in {*mine, *other}))
                for mine, other in zip(a.decisions, b.decisions, strict=True)
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
    energy_j = np.array([ENERGY_SHARE * (one.energy_j or 0.0) for one in baseline.measured])
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


def _between(mine: Sequence[float | None], others: Sequence[float | None]) -> Floats:
    values = [[np.nan if one is None else one for one in row] for row in (mine, others)]
    found: Floats = np.abs(np.array(values[0], dtype=np.float64) - np.array(values[1], dtype=np.float64))
    return found


Floats = NDArray[np.float64]

_F64, _I64 = pa.float64(), pa.int64()

COLUMNS: Final[tuple[Column, ...]] = (
    Column("seed", _I64, "", "seed of both runs"),
    Column("against", NAME, "", "the twin with which it is compared: nominal or sham"),
    Column("vehicle", NAME, "", "operator/vehicle"),
    Column("outcome", NAME, "", "outcome of the mission in the attacked run: complete, failed or unfinished"),
    Column("outcome_twin", NAME, "", "the same in the twin"),
    Column(
        "landed_s", _F64, "s", "when it touched down to end the mission, in truth, in the attacked run", nullable=True
    ),
    Column("landed_twin_s", _F64, "s", "the same in the twin", nullable=True),
    Column(
        "delay_s",
        _F64,
        "s",
        "arrival delay: `landed_s` of attacked minus twin, if both missions are complete",
        nullable=True,
    ),
    Column(
        "finished_s",
        _F64,
        "s",
        "when the ground station reported the end of the mission, by the heartbeats that it gets, about one a second; "
        "in the attacked run",
        nullable=True,
    ),
    Column("finished_twin_s", _F64, "s", "the same in the twin, by its heartbeats", nullable=True),
    Column("distance_m", _F64, "m", "length of the path flown in the attacked run"),
    Column("distance_twin_m", _F64, "m", "the same in the twin"),
    Column("extra_distance_m", _F64, "m", "attacked minus twin"),
    Column("energy_j", _F64, "J", "energy drawn from the battery over the whole attacked run", nullable=True),
    Column("energy_twin_j", _F64, "J", "the same in the twin", nullable=True),
    Column("extra_energy_j", _F64, "J", "attacked minus twin", nullable=True),
    Column(
        "min_separation_m", _F64, "m", "least distance to another aircraft in the air, centre to centre", nullable=True
    ),
    Column("min_separation_twin_m", _F64, "m", "the same in the twin", nullable=True),
    Column("nearest", NAME, "", "the other aircraft of that least distance, in the attacked run", nullable=True),
    Column(
        "near_misses", _I64, "", "number of times that another aircraft came nearer than the limit, in the attacked run"
    ),
    Column("near_misses_twin", _I64, "", "the same in the twin"),
    Column("collisions", _I64, "", "collisions with aircraft and buildings in the attacked run"),
    Column("collisions_twin", _I64, "", "the same in the twin"),
    Column(
        "min_wall_m", _F64, "m", "least distance to a building in the attacked run; null beyond 30 m", nullable=True
    ),
    Column("min_wall_twin_m", _F64, "m", "the same in the twin", nullable=True),
    Column("departure_m", _F64, "m", "largest distance from its position in the twin at the same time"),
    Column("departed_s", _F64, "s", "when that distance first exceeded the threshold; null for never", nullable=True),
    Column("attacks", pa.list_(pa.string()), "", "ids of the attacks that caused the effect; empty if none did"),
    Column("faults", pa.list_(pa.string()), "", "ids of the benign faults that caused the effect; empty if none did"),
    Column(
        "attribution",
        NAME,
        "",
        "how: necessary, sufficient, both, joint or redundant; none for an effect without an author, unknown where the "
        "arms were not run; null without an effect",
        nullable=True,
    ),
)
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
