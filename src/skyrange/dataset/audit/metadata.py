"""Metadata of a run's rows, as an audit compares them: counts, identifiers, time grid and precision of values."""

from __future__ import annotations

import re
from hashlib import blake2b
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.dataset.columns import VIEWS, observable_columns

IDENTIFIERS: Final = ("src", "dst", "system", "component", "mac", "uas_id", "operator_id", "transport", "channel")
"""Observable columns with ids and addresses."""
_GRIDS_NS: Final = {"1 us": 1_000, "1 ms": 1_000_000, "10 ms": 10_000_000}
_DIGITS: Final = 8
_SAMPLE: Final = 500
_NUMBER: Final = re.compile(r"\d+")


def describe_metadata(view: str, table: pa.Table, before: pa.Table) -> dict[str, float]:
    """Numbers on the form of a run's rows, by name: none is on what they tell of the flight.

    The precision of values is that of the rows `before` the onset: from then on they tell other things, which need
    other decimals.
    """
    times = table.column("time_ns").to_numpy()
    row = {
        f"{view} rows": float(table.num_rows),
        f"{view} bytes": float(sum(_length(table.column(name)) for name in observable_columns(view))),
    }
    if len(times):
        row[f"{view}.time_ns first"] = float(times.min())
        row[f"{view}.time_ns offset"] = float(np.mean(times % max(_GRIDS_NS.values())))
        row |= {f"{view}.time_ns on {name}": float(np.mean(times % grid == 0)) for name, grid in _GRIDS_NS.items()}
    for one in VIEWS[view]:
        if one.role != "observable" or not table.num_rows:
            continue
        found: dict[str, float] = {}
        if one.name in IDENTIFIERS:
            found = _describe_identifiers(table.column(one.name))
        elif pa.types.is_floating(one.type):
            found = _describe_precision(before.column(one.name))
        row |= {f"{view}.{one.name} {what}": value for what, value in found.items()}
    return row


def _describe_identifiers(column: pa.ChunkedArray) -> dict[str, float]:
    """How many different ones, their mean length, their mean number, such as that of a port, and which set they are."""
    different: list[Any] = sorted(value for value in pc.unique(column).to_pylist() if value is not None)
    texts = [str(value) for value in different]
    numbers = [float(found[-1]) for text in texts if (found := _NUMBER.findall(text))]
    return {
        "different": float(len(different)),
        "length": float(np.mean([len(text) for text in texts])) if texts else 0.0,
        "number": float(np.mean(numbers)) if numbers else float("nan"),
        "values": float(int.from_bytes(blake2b("\0".join(texts).encode(), digest_size=6).digest())),
    }


def _describe_precision(column: pa.ChunkedArray) -> dict[str, float]:
    """The mean number of decimals that values need, up to 8, and the share that fits in single precision; not a number
    without values.
    """
    values = column.drop_null().cast(pa.float64()).to_numpy()
    values = values[np.isfinite(values)]
    values = values[:: max(1, len(values) // _SAMPLE)]
    if not len(values):
        return {"decimals": float("nan"), "single precision": float("nan")}
    needed = np.full(len(values), _DIGITS)
    for digits in range(_DIGITS - 1, -1, -1):
        needed[np.abs(np.round(values, digits) - values) < 10.0**-_DIGITS] = digits
    with np.errstate(over="ignore"):
        single = values.astype(np.float32).astype(np.float64) == values
    return {"decimals": float(needed.mean()), "single precision": float(single.mean())}


def _length(column: pa.ChunkedArray) -> int:
    """The bytes of all texts of a column; other columns have the same length for each value."""
    if not (pa.types.is_string(column.type) or pa.types.is_binary(column.type)):
        return 0
    return int(pc.sum(pc.binary_length(column)).as_py() or 0)
