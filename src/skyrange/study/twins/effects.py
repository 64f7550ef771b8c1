"""Effects of an attack on each aircraft: measures of a run, and their differences from the twin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.record.read.run import RunRecord
from skyrange.record.schema import NAME, Column, arrow_schema
from skyrange.study.measures.separation import NEAR_M, closest_approaches, min_building_distance_m
from skyrange.study.measures.time_series import read_notes, vehicles
from skyrange.study.measures.track_deviation import AIRBORNE_M

Floats = NDArray[np.float64]

DEPARTED_M = 1.0
"""An aircraft has departed from the twin if it is farther than this from its position there at the same time."""

_F64, _I64 = pa.float64(), pa.int64()


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


@dataclass(frozen=True, slots=True)
class Measured:
    """Measures of one aircraft in one run; `None` if the record does not contain the data."""

    vehicle: str
    outcome: str
    finished_s: float | None
    distance_m: float
    energy_j: float | None
    min_separation_m: float | None
    nearest: str | None
    near_misses: int
    collisions: int
    min_wall_m: float | None


def read_ticks(record: RunRecord) -> Ticks:
    """The truth of all aircraft by tick; ticks with missing aircraft are left out."""
    names = {vehicle.id: number for number, vehicle in enumerate(vehicles(record))}
    there = set(record.tables.schema("truth").names)
    columns = [name for name in ("east_m", "north_m", "up_m", "on_ground", "battery_v", "battery_a") if name in there]
    table = record.table("truth", ["time_ns", "vehicle", *columns])
    codes = table.column("vehicle").combine_chunks().dictionary_encode()
    lookup = np.array([names.get(name, -1) for name in codes.dictionary.to_pylist()], dtype=np.int64)
    who = lookup[codes.indices.to_numpy(zero_copy_only=False)] if len(lookup) else np.zeros(0, np.int64)
    time_ns = table.column("time_ns").to_numpy()
    order = np.lexsort((who, time_ns))
    moments, counts = np.unique(time_ns, return_counts=True)
    whole = np.repeat(counts == len(names), counts)
    shape = (int((counts == len(names)).sum()), len(names))
    values = {name: table.column(name).to_numpy()[order][whole].reshape(shape) for name in columns}
    unknown = np.full(shape, np.nan)
    enu_m = np.stack([values.get(name, unknown) for name in ("east_m", "north_m", "up_m")], axis=2)
    return Ticks(
        moments[counts == len(names)],
        enu_m,
        values["on_ground"] == 0.0 if "on_ground" in values else enu_m[:, :, 2] > AIRBORNE_M,
        values.get("battery_v", unknown) * values.get("battery_a", unknown),
    )


def measure(record: RunRecord, ticks: Ticks, near_m: float = NEAR_M) -> list[Measured]:
    """The measures of every aircraft of a run, in the manifest's order.

    Distances are lengths of the recorded truth and so depend on its sampling rate. Energy is volts times amperes at the
    battery's terminals, by the trapezoidal rule over the whole run.
    """
    fleet = [vehicle.id for vehicle in vehicles(record)]
    hits: dict[str, int] = {}
    for row in read_notes(record, "events"):
        if row.kind == "event.collision":
            hits[row.about] = hits.get(row.about, 0) + 1
    seconds = np.diff(ticks.time_ns) / NS_PER_S
    flown_m = np.sqrt((np.diff(ticks.enu_m, axis=0) ** 2).sum(axis=2)).sum(axis=0)
    energy_j = (0.5 * (ticks.power_w[1:] + ticks.power_w[:-1]) * seconds[:, None]).sum(axis=0)
    near = closest_approaches(ticks.enu_m, ticks.aloft, near_m)
    walls_m = min_building_distance_m(ticks.enu_m, ticks.aloft, record.city)
    outcomes = record.outcomes
    return [
        Measured(
            vehicle=name,
            outcome=str(outcomes.get(name, {}).get("state") or "unfinished"),
            finished_s=outcomes.get(name, {}).get("finished_s"),
            distance_m=float(flown_m[k]),
            energy_j=_finite(energy_j[k]),
            min_separation_m=_finite(near.least_m[k]),
            nearest=fleet[near.nearest[k]] if near.nearest[k] >= 0 else None,
            near_misses=int(near.near_misses[k]),
            collisions=hits.get(name, 0),
            min_wall_m=_finite(walls_m[k]),
        )
        for k, name in enumerate(fleet)
    ]


def departures(ticks: Ticks, twin: Ticks, threshold_m: float = DEPARTED_M) -> tuple[Floats, NDArray[np.int64]]:
    """(n,) largest distance of each aircraft from its position in the twin at the same time, and (n,) ns when it first
    exceeded `threshold_m`, −1 for never. Times that only one of the runs has are ignored.
    """
    _, mine, other = np.intersect1d(ticks.time_ns, twin.time_ns, assume_unique=True, return_indices=True)
    away_m = np.sqrt(((ticks.enu_m[mine] - twin.enu_m[other]) ** 2).sum(axis=2))
    beyond = away_m > threshold_m
    first = np.where(beyond.any(axis=0), ticks.time_ns[mine][beyond.argmax(axis=0)] if len(mine) else -1, -1)
    return away_m.max(axis=0, initial=0.0), first


COLUMNS: Final[tuple[Column, ...]] = (
    Column("seed", _I64, "", "seed of both runs"),
    Column("against", NAME, "", "the twin with which it is compared: nominal or sham"),
    Column("vehicle", NAME, "", "operator/vehicle"),
    Column("outcome", NAME, "", "outcome of the mission in the attacked run: complete, failed or unfinished"),
    Column("outcome_twin", NAME, "", "the same in the twin"),
    Column("finished_s", _F64, "s", "when the mission ended in the attacked run", True),
    Column("finished_twin_s", _F64, "s", "the same in the twin", True),
    Column("delay_s", _F64, "s", "arrival delay: attacked minus twin, if both missions are complete", True),
    Column("distance_m", _F64, "m", "length of the path flown in the attacked run"),
    Column("distance_twin_m", _F64, "m", "the same in the twin"),
    Column("extra_distance_m", _F64, "m", "attacked minus twin"),
    Column("energy_j", _F64, "J", "energy drawn from the battery over the whole attacked run", True),
    Column("energy_twin_j", _F64, "J", "the same in the twin", True),
    Column("extra_energy_j", _F64, "J", "attacked minus twin", True),
    Column("min_separation_m", _F64, "m", "least distance to another aircraft in the air, centre to centre", True),
    Column("min_separation_twin_m", _F64, "m", "the same in the twin", True),
    Column("nearest", NAME, "", "the other aircraft of that least distance, in the attacked run", True),
    Column(
        "near_misses", _I64, "", "number of times that another aircraft came nearer than the limit, in the attacked run"
    ),
    Column("near_misses_twin", _I64, "", "the same in the twin"),
    Column("collisions", _I64, "", "collisions with aircraft and buildings in the attacked run"),
    Column("collisions_twin", _I64, "", "the same in the twin"),
    Column("min_wall_m", _F64, "m", "least distance to a building in the attacked run; null beyond 30 m", True),
    Column("min_wall_twin_m", _F64, "m", "the same in the twin", True),
    Column("departure_m", _F64, "m", "largest distance from its position in the twin at the same time"),
    Column("departed_s", _F64, "s", "when that distance first exceeded the threshold; null for never", True),
)
"""The columns of `effects.parquet`, which has a row per seed, twin and aircraft."""

MEASURES: Final = ("delay_s", "extra_distance_m", "extra_energy_j", "departure_m")
"""Columns whose values are averaged over seeds."""
CHANGES: Final = ("near_misses", "collisions", "min_separation_m", "min_wall_m")
"""Columns whose differences from the twin are averaged over seeds."""


def effect_rows(
    seed: int, against: str, runs: tuple[RunRecord, RunRecord], near_m: float, threshold_m: float
) -> list[dict[str, Any]]:
    """The rows of one pair: `runs` are the attacked run and its twin."""
    both = [read_ticks(run) for run in runs]
    rows = []
    away_m, first_ns = departures(both[0], both[1], threshold_m)
    measured = [measure(run, ticks, near_m) for run, ticks in zip(runs, both, strict=True)]
    for k, (a, b) in enumerate(zip(*measured, strict=True)):
        done = a.outcome == b.outcome == "complete" and a.finished_s is not None and b.finished_s is not None
        row: dict[str, Any] = {"seed": seed, "against": against, "vehicle": a.vehicle, "nearest": a.nearest}
        for name in ("outcome", "near_misses", "collisions"):
            row[name], row[f"{name}_twin"] = getattr(a, name), getattr(b, name)
        for name in ("finished_s", "distance_m", "energy_j", "min_separation_m", "min_wall_m"):
            stem, unit = name.rsplit("_", 1)
            row[name], row[f"{stem}_twin_{unit}"] = getattr(a, name), getattr(b, name)
        row["delay_s"] = (a.finished_s or 0.0) - (b.finished_s or 0.0) if done else None
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


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
