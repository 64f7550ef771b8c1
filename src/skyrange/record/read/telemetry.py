"""The `telemetry` table, derived from received frames: one column per MAVLink field, filled message by message."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.codec.mavlink.message_columns import message_columns
from skyrange.record.read.station_frames import (
    MessageSurvey,
    StationFrames,
    name_of,
    numeric_column,
    read_station_frames,
    survey_messages,
    text_column,
)
from skyrange.record.read.tables import Tables
from skyrange.record.schema import BAD_DATA, arrow_schema, telemetry_columns


class ReceivedMessages:
    """The received rows of a block as columns: message names, and by field the values and a mask of absent ones."""

    def __init__(self, block: StationFrames, kinds: dict[str, str]) -> None:
        """`kinds` gives the type of each column: "int", "float" or "text"."""
        self.rows = np.flatnonzero(block.received)
        count = len(self.rows)
        place = np.cumsum(block.received) - 1
        self.block = block
        self.messages = [BAD_DATA]
        self.message: NDArray[np.int32] = np.zeros(count, dtype=np.int32)
        self.system = np.full(count, -1, dtype=np.int32)
        self.component = np.full(count, -1, dtype=np.int32)
        self.values: dict[str, tuple[Any, NDArray[np.bool_]]] = {}
        for group in block.groups(block.received):
            places = place[group.rows]
            self.message[places] = len(self.messages)
            self.messages.append(name_of(group.message_id))
            self.system[places] = group.systems
            self.component[places] = group.components
            for cell in message_columns(group.message_id):
                text = kinds[cell.name] == "text"
                if cell.name not in self.values:
                    empty: Any = np.full(count, None, dtype=object) if text else np.zeros(count)
                    self.values[cell.name] = (empty, np.ones(count, dtype=np.bool_))
                values, absent = self.values[cell.name]
                values[places] = text_column(group, cell) if text else numeric_column(group, cell)
                absent[places] = False

    def vehicles(self) -> pa.Array:
        """The vehicle id of each row."""
        return pa.array(self.block.owners, pa.string()).take(pa.array(self.block.owner[self.rows]))

    def names(self) -> pa.Array:
        """The message name of each row."""
        return pa.array(self.messages, pa.string()).take(pa.array(self.message))


class TelemetryBuilder:
    """Builds rows of `telemetry` with the columns that a survey of the messages found."""

    def __init__(self, found: MessageSurvey) -> None:
        """The schema contains the fields of all operators."""
        self.kinds = found.cells()
        fields = [(name, kind == "text") for name, kind in self.kinds.items()]
        columns = telemetry_columns(fields)
        self.schema = arrow_schema("telemetry", columns)
        fixed = len(columns) - len(fields)
        self._fields = [(name, columns[fixed + place].name) for place, (name, _) in enumerate(fields)]

    def batch(self, block: ReceivedMessages) -> pa.RecordBatch:
        """The rows of one block."""
        names, number = block.block.operators()
        arrays: dict[str, pa.Array] = {
            "time_ns": pa.array(block.block.time_ns[block.rows]),
            "operator": pa.array(names, pa.string()).take(pa.array(number[block.rows])),
            "vehicle": block.vehicles(),
            "system_id": pa.array(block.system, mask=block.message == 0),
            "component_id": pa.array(block.component, mask=block.message == 0),
            "message": block.names(),
        }
        for name, column in self._fields:
            if name not in block.values:
                arrays[column] = pa.nulls(len(block.rows), self.schema.field(column).type)
                continue
            values, absent = block.values[name]
            if self.kinds[name] == "text":
                arrays[column] = pa.array(values.tolist(), pa.string())
            else:
                arrays[column] = pa.array(values, mask=absent)
        return pa.RecordBatch.from_arrays([arrays[name] for name in self.schema.names], schema=self.schema)


def derive_telemetry(tables: Tables) -> pa.Table:
    """The whole `telemetry` table, derived now, for a run that did not end."""
    builder = TelemetryBuilder(survey_messages(tables))
    batches = (builder.batch(ReceivedMessages(block, builder.kinds)) for block in read_station_frames(tables))
    return pa.Table.from_batches(batches, schema=builder.schema)
