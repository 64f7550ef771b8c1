"""Frames that each ground station received and sent, as columns derived from the frames on `gcs` links.

The ground station is the first end of a `gcs` link. It received the frames delivered in direction `rev`, and it sent
the frames whose sender in direction `fwd` is `<operator>.gcs`, whether or not they were delivered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.mavlink import decode, encode_payload
from skyrange.codec.mavlink.frames import LAYOUTS
from skyrange.codec.mavlink.message_columns import (
    MessageColumn,
    MessageGroup,
    classify_frames,
    kind_of_message,
    message_columns,
    message_id_of_kind,
    payload_dtype,
    unpack_group,
)
from skyrange.contracts.frames import Fate, Ints, Payloads
from skyrange.core.errors import DecodeError
from skyrange.core.ids import endpoint, operator_of
from skyrange.record.dictionaries import dictionary_array, unify_dictionaries
from skyrange.record.read.tables import Tables
from skyrange.record.read.time_order import sort_by_time

_COLUMNS = ("link", "direction", "sender", "serial", "sent_ns", "arrived_ns", "fate")
_NAMED = ("link", "direction", "sender", "fate")
_KIND = "gcs:"

BLOCK_ROWS = 16_384
"""Number of frames processed at once."""


@dataclass(slots=True)
class StationFrames:
    """Frames at ground stations, one row each, in order of time."""

    time_ns: Ints
    owners: list[str]
    """Vehicle ids, indexed by `owner`."""
    owner: Ints
    received: NDArray[np.bool_]
    payloads: Payloads
    kinds: Ints
    """The message kind of each row (`codec.mavlink.message_columns.classify_frames`), -1 for bytes that are not a
    message."""
    singles: dict[int, tuple[int, int, int, bytes]] = field(default_factory=dict)
    """Rows that only `decode` can read (MAVLink 1): sequence, system, component, complete payload."""
    operators: list[str] = field(init=False)
    """The operators, indexed by `operator`."""
    operator: Ints = field(init=False)
    """The operator of each row."""

    def __post_init__(self) -> None:
        names = [operator_of(owner) for owner in self.owners]
        self.operators = sorted(set(names))
        places = {name: place for place, name in enumerate(self.operators)}
        self.operator = np.array([places[name] for name in names], dtype=np.int64)[self.owner]

    def __len__(self) -> int:
        return len(self.time_ns)

    def groups(self, chosen: NDArray[np.bool_]) -> Iterator[MessageGroup]:
        """The messages of the `chosen` rows, grouped by message id."""
        for kind in np.unique(self.kinds[chosen]).tolist():
            if kind < 0:
                continue
            rows = np.flatnonzero((self.kinds == kind) & chosen)
            singles = [place for place, row in enumerate(rows.tolist()) if row in self.singles] if self.singles else []
            group = unpack_group(self.payloads, kind, rows)
            for place in singles:
                sequence, system, component, body = self.singles[int(rows[place])]
                group.sequences[place], group.systems[place], group.components[place] = sequence, system, component
                group.values[place] = np.frombuffer(body, dtype=payload_dtype(group.message_id))[0]
            yield group


class StationLinks:
    """What the names in the columns of frames say about them; computed anew only when a column has other names."""

    def __init__(self) -> None:
        self._held: dict[str, pa.Array] = {}
        self.owners: list[str] = []
        """The vehicle at the other end of each link's ground station; "" for other links."""
        self.vehicles = pa.array([], pa.string())
        self.owned = np.zeros(1, dtype=np.bool_)
        self.forward = np.zeros(1, dtype=np.bool_)
        self.delivered = np.zeros(1, dtype=np.bool_)
        self.station = np.zeros(1, dtype=np.int64)
        """The number of each link's ground station among the senders; -1 for none."""

    def choose(self, batch: pa.Table) -> tuple[Ints, NDArray[np.bool_], Ints, Ints]:
        """The rows of a batch that are frames at ground stations; of these whether they were received, when, and the
        numbers of their links.
        """
        if not batch.num_rows:
            none = np.zeros(0, dtype=np.int64)
            return none, none.astype(np.bool_), none, none
        link, direction, sender, fate = self.numbers(batch)
        forward = self.forward[direction]
        received = ~forward & self.delivered[fate]
        chosen = np.flatnonzero(self.owned[link] & (received | (forward & (sender == self.station[link]))))
        received = received[chosen]
        arrived, sent = batch.column("arrived_ns").fill_null(0).to_numpy(), batch.column("sent_ns").to_numpy()
        return chosen, received, np.where(received, arrived[chosen], sent[chosen]), link[chosen]

    def numbers(self, batch: pa.Table) -> list[Ints]:
        """The number of each row's link, direction, sender and fate."""
        numbers, changed = [], False
        for name in _NAMED:
            column = dictionary_array(batch.column(name))
            numbers.append(column.indices.to_numpy(zero_copy_only=False))
            if name not in self._held or not self._held[name].equals(column.dictionary):
                self._held[name] = column.dictionary
                changed = True
        if changed:
            self._look_up(*(self._held[name].to_pylist() for name in _NAMED))
        return numbers

    def _look_up(self, links: list[str], directions: list[str], senders: list[str], fates: list[str]) -> None:
        self.owners = [name[len(_KIND) :] if name.startswith(_KIND) else "" for name in links]
        self.vehicles = pa.array(self.owners, pa.string())
        self.owned = np.array([bool(owner) for owner in self.owners], dtype=np.bool_)
        self.forward = np.array([name == "fwd" for name in directions])
        self.delivered = np.array([name == str(Fate.DELIVERED) for name in fates])
        places = {name: number for number, name in enumerate(senders)}
        self.station = np.array(
            [places.get(endpoint(operator_of(owner), "gcs"), -1) if owner else -1 for owner in self.owners]
        )


def _station_frames(tables: Tables) -> Iterator[pa.Table]:
    """Batches of (time_ns, vehicle, received, payload) and the frame's identity, in the order recorded."""
    names = StationLinks()
    for batch in tables.frames_with_payloads(_COLUMNS, encoded=True):
        chosen, received, time_ns, link = names.choose(batch)
        kept = batch.take(pa.array(chosen))
        yield pa.table(
            {
                "time_ns": time_ns,
                "vehicle": names.vehicles.take(pa.array(link)),
                "received": received,
                "payload": kept.column("payload"),
                "link": kept.column("link").cast(pa.string()),
                "direction": kept.column("direction").cast(pa.string()),
                "sender": kept.column("sender").cast(pa.string()),
                "serial": kept.column("serial"),
            }
        )


def _station_times(tables: Tables) -> Iterator[Ints]:
    """The times of the same rows, which take a third as long to read."""
    names = StationLinks()
    for batch in tables.batches("frames", (*_NAMED, "sent_ns", "arrived_ns"), encoded=True):
        yield names.choose(pa.Table.from_batches([batch]))[2]


def select_received(links: StationLinks, frames: pa.Table) -> tuple[Ints, pa.Table]:
    """The rows of encoded frames that ground stations received, and the identity, time and vehicle of each."""
    chosen, received, time_ns, link = links.choose(frames)
    chosen, time_ns, link = chosen[received], time_ns[received], link[received]
    kept = frames.select(["link", "direction", "sender", "serial"]).take(pa.array(chosen))
    owners = pa.DictionaryArray.from_arrays(pa.array(link.astype(np.int32)), links.vehicles)
    return chosen, kept.append_column("time_ns", pa.array(time_ns)).append_column("vehicle", owners)


def sort_received(rows: pa.Table) -> pa.Table:
    """Rows of `select_received` in the order of `read_station_frames`."""
    rows = unify_dictionaries(rows)
    ranks = [_ranks(rows.column(name).chunk(0)) for name in ("sender", "direction", "link")] if rows.num_rows else []
    order = np.lexsort((rows.column("serial").to_numpy(), *ranks, rows.column("time_ns").to_numpy()))
    return rows if (np.diff(order) == 1).all() else rows.take(pa.array(order))


def _ranks(names: pa.DictionaryArray) -> Ints:
    """Numbers that are ordered as the names are."""
    numbers = names.indices.to_numpy()
    used = np.flatnonzero(np.bincount(numbers, minlength=len(names.dictionary)))
    ranks = np.empty(len(names.dictionary), dtype=np.int64)
    ranks[used[pc.array_sort_indices(names.dictionary.take(pa.array(used))).to_numpy()]] = np.arange(len(used))
    row_ranks: Ints = ranks[numbers]
    return row_ranks


def decode_station_frames(rows: pa.Table) -> StationFrames:
    """Frames with the columns `time_ns`, `vehicle`, `payload` and, unless all were received, `received`; decoded."""
    owners, owner = _owners(rows)
    all_received = np.ones(rows.num_rows, dtype=np.bool_)
    received = rows.column("received").to_numpy() if "received" in rows.column_names else all_received
    payloads = payload_column(rows.column("payload"))
    frames = StationFrames(
        rows.column("time_ns").to_numpy(),
        owners,
        owner,
        received,
        payloads,
        classify_frames(payloads).copy(),  # what only `decode` can read is filled in
    )
    for row in np.flatnonzero(frames.kinds < 0).tolist():
        try:
            message = decode(payloads[row])
        except DecodeError:
            continue
        frames.kinds[row] = kind_of_message(message.get_msgId())
        head = (message.get_seq(), message.get_srcSystem(), message.get_srcComponent())
        frames.singles[row] = (*head, encode_payload(message))
    return frames


def _owners(rows: pa.Table) -> tuple[list[str], Ints]:
    """The vehicles of some rows in order, and the number of each row's."""
    vehicles = dictionary_array(rows.column("vehicle"))
    codes = vehicles.indices.to_numpy(zero_copy_only=False)
    used = np.unique(codes)
    names = vehicles.dictionary.take(pa.array(used))
    order = pc.array_sort_indices(names).to_numpy()
    place = np.zeros(len(vehicles.dictionary), dtype=np.int64)
    place[used[order]] = np.arange(len(order))
    return names.take(pa.array(order)).to_pylist(), place[codes]


def payload_column(column: pa.ChunkedArray) -> Payloads:
    """A binary column without nulls as payloads, without copying."""
    if not len(column):
        return Payloads.of([])
    joined = column.chunk(0) if column.num_chunks == 1 else pa.concat_arrays(column.chunks)
    _, offsets, data = joined.buffers()
    ends = np.frombuffer(offsets, dtype=np.int32)[joined.offset : joined.offset + len(joined) + 1].astype(np.int64)
    buffer = np.frombuffer(data, dtype=np.uint8) if data is not None and data.size else np.zeros(0, dtype=np.uint8)
    return Payloads(buffer, ends[:-1], np.diff(ends))


@dataclass(slots=True)
class MessageSurvey:
    """The messages that each operator's ground station received: operator → message ids."""

    operators: dict[str, set[int]] = field(default_factory=dict)

    def cells(self, operator: str | None = None) -> dict[str, str]:
        """Column → "int", "float" or "text", ordered by message name and then as each message lists its fields.

        A column that is text in one message and a number in another is text; a column that is float in any is float.
        """
        ids = self.operators.get(operator, set()) if operator is not None else set().union(*self.operators.values())
        union: dict[str, str] = {}
        for message_id in sorted(ids, key=name_of):
            for cell in message_columns(message_id):
                union[cell.name] = max(union.get(cell.name, "int"), cell.kind, key=_RANK.__getitem__)
        return union

    def units(self) -> dict[tuple[str, str], str]:
        """The units that the dialect declares, by (message, column)."""
        return {
            (name_of(message_id), cell.name): LAYOUTS[message_id].cls.fieldunits_by_name.get(cell.field, "")
            for message_id in set().union(*self.operators.values())
            for cell in message_columns(message_id)
        }


_RANK = {"int": 0, "float": 1, "text": 2}


def name_of(message_id: int) -> str:
    """The name of a message."""
    return str(LAYOUTS[message_id].cls.msgname)


def survey_messages(tables: Tables) -> MessageSurvey:
    """Determine the messages that occur, in one pass over all frames."""
    survey = MessageSurvey()
    for batch in _station_frames(tables):
        block = decode_station_frames(batch.filter(batch.column("received")))
        for operator, name in enumerate(block.operators):
            kinds = np.unique(block.kinds[(block.operator == operator) & (block.kinds >= 0)])
            if len(kinds):
                survey.operators.setdefault(name, set()).update(message_id_of_kind(kind) for kind in kinds.tolist())
    return survey


def read_station_frames(tables: Tables, block_rows: int = BLOCK_ROWS) -> Iterator[StationFrames]:
    """Blocks of frames received and sent by ground stations, in order of time, then of link, direction and frame."""
    ties = ("link", "direction", "sender", "serial")
    pending: list[pa.Table] = []
    rows = 0
    for ordered in sort_by_time(lambda: _station_frames(tables), "time_ns", ties, lambda: _station_times(tables)):
        pending.append(ordered)
        rows += ordered.num_rows
        if rows >= block_rows:
            joined = pa.concat_tables(pending)
            ready = rows - rows % block_rows
            for start in range(0, ready, block_rows):
                yield decode_station_frames(joined.slice(start, block_rows))
            pending, rows = [joined.slice(ready)], rows - ready
    if rows:
        yield decode_station_frames(pa.concat_tables(pending))


def text_of(raw: bytes) -> str:
    """A text field as pymavlink reads it: up to the first zero byte, with non-ASCII bytes replaced."""
    return raw.split(b"\0", 1)[0].decode("ascii", "replace")


def numeric_column(group: MessageGroup, cell: MessageColumn) -> NDArray[np.float64]:
    """One numeric column of a group of messages."""
    column = group.values[cell.field]
    picked: NDArray[np.float64] = (column if cell.element is None else column[:, cell.element]).astype(np.float64)
    return picked


def text_column(group: MessageGroup, cell: MessageColumn) -> list[str]:
    """One column of a group of messages as text."""
    column = group.values[cell.field] if cell.element is None else group.values[cell.field][:, cell.element]
    return [text_of(value) if isinstance(value, bytes) else str(value) for value in column.tolist()]
