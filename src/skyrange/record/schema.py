"""Schema of a run's record: the columns of each table with type, unit and meaning, and the tables of each level.

`columns.csv` has the columns. The writer, the reader and the documentation read them from there. Every Parquet file
contains the unit and meaning of each column as Arrow field metadata.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, TypeVar

import pyarrow as pa

from skyrange.core.errors import InputError
from skyrange.core.files import read_package_table

FORMAT = "skyrange.run/1"
"""The format of a run's folder, and the only one that is read; the number is raised when the format changes."""

PAYLOAD_WINDOW = 1 << 16
"""Payloads are de-duplicated within windows: `payload_id // PAYLOAD_WINDOW` is a payload's window, windows are
consecutive, and a frame's payload lies in the newest window that had begun when the frame was recorded."""

NAME = pa.string()
"""The type of names: dictionary-encoded in the files, plain strings in memory."""

TEXT = pa.large_string()
"""Placeholder type that distinguishes free text from names; `arrow_schema` makes both plain strings."""

_TYPES = {
    "name": NAME,
    "text": TEXT,
    "texts": pa.list_(pa.string()),
    "uint8s": pa.list_(pa.uint8()),
    "uint16s": pa.list_(pa.uint16()),
    "int32s": pa.list_(pa.int32()),
    "bools": pa.list_(pa.bool_()),
}
"""Types of columns by the names that files of columns have for them; other types have Arrow's names."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column: `unit` is "" for names and counts; a `nullable` column may have rows without a value."""

    name: str
    type: pa.DataType
    unit: str
    meaning: str
    nullable: bool = field(default=False, kw_only=True)


_Column = TypeVar("_Column", bound=Column)


def read_columns(module: str, name: str, kind: Callable[..., _Column]) -> dict[str, tuple[_Column, ...]]:
    """The columns in a CSV file of the package, by table: `kind` of each row.

    `module` is the `__file__` of a module in its folder. The file has the columns `table`, `type`, `nullable` ("yes" or
    nothing) and one for every other field of `kind`.
    """
    tables: dict[str, list[_Column]] = {}
    for row in read_package_table(module, name):
        type_, nullable = row.pop("type"), row.pop("nullable") == "yes"
        known = _TYPES[type_] if type_ in _TYPES else pa.type_for_alias(type_)
        tables.setdefault(row.pop("table"), []).append(kind(type=known, nullable=nullable, **row))
    return {table: tuple(columns) for table, columns in tables.items()}


_COLUMNS = read_columns(__file__, "columns.csv", Column)


def _sensors(stage: str) -> tuple[Column, ...]:
    """The columns of a table of readings; `stage` says where they were taken."""
    readings = (replace(column, meaning=f"{column.meaning}; {stage}") for column in _COLUMNS["readings"])
    return (*_COLUMNS["truth"][:2], *readings)


TABLES: dict[str, tuple[Column, ...]] = {
    "truth": _COLUMNS["truth"],
    "sensors": _sensors("as sensed, before attacks, faults and defences"),
    "received_sensors": _sensors("as received by the autopilot, after attacks, faults and defences"),
    "receptions": _COLUMNS["receptions"],
    "scans": _COLUMNS["scans"],
    "frames": _COLUMNS["frames"],
    "payloads": _COLUMNS["payloads"],
    "decisions": _COLUMNS["notes"],
    "events": _COLUMNS["notes"],
    "labels": _COLUMNS["labels"],
    "alerts": _COLUMNS["alerts"],
    "observations": _COLUMNS["observations"],
    "features": _COLUMNS["features"],
}
"""The columns of every table. Truth may have more, as the world defines."""

TELEMETRY = _COLUMNS["telemetry"]
"""The columns with which the telemetry of every MAVLink message begins, a table for each; its fields follow."""

OPTIONAL = frozenset({"alerts", "observations", "features", "received_sensors", "scans"})
"""Tables that only some runs have: `alerts`, only runs with detectors; `observations`, only runs in which a radio
decoded something; `features`, only runs at level `study`; `received_sensors`, only runs in which an autopilot received
other readings than its sensors gave; `scans`, only runs in which a LiDAR or a depth camera made one. In other
runs all but `features` are read as empty."""

DERIVED = frozenset({"observations", "features"})
"""Tables that follow from frames and receptions: computed from these where they are recorded, as telemetry is, or else
during the run."""

BAD_DATA = "BAD_DATA"
"""pymavlink's name for bytes that are not a message."""

_SUFFIXES = (
    ("_radps", "rad/s"),
    ("_mps2", "m/s²"),
    ("_mps", "m/s"),
    ("_rad", "rad"),
    ("_deg", "deg"),
    ("_ns", "ns"),
    ("_kg", "kg"),
    ("_n", "N"),
    ("_w", "W"),
    ("_v", "V"),
    ("_a", "A"),
    ("_s", "s"),
    ("_m", "m"),
)


def unit_of(name: str) -> str:
    """The unit by the suffix of a column's name, or ""; an index may follow the suffix (`motor_radps_2`)."""
    stem = re.sub(r"_?\d+$", "", name)
    return next((unit for suffix, unit in _SUFFIXES if stem.endswith(suffix)), "")


def columns_of(table: str) -> tuple[Column, ...]:
    """The declared columns of a table in `TABLES`, or of "telemetry"; none of any other one."""
    return TELEMETRY if table == "telemetry" else TABLES.get(table, ())


def arrow_schema(table: str, columns: Sequence[Column] | None = None) -> pa.Schema:
    """The Arrow schema of `table`, a name in `TABLES` or "telemetry", for readers; `columns` replaces the declared
    columns if a run has others.
    """
    fields = [
        pa.field(
            column.name,
            pa.string() if column.type == TEXT else column.type,
            nullable=column.nullable,
            metadata={"unit": column.unit, "meaning": column.meaning},
        )
        for column in (columns_of(table) if columns is None else columns)
    ]
    return pa.schema(fields, metadata={"skyrange.table": table, "skyrange.format": FORMAT})


def truth_columns(names: Iterable[str]) -> tuple[Column, ...]:
    """The columns of truth for a world whose state variables have these names, in the world's order."""
    declared = {column.name: column for column in TABLES["truth"]}
    return TABLES["truth"][:3] + tuple(
        declared.get(name, Column(name, pa.float64(), unit_of(name), "a state variable of the world")) for name in names
    )


def telemetry_columns(fields: Iterable[Column]) -> tuple[Column, ...]:
    """The columns of the telemetry of a MAVLink message with these fields; a name already in use gets a `_`."""
    used_names = {column.name for column in TELEMETRY}
    return TELEMETRY + tuple(
        replace(field, name=field.name + "_") if field.name in used_names else field for field in fields
    )


FULL: Final = "full"
STUDY: Final = "study"
SUMMARY: Final = "summary"

LEVELS: Final = (FULL, STUDY, SUMMARY)
"""From most to least."""

ALL_MESSAGES: Final = "telemetry"
"""Stands for the tables of all MAVLink messages."""

_STUDY: Final = frozenset(
    {"truth", "sensors", "received_sensors", "decisions", "events", "labels", "alerts", "observations", "features"}
)
_SUMMARY: Final = frozenset({"decisions", "events", "alerts"})
_KEPT: Final = {FULL: frozenset({*TABLES, ALL_MESSAGES}), STUDY: _STUDY, SUMMARY: _SUMMARY}

RECORDED: Final = {FULL: frozenset(TABLES) - DERIVED, STUDY: _STUDY, SUMMARY: _SUMMARY}
"""The tables whose rows a recorder writes; what a run at level `full` has besides is derived from them."""


def level_of(manifest: Mapping[str, Any]) -> str:
    """The level at which a run was recorded, by its manifest."""
    return str(manifest["record"]["level"])


def keeps(manifest: Mapping[str, Any], table: str) -> bool:
    """Whether a run with this manifest has a table of `schema.TABLES`, or "telemetry", perhaps without rows."""
    return table in _KEPT[level_of(manifest)]


def require_table(folder: Path | str, level: str, table: str) -> None:
    """Raise `InputError` if a run that was recorded at `level` into `folder` does not keep a table."""
    if table in _KEPT[level]:
        return
    enough = " or ".join(f'"{kept_level}"' for kept_level in reversed(LEVELS) if table in _KEPT[kept_level])
    hint = f"It has no {table}. Run it again with --set record.level=full: the fingerprint is the same."
    raise InputError.one(str(folder), "record.level", level, f"a run recorded with [record] level = {enough}", hint)
