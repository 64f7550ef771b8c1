"""Measures of a cell: effect, alarms and cost, read from the pair of its row and column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
import shapely

from skyrange.core.time import NS_PER_S
from skyrange.record.read.run import RunRecord
from skyrange.study.attribution.arms import ATTACKED, HONEST, NOMINAL
from skyrange.study.attribution.outcomes import ArmOutcomes
from skyrange.study.matrix.latency import measure_transit_ms
from skyrange.study.measures.aircraft_measures import Measured
from skyrange.study.measures.link_statistics import link_statistics
from skyrange.study.measures.separation import NEAR_M
from skyrange.study.measures.time_series import read_notes, truth_tracks
from skyrange.study.twins.confidence import Interval, interval
from skyrange.study.twins.pair_folder import Pair

_STARTS: Final = ("event.attack_start", "event.fault_start")
_S_PER_H: Final = 3600.0


@dataclass(frozen=True, slots=True)
class Nominal:
    """What one nominal run is compared by: touchdowns that ended missions, energy, frames sent, and their delays."""

    landed_s: Sequence[float | None]
    energy_j: Sequence[float | None]
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
    alarms_s: Sequence[float | None] = ()
    """Time from the attack's start to the first alarm after it; `None` without one."""
    false_alarms: Sequence[int] = ()
    """Alarms of the nominal run."""
    flown_h: Sequence[float] = ()
    """Aircraft-hours of the nominal run, of each aircraft until its mission ends."""
    fault_alarms: Sequence[int] = ()
    """Alarms of the run with the fault, in a row without an attack: they are false too."""
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
        return interval(self.effects)

    @property
    def best_adaptive(self) -> Cell | None:
        """What an adversary who knows the defence does best: this cell or a candidate; `None` if there is none."""
        flown = [one for one in self.adaptive if one.effects]
        return max([self, *flown], key=_mean_effect) if flown else None

    @property
    def alarm_s(self) -> float | None:
        """Mean time to alarm over the seeds that have one."""
        told = [at for at in self.alarms_s if at is not None]
        return sum(told) / len(told) if told else None

    def data(self) -> dict[str, Any]:
        """As JSON data."""
        data = asdict(self)
        del data["quiet"]
        return data


def _mean_effect(cell: Cell) -> float:
    return sum(cell.effects) / len(cell.effects)


def measure_cell(flown: Pair, cell: Cell, measure: str, detectors: Sequence[str]) -> Cell:
    """`cell` with the measures of its pair; `detectors` are the ids of its defences, none for the undefended one."""
    baseline = flown.baseline or NOMINAL
    effects: list[float] = []
    complete: list[bool] = []
    alarms, false_alarms, hours, nominal, fault_alarms = [], [], [], [], []
    rows = [one for one in flown.effects.to_pylist() if one["against"] == baseline]
    for seed in flown.seeds:
        own = [one for one in rows if one["seed"] == seed]
        if measure == "strayed_m":
            effects.append(_strayed_m(flown.run(ATTACKED, seed), flown.run(baseline, seed)))
        elif measure == "telemetry":
            effects.append(_missing_telemetry(flown.run(ATTACKED, seed), flown.run(baseline, seed)))
        else:
            effects.append(max(_value(one, measure) for one in own))
        complete.append(all(one["outcome"] == "complete" for one in own if one["outcome_twin"] == "complete"))
        attacked = flown.run(ATTACKED, seed)
        raised = alert_times_ns(attacked, detectors)
        start_ns = _start_ns(attacked)
        after = [at for at in raised if start_ns is not None and at >= start_ns]
        alarms.append((after[0] - start_ns) / NS_PER_S if after and start_ns is not None and not cell.fault else None)
        fault_alarms += [len(raised)] if cell.fault else []
        if cell.candidate:
            continue  # what a defence costs does not depend on the attack
        quiet = flown.run(NOMINAL, seed)
        false_alarms.append(len(alert_times_ns(quiet, detectors)))
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
        alarms_s=alarms,
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


def _strayed_m(attacked: RunRecord, baseline: RunRecord) -> float:
    """Largest horizontal distance of any aircraft from the path that it flew in the baseline, in metres."""
    mine, other = truth_tracks(attacked), truth_tracks(baseline)
    away = [0.0]
    for name, track in mine.items():
        path = other.get(name)
        if path is not None and len(path) > 1 and len(track):
            line = shapely.LineString(path.enu_m[:, :2])
            away.append(float(shapely.distance(shapely.points(track.enu_m[:, :2]), line).max()))
    return max(away)


def _missing_telemetry(attacked: RunRecord, baseline: RunRecord) -> float:
    """Share of the frames that stations get on gcs links in the baseline and that are missing, in percent."""
    mine, other = (
        sum(one.delivered for one in link_statistics(run) if (one.kind, one.direction) == ("gcs", "rev"))
        for run in (attacked, baseline)
    )
    return 100.0 * max(other - mine, 0) / max(other, 1)


def alert_times_ns(run: RunRecord, detectors: Sequence[str]) -> list[int]:
    """When these detectors or defences raised alerts, in order."""
    if not detectors:
        return []
    table = run.table("alerts", ["time_ns", "detector"])
    chosen = table.filter(pc.is_in(table.column("detector"), value_set=pa.array(list(detectors), type=pa.string())))
    return sorted(chosen.column("time_ns").to_pylist())


def _start_ns(run: RunRecord) -> int | None:
    starts = [note.time_ns for note in read_notes(run, "events") if note.kind in _STARTS]
    return min(starts, default=None)


def _flown_h(run: RunRecord, measured: Sequence[Measured]) -> float:
    """Aircraft-hours until the touchdown that ends the mission; of an aircraft that has none, until the mission is
    reported as ended, or else to the end of the run.
    """
    last_s = int(pc.max(run.table("truth", ["time_ns"]).column("time_ns")).as_py()) / NS_PER_S
    ends = [one.finished_s if one.landed_s is None else one.landed_s for one in measured]
    return sum(last_s if one is None else one for one in ends) / _S_PER_H


def _nominal(run: RunRecord, measured: Sequence[Measured]) -> Nominal:
    return Nominal(
        [one.landed_s for one in measured],
        [one.energy_j for one in measured],
        run.table("frames", ["size"]).num_rows,
        measure_transit_ms(run),
    )


def added_delay_s(cell: Cell, without: Cell) -> list[float]:
    """How much later missions end by touchdown in the nominal runs with a defence, in s, by seed and aircraft."""
    return _differences([one.landed_s for one in cell.nominal], [one.landed_s for one in without.nominal])


def added_energy_j(cell: Cell, without: Cell) -> list[float]:
    """How much more energy aircraft use in the nominal runs with a defence, in joules, by seed and aircraft."""
    return _differences([one.energy_j for one in cell.nominal], [one.energy_j for one in without.nominal])


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
    return [
        a - b
        for one, two in zip(mine, other, strict=True)
        for a, b in zip(one, two, strict=True)
        if a is not None and b is not None
    ]
