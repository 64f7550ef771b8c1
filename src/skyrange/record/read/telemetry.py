"""Telemetry: the messages that ground stations received, one table per MAVLink message, derived from their frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Final

import numpy as np
import pyarrow as pa

from skyrange.codec.mavlink.frames import LAYOUTS
from skyrange.codec.mavlink.message_columns import MessageGroup, message_columns, payload_dtype
from skyrange.contracts.frames import Ints
from skyrange.record.read.station_frames import StationFrames, name_of, read_station_frames, text_column
from skyrange.record.read.tables import BATCH_ROWS, Tables, encoded_schema
from skyrange.record.schema import BAD_DATA, TEXT, Column, arrow_schema, telemetry_columns
from skyrange.record.spool import table_files

FOLDER: Final = "telemetry"
"""The folder of the tables of a run that ended: `telemetry/ATTITUDE.parquet`."""
_IDS: Final = {name_of(number): number for number in LAYOUTS}


def is_message(name: str) -> bool:
    """Whether the dialect has a message of this name, or it is that of undecodable bytes."""
    return name == BAD_DATA or name in _IDS


@cache
def message_schema(message: str) -> pa.Schema:
    """The columns of a message's table: the fields of the message in MAVLink's types and units. Raises `KeyError`."""
    if message == BAD_DATA:
        return arrow_schema(FOLDER)
    number = _IDS[message]
    dtype, units = payload_dtype(number), LAYOUTS[number].cls.fieldunits_by_name
    fields = []
    for cell in message_columns(number):
        kind = TEXT if cell.kind == "text" else pa.from_numpy_dtype(dtype[cell.field].base.newbyteorder("="))
        fields.append(Column(cell.name, kind, units.get(cell.field, ""), f"the field {cell.field} of {message}"))
    return arrow_schema(FOLDER, telemetry_columns(fields))


@cache
def encoded_message_schema(message: str) -> pa.Schema:
    """The columns of a message's table with names as dictionaries. Raises `KeyError`."""
    return encoded_schema(message_schema(message))


def received_messages(block: StationFrames) -> Iterator[tuple[str, pa.RecordBatch]]:
    """The messages in a block of frames, by name, with the rows of each in their order, names as dictionaries."""
    bad = np.flatnonzero(block.received & (block.kinds < 0))
    if len(bad):
        yield BAD_DATA, _batch(BAD_DATA, block, bad, None)
    for group in block.groups(block.received):
        yield name_of(group.message_id), _batch(name_of(group.message_id), block, group.rows, group)


def _batch(message: str, block: StationFrames, rows: Ints, group: MessageGroup | None) -> pa.RecordBatch:
    arrays: list[pa.Array] = [
        pa.array(block.time_ns[rows]),
        _names(block.operators, block.operator[rows]),
        _names(block.owners, block.owner[rows]),
    ]
    if group is None:
        arrays += [pa.nulls(len(rows), pa.int32())] * 2
    else:
        arrays += [pa.array(group.systems.astype(np.int32)), pa.array(group.components.astype(np.int32))]
        for cell in message_columns(group.message_id):
            if cell.kind == "text":
                arrays.append(pa.array(text_column(group, cell), pa.string()))
                continue
            column = group.values[cell.field]
            picked = column if cell.element is None else column[:, cell.element]
            arrays.append(pa.array(np.ascontiguousarray(picked)))
    return pa.RecordBatch.from_arrays(arrays, schema=encoded_message_schema(message))


def _names(names: Sequence[str], numbers: Ints) -> pa.Array:
    return pa.DictionaryArray.from_arrays(pa.array(numbers.astype(np.int32)), pa.array(names, pa.string()))


def count_messages(tables: Tables) -> dict[str, int]:
    """Rows by message, in order of name; of a run that did not end, counted in its frames now."""
    tables.require(FOLDER)
    counts: dict[str, int] = {}
    if tables.spooled:
        for block in read_station_frames(tables):
            for message, batch in received_messages(block):
                counts[message] = counts.get(message, 0) + batch.num_rows
    else:
        for path in (tables.folder / FOLDER).glob("*.parquet"):
            counts[path.stem] = tables.file_rows(f"{FOLDER}/{path.name}")
    return dict(sorted(counts.items()))


def read_message(tables: Tables, message: str) -> pa.Table:
    """The table of a message; of a run that did not end, derived from its frames now. Raises `KeyError` for a name
    that no message of the dialect has.
    """
    schema = message_schema(message)
    tables.require(FOLDER)
    if tables.spooled:
        every = (pair for block in read_station_frames(tables) for pair in received_messages(block))
        batches = [batch for name, batch in every if name == message]
        return pa.Table.from_batches(batches, schema=encoded_message_schema(message)).cast(schema)
    rows = tables.file(f"{FOLDER}/{message}.parquet", schema)
    if rows.num_rows and (np.diff(rows.column("time_ns").to_numpy()) < 0).any():  # parts that overlap in time
        rows = rows.sort_by([("time_ns", "ascending"), ("vehicle", "ascending")])  # stable: an aircraft is in one part
    return rows


def message_batches(tables: Tables, message: str) -> Iterator[pa.RecordBatch]:
    """The rows of `read_message` in batches. Those of one file are not held in memory; those of a run that did not end,
    which are derived now, and those of several parts, which are sorted, are.
    """
    name = f"{FOLDER}/{message}.parquet"
    parts = [] if tables.spooled else table_files((tables.folder / name).absolute())
    if len(parts) == 1:
        tables.require(FOLDER)
        yield from tables.file_batches(name, message_schema(message))
    else:
        yield from read_message(tables, message).to_batches(max_chunksize=BATCH_ROWS)
