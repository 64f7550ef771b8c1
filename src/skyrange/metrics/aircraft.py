"""Aircraft of a run: path, energy, near misses and mission outcome, and their distances from a twin."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import shapely
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.metrics.paths import AIRBORNE_M
from skyrange.metrics.safety import NEAR_M, closest_approaches, find_landings_s, min_building_distance_m
from skyrange.metrics.time_series import RecordedNote, read_notes, vehicles
from skyrange.record.read.run import RunRecord

Floats = NDArray[np.float64]

DEPARTED_M = 1.0
"""An aircraft has departed from the twin if it is farther than this from its position there at the same time."""


@dataclass(frozen=True, slots=True)
class Ticks:
    """The recorded truth of a fleet: t ticks, n aircraft in the manifest's order."""

    time_ns: NDArray[np.int64]
    """(t,)"""
    enu_m: Floats
    """(t, n, 3)"""
    aloft: NDArray[np.bool_]
    """(t, n)"""
    power_w: Floats
    """(t, n) drawn from the battery; NaN if the world has no battery"""
    others: tuple[str, ...] = ()
    """The m real aircraft of an honest arm, which are not part of the fleet."""
    others_enu_m: Floats = field(default_factory=lambda: np.zeros((0, 0, 3)))
    """(t, m, 3) NaN where one does not exist"""
    others_aloft: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    """(t, m)"""


@dataclass(frozen=True, slots=True)
class Measured:
    """Measures of one aircraft in one run; `None` if the record does not contain the data."""

    vehicle: str
    outcome: str
    finished_s: float | None
    """When its ground station reported the end of the mission, by heartbeats."""
    landed_s: float | None
    """When it touched down to end the mission, to the world's tick."""
    distance_m: float
    energy_j: float | None
    min_separation_m: float | None
    nearest: str | None
    near_misses: int
    collisions: int
    min_wall_m: float | None


def read_ticks(record: RunRecord) -> Ticks:
    """The truth of all aircraft by tick; ticks with missing aircraft of the fleet are left out."""
    names = {vehicle.id: number for number, vehicle in enumerate(vehicles(record))}
    others = tuple(str(row["id"]) for row in record.manifest.get("honest") or ())
    column_names = set(record.tables.schema("truth").names)
    columns = [
        name for name in ("east_m", "north_m", "up_m", "on_ground", "battery_v", "battery_a") if name in column_names
    ]
    table = record.table("truth", ["time_ns", "vehicle", *columns])
    codes = table.column("vehicle").combine_chunks().dictionary_encode()
    lookup = np.array([names.get(name, -1) for name in codes.dictionary.to_pylist()], dtype=np.int64)
    who = lookup[codes.indices.to_numpy(zero_copy_only=False)] if len(lookup) else np.zeros(0, np.int64)
    whole_table = table
    if others:
        table, who = table.filter(pa.array(who >= 0)), who[who >= 0]
    time_ns = table.column("time_ns").to_numpy()
    order = np.lexsort((who, time_ns))
    moments, counts = np.unique(time_ns, return_counts=True)
    whole = np.repeat(counts == len(names), counts)
    shape = (int((counts == len(names)).sum()), len(names))
    values = {name: table.column(name).to_numpy()[order][whole].reshape(shape) for name in columns}
    unknown = np.full(shape, np.nan)
    enu_m = np.stack([values.get(name, unknown) for name in ("east_m", "north_m", "up_m")], axis=2)
    ticks = Ticks(
        moments[counts == len(names)],
        enu_m,
        values["on_ground"] == 0.0 if "on_ground" in values else enu_m[:, :, 2] > AIRBORNE_M,
        values.get("battery_v", unknown) * values.get("battery_a", unknown),
    )
    return _with_others(ticks, whole_table, others) if others else ticks


def _with_others(ticks: Ticks, truth: pa.Table, others: tuple[str, ...]) -> Ticks:
    """The ticks with the real aircraft of an honest arm, which exist only while their attack acts."""
    shape = (len(ticks.time_ns), len(others))
    enu_m, aloft = np.full((*shape, 3), np.nan), np.zeros(shape, dtype=np.bool_)
    has_ground = "on_ground" in truth.column_names
    for number, name in enumerate(others):
        vehicle_truth = truth.filter(pc.equal(truth.column("vehicle"), name))
        _, rows, indices = np.intersect1d(
            ticks.time_ns, vehicle_truth.column("time_ns").to_numpy(), assume_unique=True, return_indices=True
        )
        for axis, column in enumerate(("east_m", "north_m", "up_m")):
            enu_m[rows, number, axis] = vehicle_truth.column(column).to_numpy()[indices]
        aloft[rows, number] = vehicle_truth.column("on_ground").to_numpy()[indices] == 0.0 if has_ground else True
    return replace(ticks, others=others, others_enu_m=enu_m, others_aloft=aloft)


def everyone(ticks: Ticks) -> tuple[Floats, NDArray[np.bool_]]:
    """Positions and `aloft` of the fleet and, behind it, of the real aircraft of an honest arm."""
    if not ticks.others:
        return ticks.enu_m, ticks.aloft
    return (
        np.concatenate([ticks.enu_m, ticks.others_enu_m], axis=1),
        np.concatenate([ticks.aloft, ticks.others_aloft], axis=1),
    )


def measure(record: RunRecord, ticks: Ticks, near_m: float = NEAR_M) -> list[Measured]:
    """The measures of every aircraft of a run, in the manifest's order. Those of an honest arm count as others.

    Distances are lengths of the recorded truth and so depend on its sampling rate. Energy is volts times amperes at the
    battery's terminals, by the trapezoidal rule over the whole run.
    """
    fleet = [vehicle.id for vehicle in vehicles(record)]
    hits: dict[str, int] = {}
    events = read_notes(record, "events")
    for row in events:
        if row.kind == "event.collision":
            hits[row.about] = hits.get(row.about, 0) + 1
    seconds = np.diff(ticks.time_ns) / NS_PER_S
    flown_m = np.sqrt((np.diff(ticks.enu_m, axis=0) ** 2).sum(axis=2)).sum(axis=0)
    energy_j = (0.5 * (ticks.power_w[1:] + ticks.power_w[:-1]) * seconds[:, None]).sum(axis=0)
    near = closest_approaches(*everyone(ticks), near_m)
    names = [*fleet, *ticks.others]
    walls_m = min_building_distance_m(ticks.enu_m, ticks.aloft, record.city)
    outcomes = record.outcomes
    landings_s = find_landings_s(events, outcomes)
    return [
        Measured(
            vehicle=name,
            outcome=str(outcomes.get(name, {}).get("state") or "unfinished"),
            finished_s=outcomes.get(name, {}).get("finished_s"),
            landed_s=landings_s.get(name),
            distance_m=float(flown_m[k]),
            energy_j=_finite(energy_j[k]),
            min_separation_m=_finite(near.least_m[k]),
            nearest=names[near.nearest[k]] if near.nearest[k] >= 0 else None,
            near_misses=int(near.near_misses[k]),
            collisions=hits.get(name, 0),
            min_wall_m=_finite(walls_m[k]),
        )
        for k, name in enumerate(fleet)
    ]


def departures(ticks: Ticks, twin: Ticks, threshold_m: float | Floats = DEPARTED_M) -> tuple[Floats, NDArray[np.int64]]:
    """(n,) largest distance of each aircraft from its position in the twin at the same time, and (n,) ns when it first
    exceeded `threshold_m`, one for all or (n,), −1 for never. Times that only one of the runs has are ignored.
    """
    _, rows, twin_rows = np.intersect1d(ticks.time_ns, twin.time_ns, assume_unique=True, return_indices=True)
    away_m = np.sqrt(((ticks.enu_m[rows] - twin.enu_m[twin_rows]) ** 2).sum(axis=2))
    beyond = away_m > threshold_m
    first = np.where(beyond.any(axis=0), ticks.time_ns[rows][beyond.argmax(axis=0)] if len(rows) else -1, -1)
    return away_m.max(axis=0, initial=0.0), first


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def near_misses(record: RunRecord, near_m: float = NEAR_M) -> list[RecordedNote]:
    """A note of kind `near_miss` for each aircraft and each time that another comes nearer than `near_m`.

    Counted as in `separation.closest_approaches`: again only after they were farther apart. In order of time.
    """
    ticks, names = read_ticks(record), [vehicle.id for vehicle in vehicles(record)]
    names += ticks.others
    enu_m, aloft = everyone(ticks)
    notes = []
    for k in range(len(names)):
        away_m = np.sqrt(((enu_m[:, k + 1 :] - enu_m[:, k : k + 1]) ** 2).sum(axis=2))
        near = (away_m < near_m) & aloft[:, k + 1 :] & aloft[:, k : k + 1]
        begins = near & ~np.vstack([np.zeros((1, near.shape[1]), dtype=np.bool_), near[:-1]])
        for tick, other in np.argwhere(begins).tolist():
            pair, time_ns = (names[k], names[k + 1 + other]), int(ticks.time_ns[tick])
            data = {"distance_m": round(float(away_m[tick, other]), 3)}
            for aircraft, other_vehicle in (pair, pair[::-1]):
                notes.append(RecordedNote(time_ns, "near_miss", aircraft, "world", {"with": other_vehicle, **data}))
    return sorted(notes, key=lambda note: note.time_ns)


GROWTH_NS: Final = 60_000_000_000
"""Growth is that of the last minute of the attack at most."""
LEAST_NS: Final = 20_000_000_000
"""Of an attack that acts for less than this no growth is measured: it is over before its effect is."""


class DistanceSeries(NamedTuple):
    """The distances of the aircraft of a run from their baselines; those of the ground come last and do not change."""

    time_ns: NDArray[np.int64]
    """(t,)"""
    away_m: Floats
    """(t, n)"""
    aloft: NDArray[np.bool_]
    """(t, n)"""


def measure_departures(attacked: RunRecord, baseline: RunRecord) -> DistanceSeries:
    """Distances from where each aircraft is at the same time in the baseline. Times of one run alone are left out."""
    attacked_ticks, baseline_ticks = read_ticks(attacked), read_ticks(baseline)
    time_ns, attacked_rows, baseline_rows = np.intersect1d(
        attacked_ticks.time_ns, baseline_ticks.time_ns, assume_unique=True, return_indices=True
    )
    away_m = np.sqrt(((attacked_ticks.enu_m[attacked_rows] - baseline_ticks.enu_m[baseline_rows]) ** 2).sum(axis=2))
    return DistanceSeries(time_ns, away_m, attacked_ticks.aloft[attacked_rows])


def measure_straying(attacked: RunRecord, baseline: RunRecord) -> DistanceSeries:
    """Horizontal distances from the path that each aircraft flew in the baseline, whatever the time."""
    attacked_ticks, baseline_ticks = read_ticks(attacked), read_ticks(baseline)
    away_m = np.zeros(attacked_ticks.aloft.shape)
    for k in range(attacked_ticks.enu_m.shape[1]):
        if len(baseline_ticks.time_ns) > 1:
            path = shapely.LineString(baseline_ticks.enu_m[:, k, :2])
            away_m[:, k] = shapely.distance(shapely.points(attacked_ticks.enu_m[:, k, :2]), path)
    return DistanceSeries(attacked_ticks.time_ns, away_m, attacked_ticks.aloft)


def measure_growth(series: DistanceSeries, start_ns: int, stop_ns: int) -> float | None:
    """How much the largest distance of any aircraft still grew in the second half of an attack, or in its last minute
    if that is shorter, in metres a minute; `None` for an attack of less than 20 s.

    It ends with the attack or with the flight.
    """
    highest = np.maximum.accumulate(series.away_m, axis=0)
    growths: list[float] = []
    for k in range(series.away_m.shape[1]):
        acting = np.flatnonzero(series.aloft[:, k] & (series.time_ns >= start_ns) & (series.time_ns <= stop_ns))
        begin_ns, end_ns = (int(series.time_ns[acting[place]]) for place in (0, -1)) if acting.size else (0, 0)
        if end_ns - begin_ns < LEAST_NS:
            continue
        since_ns = max(end_ns - GROWTH_NS, (begin_ns + end_ns) // 2)
        first, last = int(np.searchsorted(series.time_ns, since_ns)), int(acting[-1])
        span_min = (end_ns - int(series.time_ns[first])) / GROWTH_NS
        growths.append(float(highest[last, k] - highest[first, k]) / span_min)
    return max(growths, default=None)
