"""Lie against truth: what each aircraft does about a claimed aircraft, and about a real one that sends the same bytes.

Both the attacked and the honest run are compared with the baseline, in which no aircraft is claimed. Their difference
is what the lie does beyond what the truth would do: zero for an aircraft that cannot tell the one from the other and
meets neither.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import pyarrow as pa

from skyrange.core.time import NS_PER_S
from skyrange.metrics.time_series import read_notes
from skyrange.record.read.run import RunRecord
from skyrange.record.schema import NAME, Column, arrow_schema
from skyrange.twins.effects import ArmOutcomes, effect_rows

AVOIDS: Final = "decision.avoid"
_F64, _I64 = pa.float64(), pa.int64()


def _twice(name: str, kind: pa.DataType, unit: str, about: str, *, nullable: bool = True) -> tuple[Column, Column]:
    stem, _, suffix = name.rpartition("_")
    other = f"{stem}_truth_{suffix}" if unit else f"{name}_truth"
    return (
        Column(name, kind, unit, f"{about}, in the attacked run", nullable=nullable),
        Column(other, kind, unit, "the same in the honest run", nullable=nullable),
    )


COLUMNS: Final[tuple[Column, ...]] = (
    Column("seed", _I64, "", "seed of the runs"),
    Column("vehicle", NAME, "", "operator/vehicle"),
    *_twice("outcome", NAME, "", "outcome of the mission", nullable=False),
    *_twice("avoidances", _I64, "", "number of decisions to avoid another aircraft", nullable=False),
    *_twice("avoids_s", _F64, "s", "first decision to avoid that the baseline does not have; null for none"),
    *_twice("departed_s", _F64, "s", "when it first departed from the baseline; null for never"),
    *_twice("departure_m", _F64, "m", "largest distance from its position in the baseline", nullable=False),
    *_twice("delay_s", _F64, "s", "arrival delay against the baseline, if both missions are complete"),
    *_twice("extra_distance_m", _F64, "m", "detour: length of the path minus that in the baseline", nullable=False),
    *_twice("extra_energy_j", _F64, "J", "energy drawn from the battery minus that in the baseline"),
    *_twice("min_separation_m", _F64, "m", "least distance to another aircraft in the air"),
    *_twice("nearest", NAME, "", "the other aircraft of that least distance"),
    *_twice("near_misses", _I64, "", "number of near misses", nullable=False),
    *_twice("collisions", _I64, "", "number of collisions", nullable=False),
    Column("apart_m", _F64, "m", "largest distance between its positions in the attacked and the honest run"),
)
"""The columns of `honest.parquet`, which has a row per seed and aircraft of the scenario."""

_MEASURED: Final = (
    "outcome", "departed_s", "departure_m", "delay_s", "extra_distance_m", "extra_energy_j", "min_separation_m",
    "nearest", "near_misses", "collisions",
)  # fmt: skip


class Reaction(NamedTuple):
    """A column as it is shown."""

    title: str
    column: str
    unit: str
    factor: float
    decimals: int


REACTIONS: Final = (
    Reaction("avoids", "avoids_s", "s", 1.0, 1),
    Reaction("departs", "departed_s", "s", 1.0, 1),
    Reaction("by", "departure_m", "m", 1.0, 1),
    Reaction("delay", "delay_s", "s", 1.0, 2),
    Reaction("detour", "extra_distance_m", "m", 1.0, 1),
    Reaction("energy", "extra_energy_j", "kJ", 1e-3, 2),
    Reaction("near misses", "near_misses", "", 1.0, 0),
    Reaction("collisions", "collisions", "", 1.0, 0),
)
"""The columns that are shown, of both runs side by side."""


def reacts(row: Mapping[str, Any]) -> bool:
    """Whether an aircraft did anything about the lie or about the truth."""
    names = ("avoids_s", "departed_s", "near_misses", "collisions")
    return any(row[name] or row[truth_name(name)] for name in names)


def format_values(row: Mapping[str, Any], shown_as: Reaction) -> tuple[str, str]:
    """The values of a column in the attacked and in the honest run, with their unit; "–" for none."""
    _, name, unit, factor, decimals = shown_as
    lie, truth = (
        "–" if value is None else f"{value * factor:.{decimals}f} {unit}".rstrip()
        for value in (row[name], row[truth_name(name)])
    )
    return lie, truth


def format_reaction(row: Mapping[str, Any], shown_as: Reaction) -> str:
    """Both values of a column, as `lie → truth`; one where they are shown alike."""
    return " → ".join(dict.fromkeys(format_values(row, shown_as)))


def truth_name(name: str) -> str:
    """The name of the honest run's column beside that of the attacked run."""
    column = next(place for place, declared in enumerate(COLUMNS) if declared.name == name)
    return COLUMNS[column + 1].name


def compare_with_truth(
    seed: int, attacked: ArmOutcomes, honest: ArmOutcomes, baseline: ArmOutcomes, threshold_m: float
) -> list[dict[str, Any]]:
    """The rows of one seed. Raises nothing of its own."""
    lies = effect_rows(seed, "baseline", attacked, baseline, threshold_m)
    truths = effect_rows(seed, "baseline", honest, baseline, threshold_m)
    apart = effect_rows(seed, "honest", attacked, honest, threshold_m)
    usual = _avoidances(baseline.record)
    avoided = [_avoidances(attacked.record), _avoidances(honest.record)]
    rows = []
    for lie, truth, between in zip(lies, truths, apart, strict=True):
        vehicle = lie["vehicle"]
        row: dict[str, Any] = {"seed": seed, "vehicle": vehicle, "apart_m": between["departure_m"]}
        for name in _MEASURED:
            row[name], row[truth_name(name)] = lie[name], truth[name]
        for column, avoidances in zip(("avoids_s", truth_name("avoids_s")), avoided, strict=True):
            known = set(usual.get(vehicle, ()))
            new = [at_ns for at_ns in avoidances.get(vehicle, ()) if at_ns not in known]
            row[column] = min(new) / NS_PER_S if new else None
        row["avoidances"], row[truth_name("avoidances")] = (len(avoidances.get(vehicle, ())) for avoidances in avoided)
        rows.append(row)
    return rows


def lie_and_truth_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as the table of `honest.parquet`."""
    return pa.Table.from_pylist([dict(row) for row in rows], schema=arrow_schema("honest", COLUMNS))


def _avoidances(record: RunRecord) -> dict[str, list[int]]:
    """The times of the decisions to avoid, by aircraft."""
    times_ns: dict[str, list[int]] = {}
    for row in read_notes(record, "decisions"):
        if row.kind == AVOIDS:
            times_ns.setdefault(row.about.split(".", 1)[0], []).append(row.time_ns)
    return times_ns
