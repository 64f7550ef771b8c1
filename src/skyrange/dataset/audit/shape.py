"""Shape of what is seen at a place, in seconds from the onset: counts, lengths, intervals and claimed senders."""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.time import Time
from skyrange.dataset.windows import WINDOW_NS

_MEANS: Final = ("valid", "signed")
_SPREADS: Final = ("size", "iat_ms")
_HOW: Final = ("mean", "stddev", "min", "max")
SHAPE: Final = (
    "received", "frames", "bytes", *(f"{name}_{how}" for name in _SPREADS for how in _HOW), *_MEANS, "senders",
    "message_kinds", "sequence_gaps",
)  # fmt: skip
"""Names of the numbers; in all of them a sham equals its attack."""
_PLACE: Final = ("place", "link", "received")


def describe_shape(frames: pa.Table, begin_ns: Time, end_ns: Time) -> pa.Table:
    """A row for each run, place, direction and second of [begin, end), also without frames, with the columns `SHAPE`.

    `frames` are rows of the view `mavlink` in order of time, of at least one run. The last second may be a part of one.
    Attacks often have their effect within a second; the windows of `flows` would be too long for them.
    """
    time_ns = frames.column("time_ns")
    inside = frames.filter(pc.and_(pc.greater_equal(time_ns, begin_ns), pc.less(time_ns, end_ns)))
    latest = int(pc.max(time_ns).as_py() or 0)
    seconds = -(-max(0, min(end_ns, latest + 1) - begin_ns) // WINDOW_NS)
    cells = _every_cell(frames, seconds)
    keys = ["run", *_PLACE, "second"]
    second = pc.cast(pc.divide(pc.subtract(inside.column("time_ns"), begin_ns), WINDOW_NS), pa.int64())
    inside = _mark(inside.append_column("second", second), keys)
    found = inside.group_by(keys).aggregate(
        [
            ("size", "count"), ("size", "sum"), *((name, how) for name in _SPREADS for how in _HOW),
            *((name, "mean") for name in (*_MEANS, "gap")), ("sender", "count_distinct"),
            ("message_id", "count_distinct"),
        ]
    )  # fmt: skip
    renamed = {"size_count": "frames", "size_sum": "bytes", "sender_count_distinct": "senders",
               "message_id_count_distinct": "message_kinds", "gap_mean": "sequence_gaps",
               **{f"{name}_mean": name for name in _MEANS}}  # fmt: skip
    found = found.rename_columns([renamed.get(name, name) for name in found.column_names])
    joined = cells.join(found, keys, join_type="left outer").sort_by([(key, "ascending") for key in keys])
    place = joined.column_names.index("frames")
    return joined.set_column(place, "frames", pc.fill_null(joined.column("frames"), 0))


def _every_cell(frames: pa.Table, seconds: int) -> pa.Table:
    runs = frames.column("run").unique().to_pylist()
    places = frames.group_by(list(_PLACE)).aggregate([]).to_pylist()
    return pa.Table.from_pylist(
        [{"run": run, **place, "second": second} for run in runs for place in places for second in range(seconds)],
        schema=pa.schema([*(frames.schema.field(name) for name in ("run", *_PLACE)), ("second", pa.int64())]),
    )


def _mark(frames: pa.Table, keys: list[str]) -> pa.Table:
    """The frames with the claimed sender, the time since the previous one of the same cell, and whether its sequence
    number does not follow that of its sender's previous one.
    """
    sender = pc.add(pc.multiply(frames.column("system").cast(pa.int32()), 256), frames.column("component"))
    frames = frames.append_column("sender", pc.fill_null(sender, -1))
    frames = frames.sort_by([*((key, "ascending") for key in keys), ("time_ns", "ascending")])
    between = np.diff(frames.column("time_ns").to_numpy(), prepend=0) / 1e6
    between[_is_first(frames, keys)] = np.nan
    frames = frames.append_column("iat_ms", pa.array(between, from_pandas=True))
    frames = frames.sort_by([*((key, "ascending") for key in (*keys[:-1], "sender")), ("time_ns", "ascending")])
    steps = np.diff(pc.fill_null(frames.column("sequence"), 0).to_numpy().astype(np.int64), prepend=0) & 0xFF
    gap = (steps != 1) & ~_is_first(frames, [*keys[:-1], "sender"])
    return frames.append_column("gap", pa.array(gap.astype(np.float64)))


def _is_first(frames: pa.Table, keys: list[str]) -> NDArray[np.bool_]:
    """(n,) whether a row is the first of its equal keys, which stand together."""
    first = np.zeros(frames.num_rows, dtype=np.bool_)
    first[:1] = True
    for key in keys:
        codes = pc.fill_null(frames.column(key).combine_chunks().dictionary_encode().indices, -1).to_numpy()
        first[1:] |= codes[1:] != codes[:-1]
    return first
