"""What did each ground station receive and send? Telemetry, CSV and tlog, derived from the frames on `gcs` links.

A `gcs` link's first end is the ground station: frames delivered in direction `rev` are what it received,
frames that `<operator>.gcs` itself sent in direction `fwd` are what it sent, whatever became of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.agent.frames import Fate
from skyrange.codec.mavlink import Message, decode, describe, message_id
from skyrange.core.errors import DecodeError
from skyrange.core.ids import endpoint, operator_of
from skyrange.record.order import in_order
from skyrange.record.schema import BAD_DATA, arrow_schema, telemetry_columns
from skyrange.record.tables import Tables

_COLUMNS = ("link", "direction", "sender", "serial", "sent_ns", "arrived_ns", "fate")
_KIND = "gcs:"

BLOCK_ROWS = 8_192
"""Decoded messages held at once, about 1.3 kB each."""


class Seen(NamedTuple):
    """One frame at a ground station; `message` is `None` where its bytes are no MAVLink frame."""

    time_ns: int
    vehicle: str
    received: bool
    payload: bytes
    message: Message | None


@dataclass(slots=True)
class Survey:
    """Which messages each operator's ground station received: operator → message name → its fields.

    Fields are (name, is text) in the message's order; `units` has the dialect's unit by (message, field).
    """

    operators: dict[str, dict[str, list[tuple[str, bool]]]] = field(default_factory=dict)
    units: dict[tuple[str, str], str] = field(default_factory=dict)

    def fields(self, operators: Sequence[str] | None = None) -> list[tuple[str, bool]]:
        """The union of fields as (name, is text), by name of message, then as each message lists them.

        A field that is text in one message and a number in another is text.
        """
        union: dict[str, bool] = {}
        messages: dict[str, list[tuple[str, bool]]] = {}
        for operator in sorted(self.operators) if operators is None else operators:
            messages |= self.operators.get(operator, {})
        for name in sorted(messages):
            for column, text in messages[name]:
                union[column] = union.get(column, False) or text
        return list(union.items())


def decoded(payload: bytes) -> Message | None:
    """The message, or `None` for bytes that are none."""
    try:
        return decode(payload)
    except DecodeError:
        return None


def _station_frames(tables: Tables) -> Iterator[pa.Table]:
    """Batches of (time_ns, vehicle, received, payload) with the rest of the frame's identity, as recorded."""
    for batch in tables.frames_with_payloads(_COLUMNS):
        batch = batch.filter(pc.starts_with(batch.column("link"), _KIND))
        links = batch.column("link").combine_chunks().dictionary_encode()
        owners = [name[len(_KIND) :] for name in links.dictionary.to_pylist()]
        stations = pa.array([endpoint(operator_of(owner), "gcs") for owner in owners], pa.string()).take(links.indices)
        forward = pc.equal(batch.column("direction"), "fwd")
        received = pc.and_(pc.invert(forward), pc.equal(batch.column("fate"), str(Fate.DELIVERED)))
        sent = pc.and_(forward, pc.equal(batch.column("sender"), stations))
        time_ns = pc.if_else(received, batch.column("arrived_ns"), batch.column("sent_ns"))
        rows = pa.table(
            {
                "time_ns": time_ns,
                "vehicle": pa.array(owners, pa.string()).take(links.indices),
                "received": received,
                "payload": batch.column("payload"),
                "link": batch.column("link"),
                "direction": batch.column("direction"),
                "sender": batch.column("sender"),
                "serial": batch.column("serial"),
            }
        )
        yield rows.filter(pc.or_(received, sent))


def survey(tables: Tables) -> Survey:
    """One reading of all frames: which messages there are, by an example of each that decodes."""
    found = Survey()
    known: set[tuple[str, int | None]] = set()
    for batch in _station_frames(tables):
        rows = batch.filter(batch.column("received"))
        pairs = zip(rows.column("vehicle").to_pylist(), rows.column("payload").to_pylist(), strict=True)
        for vehicle, payload in pairs:
            mark = (operator_of(vehicle), message_id(payload))
            if mark in known or mark[1] is None:
                continue
            message = decoded(payload)
            if message is not None:
                known.add(mark)
                _learn(found, mark[0], message)
    return found


def _learn(found: Survey, operator: str, message: Message) -> None:
    messages = found.operators.setdefault(operator, {})
    name = message.get_type()
    if name not in messages:
        messages[name] = [(column, isinstance(value, str)) for column, value in describe(message).items()]
        units = type(message).fieldunits_by_name
        for column, _ in messages[name]:
            found.units[name, column] = units.get(column.split("[")[0], "")


def seen(tables: Tables) -> Iterator[list[Seen]]:
    """Blocks of what the ground stations received and sent, in order of time, then of link, direction and frame."""
    for ordered in in_order(lambda: _station_frames(tables), "time_ns", ("link", "direction", "sender", "serial")):
        for start in range(0, ordered.num_rows, BLOCK_ROWS):
            block = ordered.slice(start, BLOCK_ROWS)
            columns = [block.column(name).to_pylist() for name in ("time_ns", "vehicle", "received", "payload")]
            yield [Seen(at, who, got, data, decoded(data)) for at, who, got, data in zip(*columns, strict=True)]


class TelemetryBuilder:
    """Makes `telemetry` rows of what was received, under the columns that a survey found."""

    def __init__(self, found: Survey) -> None:
        """The schema holds the fields of all operators."""
        fields = found.fields()
        columns = telemetry_columns(fields)
        self.schema = arrow_schema("telemetry", columns)
        fixed = len(columns) - len(fields)
        self._fields = [(name, text, columns[fixed + place].name) for place, (name, text) in enumerate(fields)]

    def batch(self, received: Sequence[tuple[Seen, dict[str, int | float | str]]]) -> pa.RecordBatch:
        """Rows of one block; each comes with its described fields, empty for bytes that are no message."""
        rows = len(received)
        filled: dict[str, tuple[list[int], list[int | float | str]]] = {}
        for row, (_, values) in enumerate(received):
            for name, value in values.items():
                places, cells = filled.setdefault(name, ([], []))
                places.append(row)
                cells.append(value)
        messages = [item.message for item, _ in received]
        arrays: dict[str, pa.Array] = {
            "time_ns": pa.array([item.time_ns for item, _ in received], pa.int64()),
            "operator": pa.array([operator_of(item.vehicle) for item, _ in received], pa.string()),
            "vehicle": pa.array([item.vehicle for item, _ in received], pa.string()),
            "system_id": pa.array([None if m is None else m.get_srcSystem() for m in messages], pa.int32()),
            "component_id": pa.array([None if m is None else m.get_srcComponent() for m in messages], pa.int32()),
            "message": pa.array([BAD_DATA if m is None else m.get_type() for m in messages], pa.string()),
        }
        for name, text, column in self._fields:
            places, cells = filled.get(name, ([], []))
            arrays[column] = _texts(rows, places, cells) if text else _numbers(rows, places, cells)
        return pa.RecordBatch.from_arrays([arrays[name] for name in self.schema.names], schema=self.schema)


def _numbers(rows: int, places: list[int], cells: list[int | float | str]) -> pa.Array:
    values = np.zeros(rows)
    absent = np.ones(rows, dtype=bool)
    values[places] = cells
    absent[places] = False
    return pa.array(values, mask=absent)


def _texts(rows: int, places: list[int], cells: list[int | float | str]) -> pa.Array:
    values: list[str | None] = [None] * rows
    for place, cell in zip(places, cells, strict=True):
        values[place] = str(cell)
    return pa.array(values, pa.string())


def described(block: Sequence[Seen]) -> list[tuple[Seen, dict[str, int | float | str]]]:
    """The received frames of a block with their fields."""
    return [(item, describe(item.message) if item.message is not None else {}) for item in block if item.received]


def telemetry(tables: Tables) -> pa.Table:
    """The whole `telemetry` table, derived now: for a run that never came to its end."""
    builder = TelemetryBuilder(survey(tables))
    return pa.Table.from_batches((builder.batch(described(block)) for block in seen(tables)), schema=builder.schema)
