"""Check of the rows that a finished block stored: its tables, their columns, and that they are of this block."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Final, get_type_hints

import pyarrow as pa
from pydantic import BaseModel, ConfigDict, create_model

from skyrange.core.errors import InputError
from skyrange.core.typed_json import Count, Int64, require_type
from skyrange.metrics.aircraft import Measured
from skyrange.study.columns import column_of
from skyrange.study.design.blocks import Block
from skyrange.study.design.model import Study
from skyrange.study.measurement import ACTS, AIRCRAFT, ALERTS, EFFECTS, RUNS, TABLES, WITHOUT, Rows
from skyrange.study.run_measures import QUANTITIES
from skyrange.twins.effects import COLUMNS as EFFECT_COLUMNS

_HINT: Final = "Delete it and resume."


def check_rows(rows: Any, block: Block, study: Study, who: str) -> Rows:
    """The stored rows of a block, if they are what `measurement.measure_block` makes of it.

    Raises `InputError` in the name of `who` for tables, columns or values of other types, and for rows of another block
    or arm.
    """
    where = f"blocks/{block.name}.json: data"
    require_type(rows, _tables_model(), who, where, hint=_HINT)
    arms = {arm.id for arm in study.arms}
    head = {"block": block.name, "point": block.point, "seed": block.seed}
    for table in TABLES:
        for place, row in enumerate(rows[table]):
            wrong = [name for name, value in head.items() if row[name] != value]
            wrong += [name for name in block.values if name not in row]
            if row["arm"] not in arms or wrong:
                value = ", ".join(f"{name} {row.get(name)!r}" for name in ("arm", *wrong))
                raise InputError.one(who, f"{where}.{table}.{place}", value, f"a row of {block.name}", _HINT)
    checked: Rows = rows
    return checked


@cache
def _tables_model() -> type[BaseModel]:
    """A model with a list of rows for each table."""
    text, number, maybe = (str, ...), (float, ...), (float | None, None)
    measures = {column_of(quantity.name): maybe for quantity in QUANTITIES}
    run = {
        **dict.fromkeys(("error", "failed_missions", "families", "fingerprint"), (str, "")),
        **dict.fromkeys(("city", "flight"), (str | None, None)),
        "simulated_s": maybe,
        "vehicles": (Count, 0),
    }
    hints = get_type_hints(Measured)
    aircraft = {name: (kind, ...) for name, kind in hints.items()} | {"airborne_s": number, "takeoff_s": maybe}
    effect = {column.name: _field_of(column.type) for column in EFFECT_COLUMNS if column.name not in WITHOUT}
    alert = {"time_s": number, "detector": text, "kind": text, "subject": text, "score": number}
    act = {"attack": text, "kind": text, "family": text, "vehicle": text, "fault": (bool, ...),
           "harmless_intrusion": (bool, ...), "first_s": number, "last_s": number, "effect_end_s": number,
           "acts": (Count, ...)}  # fmt: skip
    rows = {
        RUNS: _row_model(RUNS, {"status": text, **run, **measures}),
        AIRCRAFT: _row_model(AIRCRAFT, aircraft),
        EFFECTS: _row_model(EFFECTS, {"against": (str, ""), **effect, "vehicle": text}),
        ALERTS: _row_model(ALERTS, alert),
        ACTS: _row_model(ACTS, act),
    }
    tables: Mapping[str, Any] = {table: (list[row], ...) for table, row in rows.items()}  # type: ignore[valid-type]
    return create_model("StoredRows", __config__=ConfigDict(strict=True, extra="forbid"), **tables)


def _row_model(table: str, columns: Mapping[str, Any]) -> Any:
    """Rows of a table; values of factors, whose columns are not declared, are of any kind."""
    head: Mapping[str, Any] = {"block": (str, ...), "point": (Int64, ...), "seed": (Int64, ...), "arm": (str, ...)}
    return create_model(table, __config__=ConfigDict(strict=True, extra="allow"), **head, **columns)


def _field_of(kind: pa.DataType) -> tuple[Any, Any]:
    """A value that may be absent, as those of every effect are that a block has not."""
    value: Any = Int64 if pa.types.is_integer(kind) else float if pa.types.is_floating(kind) else str
    return value | None, None
