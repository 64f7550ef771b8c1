"""Outcomes of aircraft that are compared between arms, and the difference that counts as an effect.

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
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.metrics.aircraft_measures import Measured, Ticks, departures, measure, read_ticks
from skyrange.metrics.separation import WALLS_M
from skyrange.metrics.time_series import read_notes
from skyrange.record.read.run import RunRecord

Floats = NDArray[np.float64]

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
