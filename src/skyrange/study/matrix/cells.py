"""Measures of a cell: effect, alarms and cost, read from the runs of its arms with each seed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.metrics.aircraft import DEPARTED_M, Measured, measure_departures, measure_growth, measure_straying
from skyrange.metrics.exact_difference import identify_flight
from skyrange.metrics.links import link_statistics, measure_transit_ms
from skyrange.metrics.safety import NEAR_M
from skyrange.metrics.time_series import read_notes
from skyrange.record.manifest import require_entry
from skyrange.record.read.run import RunRecord
from skyrange.scoring.matching import count_episodes
from skyrange.scoring.result_file import ScoreSettings
from skyrange.statistics.means import Interval, estimate_mean
from skyrange.twins.arms import ATTACKED, HONEST, NOMINAL, SHAM
from skyrange.twins.effects import ArmOutcomes, effect_rows
from skyrange.twins.failed_missions import find_failed_missions

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
    """The folder of its first seed, a pair, relative to that of the matrix; "" if it is not kept."""
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
        flown = [cell for cell in self.adaptive if cell.effects]
        if not flown:
            return None
        half = len(self.effects) // 2
        chosen = max([self, *flown], key=lambda cell: math.fsum(cell.effects[: half or None]))
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
        times_s = [watched_s if at is None else at for at, watched_s in zip(self.alarms_s, self.watched_s, strict=True)]
        return math.fsum(times_s) / len(times_s) if times_s else None

    def data(self) -> dict[str, Any]:
        """As JSON data."""
        return asdict(self)


BY_SEED: Final = (
    "failed", "effects", "complete", "growth_m_per_min", "alarms_s", "watched_s", "false_alarms", "flown_h",
    "fault_alarms", "nominal", "honest_alarms",
)  # fmt: skip
"""Fields of a cell that are lists by seed."""


def join_seeds(cells: Sequence[Cell]) -> Cell:
    """The cell of all seeds, from those of one seed each, in order."""
    lists: dict[str, Any] = {name: [value for cell in cells for value in getattr(cell, name)] for name in BY_SEED}
    return replace(cells[0], **lists)


def measure_cell(runs: Mapping[str, RunRecord], cell: Cell, measure: str, detectors: Sequence[str]) -> Cell:
    """`cell` with the measures of the runs of one seed, by arm.

    `detectors` are the ids of its defences, none for the undefended one. The baseline is the sham where it was flown.
    """
    attacked, twin = runs[ATTACKED], runs[SHAM if SHAM in runs else NOMINAL]
    events = [(note.kind, note.time_ns) for note in read_notes(attacked, "events")]
    end_ns = _end_ns(attacked)
    start_ns = min((at for kind, at in events if kind in _STARTS), default=end_ns)
    stop_ns = max((at for kind, at in events if kind in _STOPS), default=end_ns)
    series = _SERIES[measure](attacked, twin) if measure in _SERIES else None
    baseline = ArmOutcomes.read(twin, NEAR_M)
    seed = require_entry(attacked.manifest, "seed", str(attacked.path))
    rows = effect_rows(seed, "", ArmOutcomes.read(attacked, NEAR_M), baseline, DEPARTED_M)
    if measure == "strayed_m" and series is not None:
        effect = float(series.away_m.max(initial=0.0))
    elif measure == "telemetry":
        effect = _missing_telemetry(attacked, twin)
    else:
        effect = max(_value(row, measure) for row in rows)
    after = [at for at in alert_times_ns(attacked, detectors) if at >= start_ns]
    measured_cell = replace(
        cell,
        failed=[
            str(failure) for arm in (NOMINAL, SHAM) if arm in runs and (failure := find_failed_missions(runs[arm], arm))
        ],
        effects=[effect],
        complete=[all(row["outcome"] == "complete" for row in rows if row["outcome_twin"] == "complete")],
        growth_m_per_min=[None if series is None else measure_growth(series, start_ns, stop_ns)],
        alarms_s=[(after[0] - start_ns) / NS_PER_S if after and not cell.fault else None],
        watched_s=[(end_ns - start_ns) / NS_PER_S],
        fault_alarms=[count_alarms(attacked, detectors)] if cell.fault else [],
        honest_alarms=[bool(alert_times_ns(runs[HONEST], detectors))] if HONEST in runs else [],
    )
    if cell.candidate:
        return measured_cell  # what a defence costs does not depend on the attack
    quiet = runs[NOMINAL]
    measured = (baseline if quiet is twin else ArmOutcomes.read(quiet, NEAR_M)).measured
    return replace(
        measured_cell,
        false_alarms=[count_alarms(quiet, detectors)],
        nominal=[_nominal(quiet, measured)],
        flown_h=[_flown_h(quiet, measured)],
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
    attacked_frames, baseline_frames = (
        sum(link.delivered for link in link_statistics(run) if (link.kind, link.direction) == ("gcs", "rev"))
        for run in (attacked, baseline)
    )
    return 100.0 * max(baseline_frames - attacked_frames, 0) / max(baseline_frames, 1)


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
    ends = [aircraft.finished_s if aircraft.landed_s is None else aircraft.landed_s for aircraft in measured]
    return sum(last_s if end_s is None else end_s for end_s in ends) / _S_PER_H


def _nominal(run: RunRecord, measured: Sequence[Measured]) -> Nominal:
    return Nominal(
        [aircraft.landed_s for aircraft in measured],
        [aircraft.energy_j for aircraft in measured],
        [aircraft.outcome == "complete" for aircraft in measured],
        identify_flight(run.manifest),
        run.table("frames", ["size"]).num_rows,
        measure_transit_ms(run),
    )


def added_delay_s(cell: Cell, without: Cell) -> list[float]:
    """How much later missions end by touchdown in the nominal runs with a defence, in s: the mean over aircraft, by
    seed; of a seed in which no aircraft touches down in both, NaN.
    """
    return _differences(
        [nominal.landed_s for nominal in cell.nominal], [nominal.landed_s for nominal in without.nominal]
    )


def added_energy_j(cell: Cell, without: Cell) -> list[float]:
    """How much more energy aircraft use in the nominal runs with a defence, in joules: as `added_delay_s`."""
    return _differences(
        [nominal.energy_j for nominal in cell.nominal], [nominal.energy_j for nominal in without.nominal]
    )


def broken_missions(cell: Cell, without: Cell) -> tuple[int, int]:
    """Missions of the nominal runs that are complete without the defence alone, and those that are without it."""
    pairs = [
        (complete, complete_without)
        for run, run_without in zip(cell.nominal, without.nominal, strict=True)
        for complete, complete_without in zip(run.complete, run_without.complete, strict=True)
    ]
    broken = sum(complete_without and not complete for complete, complete_without in pairs)
    return broken, sum(complete_without for _, complete_without in pairs)


def added_frames(cell: Cell, without: Cell) -> list[float]:
    """How many more frames are sent in the nominal runs with a defence, by seed."""
    return [float(a.frames - b.frames) for a, b in zip(cell.nominal, without.nominal, strict=True)]


def added_transit_ms(cell: Cell, without: Cell, roles: Sequence[str]) -> list[tuple[float, float]]:
    """How much median and 95th percentile of the delay of frames grow in the nominal runs with a defence, in ms.

    By seed, on links of those of `roles` that there are; of several, that whose 95th percentile grows most.
    """
    growths = []
    for run, run_without in zip(cell.nominal, without.nominal, strict=True):
        delays, delays_without = run.transit_ms, run_without.transit_ms
        grown = [
            (delays[role][1] - delays_without[role][1], delays[role][0] - delays_without[role][0])
            for role in roles
            if role in delays and role in delays_without
        ]
        if grown:
            tail, median = max(grown)
            growths.append((median, tail))
    return growths


def _differences(
    values: Sequence[Sequence[float | None]], values_without: Sequence[Sequence[float | None]]
) -> list[float]:
    means = []
    for seed_values, seed_values_without in zip(values, values_without, strict=True):
        differences = [
            a - b for a, b in zip(seed_values, seed_values_without, strict=True) if a is not None and b is not None
        ]
        means.append(math.fsum(differences) / len(differences) if differences else math.nan)
    return means


_SERIES: Final = {"departure_m": measure_departures, "strayed_m": measure_straying}
"""Measures that are distances, over time."""
