"""Reading of the tables of a data set, as they are declared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from skyrange.core.errors import InputError
from skyrange.core.parquet_files import check_ranges, name_damaged_file, read_table
from skyrange.dataset.columns import view_schema
from skyrange.dataset.contents import RUNS
from skyrange.dataset.members import NAME, is_name

_RUN_COLUMNS: Final = pa.schema(
    [
        pa.field("run", pa.string(), nullable=False),
        pa.field("block", pa.string(), nullable=False),
        pa.field("split", pa.string(), nullable=False),
        pa.field("seed", pa.int64(), nullable=False),
        pa.field("repeats", pa.bool_(), nullable=False),
        pa.field("setting", pa.string(), nullable=False),
    ]
)
"""What audits read of the runs."""


_TIMES: Final = (-(2**62), 2**62)
"""Range of times in ns: a window can be added to or subtracted from each of them."""
_EXACT: Final = (-(2**53), 2**53)
"""Range of other integers: audits convert them to doubles."""


def read_view(folder: Path, view: str, path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of a view in the file `path` of the data set in `folder`, all columns or some. Raises `InputError`."""
    schema, where = view_schema(view), str(path.relative_to(folder))
    table = read_table(path, str(folder), where, schema, columns=columns)
    ranges = {
        field.name: _TIMES if field.metadata[b"unit"] == b"ns" else _EXACT
        for field in schema
        if field.type.equals(pa.int64())
    }
    ranges.pop("end_ns", None)  # the last act may have no end
    check_ranges(table, ranges, str(folder), where)
    return table


def read_runs(folder: Path) -> list[dict[str, Any]]:
    """The rows of the runs of a data set, and the flight of each, if it is known. Raises `InputError`."""
    table = read_table(folder / RUNS, str(folder), RUNS, _RUN_COLUMNS)
    every = read_table(folder / RUNS, str(folder), RUNS)
    if "flight" in every.column_names:
        with name_damaged_file(str(folder), RUNS):
            table = table.append_column("flight", every.column("flight").cast(pa.string()))
    rows: list[dict[str, Any]] = table.to_pylist()
    for row in rows:
        if not is_name(row["block"]):
            raise InputError.one(
                str(folder), f"{RUNS}: block", row["block"], NAME, "The file was changed by hand or is damaged."
            )
    return rows
