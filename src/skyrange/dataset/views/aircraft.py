"""View `aircraft`: the state of each aircraft at a fixed rate, as its ground station has received it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.contracts.frames import Ints
from skyrange.core.ids import Port, endpoint, link_name, operator_of
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.dataset.telemetry_fields import AGED, FIELDS
from skyrange.dataset.views.window_labels import WindowLabeller, dropped_at
from skyrange.record.read.run import RunRecord


def describe_aircraft(
    record: RunRecord, rate_hz: float, labeller: WindowLabeller, seen: dict[Port, Ints]
) -> Iterator[pa.Table]:
    """The rows of the view for each aircraft, without its first and last columns.

    A row has the last values received up to its time, and null for what was never received. Windows are the intervals
    between rows. Raises `InputError` for a record without telemetry.
    """
    period_ns = round(NS_PER_S / rate_hz)
    count = from_seconds(record.duration) // period_ns
    end_ns = np.arange(1, count + 1, dtype=np.int64) * period_ns
    messages = {name: record.telemetry(name) for name in {*AGED, *(one.message for one in FIELDS)} & {*record.messages}}
    for row in record.manifest["vehicles"]:
        vehicle = str(row["id"])
        own = {name: table.filter(pc.equal(table.column("vehicle"), vehicle)) for name, table in messages.items()}
        port = Port(endpoint(operator_of(vehicle), "gcs"), link_name("gcs", vehicle))
        missing = dropped_at(labeller.acts, port.link, "rev")
        times = np.sort(np.concatenate([seen.get(port, np.zeros(0, dtype=np.int64)), missing]))
        last = {name: _last(table, end_ns) for name, table in own.items()}
        columns: dict[str, pa.Array] = {"vehicle": pa.array([vehicle] * count, pa.string()), "time_ns": end_ns}
        for one in FIELDS:
            columns[one.column] = pa.nulls(count, pa.float64())
            if one.message in own:
                values = pc.multiply(own[one.message].column(one.field).cast(pa.float64()), one.factor)
                columns[one.column] = _taken(values, last[one.message])
        for name in AGED:
            age = pa.nulls(count, pa.float64())
            if name in own:
                received = _taken(own[name].column("time_ns"), last[name])
                age = pc.divide(pc.subtract(pa.array(end_ns), received).cast(pa.float64()), float(NS_PER_S))
            columns[f"{name.lower()}_age_s"] = age
        # an interval includes its end and not its begin: a frame at the row's time is known in the row
        labels = labeller.columns(vehicle, end_ns - period_ns + 1, end_ns + 1, times)
        yield pa.table({**columns, "window": end_ns // period_ns - 1, **labels})


def _last(table: pa.Table, end_ns: Ints) -> Ints:
    """The row of `table` that is the last one up to each time; -1 for none."""
    rows: Ints = np.searchsorted(table.column("time_ns").to_numpy(), end_ns, side="right") - 1
    return rows


def _taken(column: pa.ChunkedArray, rows: Ints) -> pa.Array:
    taken = column.take(pa.array(rows, mask=rows < 0))
    return taken.combine_chunks() if isinstance(taken, pa.ChunkedArray) else taken
