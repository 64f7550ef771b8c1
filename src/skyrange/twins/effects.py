"""Effects on each aircraft: the columns of `effects.parquet`, and the differences between a run and its twin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.metrics.aircraft_measures import departures
from skyrange.record.schema import NAME, Column, arrow_schema
from skyrange.twins.attribution.outcomes import ArmOutcomes

Floats = NDArray[np.float64]

_F64, _I64 = pa.float64(), pa.int64()

COLUMNS: Final[tuple[Column, ...]] = (
    Column("seed", _I64, "", "seed of both runs"),
    Column("against", NAME, "", "the twin with which it is compared: nominal or sham"),
    Column("vehicle", NAME, "", "operator/vehicle"),
    Column("outcome", NAME, "", "outcome of the mission in the attacked run: complete, failed or unfinished"),
    Column("outcome_twin", NAME, "", "the same in the twin"),
    Column("landed_s", _F64, "s", "when it touched down to end the mission, in truth, in the attacked run", True),
    Column("landed_twin_s", _F64, "s", "the same in the twin", True),
    Column(
        "delay_s", _F64, "s", "arrival delay: `landed_s` of attacked minus twin, if both missions are complete", True
    ),
    Column(
        "finished_s",
        _F64,
        "s",
        "when the ground station reported the end of the mission, by the heartbeats that it gets, about one a second; "
        "in the attacked run",
        True,
    ),
    Column("finished_twin_s", _F64, "s", "the same in the twin, by its heartbeats", True),
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
    Column("attacks", pa.list_(pa.string()), "", "ids of the attacks that caused the effect; empty if none did"),
    Column("faults", pa.list_(pa.string()), "", "ids of the benign faults that caused the effect; empty if none did"),
    Column(
        "attribution",
        NAME,
        "",
        "how: necessary, sufficient, both, joint or redundant; none for an effect without an author, unknown where the "
        "arms were not run; null without an effect",
        True,
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
