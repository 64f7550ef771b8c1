"""Columns of all views (type, unit, meaning, observable or not), and the MAVLink field behind each of `aircraft`.

`columns.csv` and `telemetry_fields.csv` have them; the columns of `remote_id` are those of the record's observations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.errors import ComponentError
from skyrange.core.files import read_package_table
from skyrange.record.schema import NAME, TABLES, TEXT, Column, read_columns


class TelemetryField(NamedTuple):
    """One column: `field` of `message` times `factor`."""

    column: str
    message: str
    field: str
    unit: str
    factor: float


FIELDS: Final = tuple(
    TelemetryField(row["column"], row["message"], row["field"], row["unit"], float(row["factor"]))
    for row in read_package_table(__file__, "telemetry_fields.csv")
)
"""What columns of `aircraft` are read from. EKF_STATUS_REPORT holds the estimator's innovations as test ratios: 1 is
the limit of the gate."""

AGED: Final = ("HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE", "GPS_RAW_INT", "EKF_STATUS_REPORT")
"""Messages whose age is a column."""

ESTIMATES: Final = frozenset(
    {
        "AHRS", "AHRS2", "ATTITUDE", "ATTITUDE_QUATERNION", "EKF_STATUS_REPORT", "GLOBAL_POSITION_INT", "GPS_RAW_INT",
        "GPS2_RAW", "LOCAL_POSITION_NED", "NAV_CONTROLLER_OUTPUT", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2",
        "SCALED_IMU3", "SCALED_PRESSURE", "SCALED_PRESSURE2", "VFR_HUD", "VIBRATION",
    }
)  # fmt: skip
"""Messages that tell sensor readings or what the estimator makes of them."""


Role = Literal["observable", "bookkeeping", "label"]
"""observable: known at the sensor's place. bookkeeping: ids and positions in the data set. label: what is to be
found. A detector may use observable columns only."""


@dataclass(frozen=True, slots=True)
class ViewColumn(Column):
    """One column of a view; `unit` is "" for names and counts."""

    role: Role


_COLUMNS: Final = read_columns(__file__, "columns.csv", ViewColumn)

RUN_COLUMNS: Final = _COLUMNS["run"]
"""Begin every view."""

WINDOW_COLUMNS: Final = _COLUMNS["window"]
"""End every view of a sensor, before its labels."""

FRAME_LABELS: Final = (*_COLUMNS["frame_labels"], *_COLUMNS["author"])
"""Labels of views with a row for each frame."""

WINDOW_LABELS: Final = (*_COLUMNS["window_labels"], *_COLUMNS["author"])
"""Labels of views with a row for each window."""


def _received(name: str, unit: str, meaning: str) -> ViewColumn:
    """An observable column of `aircraft`, null until the message was received."""
    return ViewColumn(name, pa.float64(), unit, meaning, "observable", nullable=True)


_AIRCRAFT = (
    *_COLUMNS["aircraft"],
    *(_received(field.column, field.unit, f"last {field.message}.{field.field} received") for field in FIELDS),
    *(_received(f"{name.lower()}_age_s", "s", f"time since the last {name} was received") for name in AGED),
)

_HIDDEN: Final = frozenset({"receiver", "frame", "radio"})
_REMOTE_ID = tuple(
    ViewColumn(
        column.name,
        NAME if column.type == TEXT else column.type,
        column.unit,
        column.meaning,
        "bookkeeping" if column.name in _HIDDEN else "observable",
        nullable=column.nullable,
    )
    for column in TABLES["observations"]
)

VIEWS: Final[dict[str, tuple[ViewColumn, ...]]] = {
    "mavlink": (*RUN_COLUMNS, *_COLUMNS["mavlink"], *WINDOW_COLUMNS, *FRAME_LABELS),
    "flows": (*RUN_COLUMNS, *_COLUMNS["flows"], *WINDOW_COLUMNS, *WINDOW_LABELS, *_COLUMNS["flow_labels"]),
    "aircraft": (*RUN_COLUMNS, *_AIRCRAFT, *WINDOW_COLUMNS, *WINDOW_LABELS),
    "remote_id": (*RUN_COLUMNS, *_REMOTE_ID, *WINDOW_COLUMNS, *FRAME_LABELS),
    "approval": (*RUN_COLUMNS, *_COLUMNS["approval"], *WINDOW_COLUMNS, *FRAME_LABELS),
    "episodes": (*RUN_COLUMNS, *_COLUMNS["episodes"]),
}
"""By view, its columns in order."""

WINDOW_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "mavlink": ("link", "place"),
    "flows": ("link", "place", "received"),
    "aircraft": ("vehicle",),
    "remote_id": ("receiver",),
    "approval": ("link", "place"),
}
"""By view of a sensor, the columns that tell its places; windows of one place are compared between runs."""


def view_schema(view: str) -> pa.Schema:
    """The Arrow schema of a view, with unit, meaning and role as metadata of each field."""
    return pa.schema(
        [
            pa.field(
                column.name,
                column.type,
                column.nullable,
                {"unit": column.unit, "meaning": column.meaning, "role": column.role},
            )
            for column in VIEWS[view]
        ]
    )


def observable_columns(view: str) -> list[str]:
    """The columns of a view that a sensor at the place knows; only these are inputs of a detector."""
    return [column.name for column in VIEWS[view] if column.role == "observable"]


def check_table(view: str, table: pa.Table) -> pa.Table:
    """The table with the declared order and types.

    Raises `ComponentError` for a column that is missing or not declared, of another type, or null where it must not be.
    """
    declared = {view_column.name: view_column for view_column in VIEWS[view]}
    wrong = set(declared) ^ set(table.column_names)
    if wrong:
        raise ComponentError(f"view {view}", f"columns {sorted(wrong)} are declared or written, but not both")
    for view_column in declared.values():
        column = table.column(view_column.name)
        if column.type != view_column.type:
            raise ComponentError(
                f"view {view}", f"column {view_column.name} is {column.type}; {view_column.type} is declared"
            )
        if column.null_count and not view_column.nullable:
            raise ComponentError(
                f"view {view}", f"column {view_column.name} has null in {pc.sum(column.is_null())} rows"
            )
    return table.select(list(declared)).cast(view_schema(view))
