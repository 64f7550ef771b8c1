"""Measures of aircraft in a run: path, energy, separation, mishaps and mission outcome, and departures from a twin."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.metrics.landings import find_landings_s
from skyrange.metrics.separation import NEAR_M, closest_approaches, min_building_distance_m
from skyrange.metrics.time_series import read_notes, vehicles
from skyrange.metrics.track_deviation import AIRBORNE_M
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
    there = set(record.tables.schema("truth").names)
    columns = [name for name in ("east_m", "north_m", "up_m", "on_ground", "battery_v", "battery_a") if name in there]
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
    there = "on_ground" in truth.column_names
    for number, name in enumerate(others):
        own = truth.filter(pc.equal(truth.column("vehicle"), name))
        _, rows, found = np.intersect1d(
            ticks.time_ns, own.column("time_ns").to_numpy(), assume_unique=True, return_indices=True
        )
        for axis, column in enumerate(("east_m", "north_m", "up_m")):
            enu_m[rows, number, axis] = own.column(column).to_numpy()[found]
        aloft[rows, number] = own.column("on_ground").to_numpy()[found] == 0.0 if there else True
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
    _, mine, other = np.intersect1d(ticks.time_ns, twin.time_ns, assume_unique=True, return_indices=True)
    away_m = np.sqrt(((ticks.enu_m[mine] - twin.enu_m[other]) ** 2).sum(axis=2))
    beyond = away_m > threshold_m
    first = np.where(beyond.any(axis=0), ticks.time_ns[mine][beyond.argmax(axis=0)] if len(mine) else -1, -1)
    return away_m.max(axis=0, initial=0.0), first


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
