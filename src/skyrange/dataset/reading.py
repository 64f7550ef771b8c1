"""Reading of the tables of a data set, as they are declared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from skyrange.core.parquet_files import name_damaged_file, read_table
from skyrange.dataset.columns import view_schema
from skyrange.dataset.contents import RUNS

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


def read_view(folder: Path, view: str, path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of a view in the file `path` of the data set in `folder`, all columns or some. Raises `InputError`."""
    return read_table(path, str(folder), str(path.relative_to(folder)), view_schema(view), columns=columns)


def read_runs(folder: Path) -> list[dict[str, Any]]:
    """The rows of the runs of a data set, and the flight of each, if it is known. Raises `InputError`."""
    table = read_table(folder / RUNS, str(folder), RUNS, _RUN_COLUMNS)
    every = read_table(folder / RUNS, str(folder), RUNS)
    if "flight" in every.column_names:
        with name_damaged_file(str(folder), RUNS):
            table = table.append_column("flight", every.column("flight").cast(pa.string()))
    rows: list[dict[str, Any]] = table.to_pylist()
    return rows
