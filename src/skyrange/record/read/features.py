"""The `features` table: the frames of each directed link in each interval, counted.

At level `study` frames are counted while they are recorded, and this module adds up the counts; at level `full` it
counts the recorded frames on request.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.contracts.frames import Fate
from skyrange.core.time import Time, from_seconds
from skyrange.record.message_groups import GROUPS, group_messages
from skyrange.record.read.station_frames import payload_column
from skyrange.record.read.tables import Tables
from skyrange.record.read.time_order import sort_by_time
from skyrange.record.schema import arrow_schema

FATE_COLUMNS: Final = tuple(str(fate) for fate in Fate)
"""The columns with the number of frames of each fate, in the order of `Fate`."""

_SCHEMA: Final = arrow_schema("features")
_KEY: Final = ("time_ns", "link", "direction")
_MAX: Final = "latency_max_ns"
_SUMS: Final = [name for name in _SCHEMA.names if name not in (*_KEY, _MAX)]
_FRAME_COLUMNS: Final = ("link", "direction", "sent_ns", "arrived_ns", "fate", "size")


def features_period_ns(manifest: Mapping[str, Any]) -> Time:
    """The length of an interval by a run's manifest."""
    return from_seconds(1.0 / manifest["record"]["features_hz"])


def merge_features(tables: Tables) -> Iterator[pa.Table]:
    """The recorded counts with one row for each directed link and interval, in order of time, link and direction."""

    def recorded() -> Iterator[pa.Table]:
        return (pa.Table.from_batches([batch]) for batch in tables.batches("features"))

    for table in sort_by_time(recorded, _KEY[0], _KEY[1:]):
        yield _add_up(table)


def count_features(tables: Tables, period_ns: Time) -> pa.Table:
    """The whole table, counted in recorded frames; in memory."""
    parts = [_add_up(_describe(frames, period_ns)) for frames in tables.frames_with_payloads(_FRAME_COLUMNS)]
    counted = pa.concat_tables([_SCHEMA.empty_table(), *parts])
    return _add_up(counted)


def _describe(frames: pa.Table, period_ns: Time) -> pa.Table:
    """Frames as rows of `features` that count one frame each."""
    rows = frames.num_rows
    sent = frames.column("sent_ns").to_numpy()
    latency = pc.subtract(frames.column("arrived_ns"), frames.column("sent_ns"))
    delivered = pc.equal(frames.column("fate"), str(Fate.DELIVERED))
    latency = pc.if_else(delivered, latency, pa.scalar(None, pa.int64()))
    group = group_messages(payload_column(frames.column("payload")))
    columns = {
        "time_ns": pa.array(sent // period_ns * period_ns),
        "link": frames.column("link"),
        "direction": frames.column("direction"),
        "sent": pa.array(np.ones(rows, dtype=np.int32)),
        **{name: pc.equal(frames.column("fate"), name).cast(pa.int32()) for name in FATE_COLUMNS},
        "size_bytes": frames.column("size"),
        "latency_sum_ns": pc.fill_null(latency, 0),
        _MAX: latency,
        **{name: pa.array((group == place).astype(np.int32)) for place, name in enumerate(GROUPS, 1)},
    }
    return pa.table(columns)


def _add_up(rows: pa.Table) -> pa.Table:
    """Rows of which those with the same key become one, in the order of their keys."""
    wanted = [*((name, "sum") for name in _SUMS), (_MAX, "max")]
    sums = rows.group_by(list(_KEY), use_threads=False).aggregate(wanted)
    sums = sums.sort_by([(name, "ascending") for name in _KEY])
    return pa.table(
        {name: sums.column(_aggregated(name)).cast(_SCHEMA.field(name).type) for name in _SCHEMA.names},
        schema=_SCHEMA,
    )


def _aggregated(name: str) -> str:
    return name if name in _KEY else f"{name}_max" if name == _MAX else f"{name}_sum"
