"""Measures of a cell: effect, alarms and cost, read from the pair of its row and column."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.metrics.aircraft import Measured, measure_departures, measure_growth, measure_straying
from skyrange.metrics.exact_difference import identify_flight
from skyrange.metrics.links import link_statistics, measure_transit_ms
from skyrange.metrics.safety import NEAR_M
from skyrange.metrics.time_series import read_notes
from skyrange.record.read.run import RunRecord
from skyrange.scoring.matching import count_episodes
from skyrange.scoring.result_file import ScoreSettings
from skyrange.statistics.means import Interval, estimate_mean
from skyrange.twins.arms import ATTACKED, HONEST, NOMINAL
from skyrange.twins.effects import ArmOutcomes
from skyrange.twins.pair_folder import Pair

_STARTS: Final = ("event.attack_start", "event.fault_start")
_STOPS: Final = ("event.attack_stop", "event.fault_stop")
EPISODE_S: Final = ScoreSettings().episode_s
"""Alerts about an aircraft within so many seconds are one alarm, as in scores."""
_S_PER_H: Final = 3600.0


@dataclass(frozen=True, slots=True)
class Nominal:
    """What one nominal run is compared by: touchdowns that ended missions, energy, frames sent, and their delays."""

    landed_s: Sequence[float | None]
    energy_j: Sequence[float | None]
    complete: Sequence[bool]
    """Whether the mission of each aircraft is complete."""
    flight: str
    """Runs with the same are one flight."""
    frames: int
    transit_ms: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Median and 95th percentile of the delay of frames, by role of link."""


@dataclass(frozen=True, slots=True)
class Cell:
    """The measures of one cell, by seed where they are lists; a cell that was not run says why in `refused`."""

    row: str
    column: str
    failed: Sequence[str] = ()
    """Missions that failed in its nominal and sham runs (`study.failed_missions`)."""
    fault: bool = False
    """Whether the row has benign faults and no attack."""
    assumed: bool = False
    """Whether an attack of the row acts on a sensor whose reaction is assumed, as its kind says."""
    folder: str = ""
    refused: str = ""
    """Why the defence cannot be declared in the row's scenario; "" if it can."""
    effects: Sequence[float] = ()
    """The row's measure, of the aircraft that is affected most."""
    complete: Sequence[bool] = ()
    """Whether every mission that is complete in the baseline is complete."""
    growth_m_per_min: Sequence[float | None] = ()
    """How fast the effect still grew at the end of the attack (`measure_growth`); `None` where it is no distance, or
    the attack is too short.
    """
    alarms_s: Sequence[float | None] = ()
    """Time from the attack's start to the first alarm after it; `None` without one."""
    watched_s: Sequence[float] = ()
    """Time from the attack's start to the end of the run: an attack without an alarm was missed for as long."""
    false_alarms: Sequence[int] = ()
    """Alarms of the nominal run: episodes of alerts, as in scores."""
    flown_h: Sequence[float] = ()
    """Aircraft-hours of the nominal run, of each aircraft until its mission ends."""
    fault_alarms: Sequence[int] = ()
    """Alarms of the run with the fault, in a row without an attack: they are false too, and episodes."""
    nominal: Sequence[Nominal] = ()
    honest_alarms: Sequence[bool] = ()
    """Whether the honest arm, in which the aircraft is real, has an alarm; empty where no aircraft is claimed."""
    adaptive: tuple[Cell, ...] = ()
    """The same cell with each candidate of the adversaries who know the defence."""
    candidate: str = ""
    """What the adversary of an adaptive cell does."""
    idle: Sequence[str] = ()
    """Of an undefended cell: columns whose defences, present and muted, would have done nothing in any of its runs.

    Had they not been muted, every run would be the same, so their cells are not flown: they are this one.
    """
    quiet: Mapping[str, Sequence[tuple[str, int]]] = field(default_factory=dict)
    """Of an undefended cell: by column, the runs (arm and seed) in which its defences would have done nothing."""

    def idle_cell(self, column: str) -> Cell:
        """The cell of one of the `idle` columns."""
        return replace(self, column=column, failed=(), idle=(), quiet={})

    @property
    def effect(self) -> Interval | None:
        """Mean effect over the seeds."""
        return estimate_mean(self.effects)

    @property
    def best_adaptive(self) -> Cell | None:
        """What an adversary who knows the defence does best, this cell or a candidate; `None` if there is none.

        The adversary chooses by the first half of the seeds. The cell has the flights of the other half, because the
        largest of several means is larger than what it is the mean of. With one seed nothing is left to report on: then
        it is chosen and reported on the same.
        """
        flown = [one for one in self.adaptive if one.effects]
        if not flown:
            return None
        half = len(self.effects) // 2
        chosen = max([self, *flown], key=lambda one: math.fsum(one.effects[: half or None]))
        return chosen.since(half)

    def since(self, first: int) -> Cell:
        """The cell with what depends on the attack, of the seeds from the `first` on."""
        return replace(
            self,
            effects=self.effects[first:],
            complete=self.complete[first:],
            growth_m_per_min=self.growth_m_per_min[first:],
            alarms_s=self.alarms_s[first:],
            watched_s=self.watched_s[first:],
        )

    @property
    def alarm_s(self) -> float | None:
        """Mean time to an alarm over the seeds, of a missed attack the time for which it was; `None` without seeds."""
        told = [seen if at is None else at for at, seen in zip(self.alarms_s, self.watched_s, strict=True)]
        return math.fsum(told) / len(told) if told else None

    def data(self) -> dict[str, Any]:
        """As JSON data."""
        data = asdict(self)
        del data["quiet"]
        return data


def measure_cell(flown: Pair, cell: Cell, measure: str, detectors: Sequence[str]) -> Cell:
    """`cell` with the measures of its pair; `detectors` are the ids of its defences, none for the undefended one."""
    baseline = flown.baseline or NOMINAL
    effects: list[float] = []
    complete: list[bool] = []
    growth: list[float | None] = []
    alarms, watched, false_alarms, hours, nominal, fault_alarms = [], [], [], [], [], []
    rows = [one for one in flown.effects.to_pylist() if one["against"] == baseline]
    for seed in flown.seeds:
        own = [one for one in rows if one["seed"] == seed]
        attacked, twin = flown.run(ATTACKED, seed), flown.run(baseline, seed)
        end_ns = _end_ns(attacked)
        events = [(note.kind, note.time_ns) for note in read_notes(attacked, "events")]
        start_ns = min((at for kind, at in events if kind in _STARTS), default=end_ns)
        series = _SERIES[measure](attacked, twin) if measure in _SERIES else None
        stop_ns = max((at for kind, at in events if kind in _STOPS), default=end_ns)
        growth.append(None if series is None else measure_growth(series, start_ns, stop_ns))
        if measure == "strayed_m" and series is not None:
            effects.append(float(series.away_m.max(initial=0.0)))
        elif measure == "telemetry":
            effects.append(_missing_telemetry(attacked, twin))
        else:
            effects.append(max(_value(one, measure) for one in own))
        complete.append(all(one["outcome"] == "complete" for one in own if one["outcome_twin"] == "complete"))
        after = [at for at in alert_times_ns(attacked, detectors) if at >= start_ns]
        alarms.append((after[0] - start_ns) / NS_PER_S if after and not cell.fault else None)
        watched.append((end_ns - start_ns) / NS_PER_S)
        fault_alarms += [count_alarms(attacked, detectors)] if cell.fault else []
        if cell.candidate:
            continue  # what a defence costs does not depend on the attack
        quiet = flown.run(NOMINAL, seed)
        false_alarms.append(count_alarms(quiet, detectors))
        measured = ArmOutcomes.read(quiet, NEAR_M).measured
        nominal.append(_nominal(quiet, measured))
        hours.append(_flown_h(quiet, measured))
    honest: list[bool] = []
    if HONEST in flown.arms:
        honest = [bool(alert_times_ns(flown.run(HONEST, seed), detectors)) for seed in flown.seeds]
    return replace(
        cell,
        failed=tuple(map(str, flown.failed_missions)),
        effects=effects,
        complete=complete,
        growth_m_per_min=growth,
        alarms_s=alarms,
        watched_s=watched,
        false_alarms=false_alarms,
        flown_h=hours,
        fault_alarms=fault_alarms,
        nominal=nominal,
        honest_alarms=honest,
    )


def _value(row: dict[str, Any], measure: str) -> float:
    """The effect on one aircraft; energy counts as 0 where the world has no battery."""
    if measure == "mission":
        return float(row["outcome"] != row["outcome_twin"])
    if measure == "mishaps":
        more = row["near_misses"] - row["near_misses_twin"] + row["collisions"] - row["collisions_twin"]
        return float(max(more, 0))
    return abs(float(row[measure] or 0.0))


def _missing_telemetry(attacked: RunRecord, baseline: RunRecord) -> float:
    """Share of the frames that stations get on gcs links in the baseline and that are missing, in percent."""
    mine, other = (
        sum(one.delivered for one in link_statistics(run) if (one.kind, one.direction) == ("gcs", "rev"))
        for run in (attacked, baseline)
    )
    return 100.0 * max(other - mine, 0) / max(other, 1)


def alert_times_ns(run: RunRecord, detectors: Sequence[str]) -> list[int]:
    """When these detectors or defences raised alerts, in order."""
    return sorted(_alerts(run, detectors).column("time_ns").to_pylist())


def count_alarms(run: RunRecord, detectors: Sequence[str]) -> int:
    """The alarms of these detectors or defences: episodes of alerts about each aircraft."""
    table = _alerts(run, detectors)
    names, numbers = np.unique(table.column("subject").to_pylist(), return_inverse=True)
    times_ns = table.column("time_ns").to_numpy().astype(np.int64)
    order = np.lexsort((times_ns, numbers))
    return int(count_episodes(numbers[order], times_ns[order], from_seconds(EPISODE_S), len(names)).sum())


def _alerts(run: RunRecord, detectors: Sequence[str]) -> pa.Table:
    table = run.table("alerts", ["time_ns", "detector", "subject"])
    return table.filter(pc.is_in(table.column("detector"), value_set=pa.array(list(detectors), type=pa.string())))


def _end_ns(run: RunRecord) -> int:
    return int(pc.max(run.table("truth", ["time_ns"]).column("time_ns")).as_py())


def _flown_h(run: RunRecord, measured: Sequence[Measured]) -> float:
    """Aircraft-hours until the touchdown that ends the mission; of an aircraft that has none, until the mission is
    reported as ended, or else to the end of the run.
    """
    last_s = _end_ns(run) / NS_PER_S
    ends = [one.finished_s if one.landed_s is None else one.landed_s for one in measured]
    return sum(last_s if one is None else one for one in ends) / _S_PER_H


def _nominal(run: RunRecord, measured: Sequence[Measured]) -> Nominal:
    return Nominal(
        [one.landed_s for one in measured],
        [one.energy_j for one in measured],
        [one.outcome == "complete" for one in measured],
        identify_flight(run.manifest),
        run.table("frames", ["size"]).num_rows,
        measure_transit_ms(run),
    )


def added_delay_s(cell: Cell, without: Cell) -> list[float]:
    """How much later missions end by touchdown in the nominal runs with a defence, in s: the mean over aircraft, by
    seed; of a seed in which no aircraft touches down in both, NaN.
    """
    return _differences([one.landed_s for one in cell.nominal], [one.landed_s for one in without.nominal])


def added_energy_j(cell: Cell, without: Cell) -> list[float]:
    """How much more energy aircraft use in the nominal runs with a defence, in joules: as `added_delay_s`."""
    return _differences([one.energy_j for one in cell.nominal], [one.energy_j for one in without.nominal])


def broken_missions(cell: Cell, without: Cell) -> tuple[int, int]:
    """Missions of the nominal runs that are complete without the defence alone, and those that are without it."""
    pairs = [
        (mine, other)
        for one, two in zip(cell.nominal, without.nominal, strict=True)
        for mine, other in zip(one.complete, two.complete, strict=True)
    ]
    return sum(other and not mine for mine, other in pairs), sum(other for _, other in pairs)


def added_frames(cell: Cell, without: Cell) -> list[float]:
    """How many more frames are sent in the nominal runs with a defence, by seed."""
    return [float(a.frames - b.frames) for a, b in zip(cell.nominal, without.nominal, strict=True)]


def added_transit_ms(cell: Cell, without: Cell, roles: Sequence[str]) -> list[tuple[float, float]]:
    """How much median and 95th percentile of the delay of frames grow in the nominal runs with a defence, in ms.

    By seed, on links of those of `roles` that there are; of several, that whose 95th percentile grows most.
    """
    found = []
    for one, two in zip(cell.nominal, without.nominal, strict=True):
        mine, other = one.transit_ms, two.transit_ms
        grown = [
            (mine[role][1] - other[role][1], mine[role][0] - other[role][0])
            for role in roles
            if role in mine and role in other
        ]
        if grown:
            tail, median = max(grown)
            found.append((median, tail))
    return found


def _differences(mine: Sequence[Sequence[float | None]], other: Sequence[Sequence[float | None]]) -> list[float]:
    found = []
    for one, two in zip(mine, other, strict=True):
        own = [a - b for a, b in zip(one, two, strict=True) if a is not None and b is not None]
        found.append(math.fsum(own) / len(own) if own else math.nan)
    return found


_SERIES: Final = {"departure_m": measure_departures, "strayed_m": measure_straying}
"""Measures that are distances, over time."""
