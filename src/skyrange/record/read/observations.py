"""The `observations` table, derived from receptions and frames: what each receiver decoded, field by field.

A receiver knows only claims: address, identity and position are those that the broadcast states. The columns `frame`
and `radio` say which frame was transmitted by whom; they join a row with labels and truth.

Decoded receptions are joined with the broadcasts that were transmitted. A row of `receptions` names the frame on
`rid_up` that was transmitted; the body that a receiver decodes is that frame's. Both tables are read once, side by
side, with bounded memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.f3411 import BasicId, MessageType
from skyrange.codec.f3411.broadcast_columns import NO_MESSAGE, BroadcastColumns, decode_broadcasts
from skyrange.codec.f3411.columns import CODES, NUMBERS
from skyrange.codec.remote_id.link_payload import RidColumns, unpack_rows
from skyrange.contracts.frames import Ints, Payloads
from skyrange.core.geodesy import Origin
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.record.dictionaries import dictionary_array
from skyrange.record.read.station_frames import payload_column
from skyrange.record.read.tables import Tables, combine_batches
from skyrange.record.schema import arrow_schema

RADIO_LINK: Final = "rid_up:"
"""Prefix of the links from radios to the medium; the rest of the name is the radio."""

DECODED: Final = "decoded"
"""The outcome of a reception whose receiver got every byte."""

KEPT_NS: Final[Time] = 60 * NS_PER_S
"""How long a frame is kept after its arrival at the medium. The builtin medium transmits within half a second."""

AHEAD_NS: Final[Time] = NS_PER_S
"""Frames are recorded nearly in order of time: those of the last second of a batch may be recorded a little later."""

RECEPTION_COLUMNS: Final = (
    "time_ns", "link", "direction", "sender", "serial", "receiver", "east_m", "north_m", "up_m", "transport", "channel",
    "rssi_dbm", "outcome",
)  # fmt: skip
FRAME_COLUMNS: Final = ("link", "direction", "sender", "serial", "sent_ns", "arrived_ns")
"""The columns of frames that are needed to find those that were transmitted, besides their payloads."""

_BATCH_ROWS: Final = 16_384
_SERIAL_BITS: Final = 40
"""A key is the number of a flow, then the serial number; a flow is a link, a direction and a sender."""


@dataclass(frozen=True, slots=True)
class DecodedReceptions:
    """Some decoded receptions, with the frames that were transmitted."""

    rows: pa.Table
    """n rows of `receptions` with `RECEPTION_COLUMNS`, in the order recorded."""
    place: Ints
    """(n,) the frame of each row in `payloads`; -1 if the record does not have the frame."""
    payloads: Payloads
    """Payloads of the frames, in the format of `codec.remote_id.link_payload`; each frame once."""


def read_decoded_receptions(
    tables: Tables, receivers: Sequence[str] | None = None, batch_rows: int = _BATCH_ROWS
) -> Iterator[DecodedReceptions]:
    """The decoded receptions in the order recorded, `batch_rows` or more at a time; `receivers` limits the receivers.

    Frames are not read if there are no receptions.
    """
    wanted = None if receivers is None else pa.array(list(receivers), pa.string())
    transmissions = Transmissions()
    frames: Iterator[pa.Table] | None = None
    for rows in combine_batches(_decoded(tables, wanted), batch_rows):
        if frames is None:
            frames = tables.frames_with_payloads(FRAME_COLUMNS, encoded=True)
        until = latest_frame_ns(rows)
        while transmissions.read_ns <= until and (batch := next(frames, None)) is not None:
            transmissions.add(batch)
        yield transmissions.join(rows)


def _decoded(tables: Tables, receivers: pa.Array | None) -> Iterator[pa.RecordBatch]:
    for batch in tables.batches("receptions", RECEPTION_COLUMNS):
        rows = decoded_rows(batch)
        if receivers is not None:
            rows = rows.filter(pc.is_in(rows.column("receiver"), value_set=receivers))
        yield rows


def decoded_rows(batch: pa.RecordBatch) -> pa.RecordBatch:
    """The rows of receptions whose receiver got every byte, with `RECEPTION_COLUMNS`."""
    return batch.select(list(RECEPTION_COLUMNS)).filter(pc.equal(batch.column("outcome").cast(pa.string()), DECODED))


def latest_frame_ns(receptions: pa.Table) -> Time:
    """The time of sending by which all frames that receptions may name were recorded."""
    return int(pc.max(receptions.column("time_ns")).as_py()) + AHEAD_NS


@dataclass(frozen=True, slots=True)
class _Batch:
    """Frames that were read together."""

    keys: Ints
    payloads: pa.ChunkedArray
    last_ns: Time
    """Latest arrival."""


class Transmissions:
    """The frames on `rid_up` that receptions may name; the window moves forward with the receptions."""

    def __init__(self) -> None:
        self.read_ns: Time = -NEVER
        """The latest time of sending so far."""
        self._held: list[_Batch] = []
        self._flows: dict[tuple[str, str, str], int] = {}

    def add(self, frames: pa.Table) -> None:
        """Add frames with `FRAME_COLUMNS` and their payloads, in the order recorded."""
        if frames.num_rows:
            self.read_ns = max(self.read_ns, pc.max(frames.column("sent_ns")).as_py())
            self.add_foreign(frames)

    def add_foreign(self, frames: pa.Table) -> None:
        """Add such frames that another process records: how far this one has recorded they do not tell."""
        rows = frames.filter(is_transmission(frames))
        if rows.num_rows:
            times = pc.coalesce(rows.column("arrived_ns"), rows.column("sent_ns"))
            self._held.append(_Batch(self._keys(rows), rows.column("payload"), pc.max(times).as_py()))

    def join(self, receptions: pa.Table) -> DecodedReceptions:
        """The frames of receptions, which are later than all joined before or at most `KEPT_NS` earlier."""
        rows = receptions.combine_chunks()
        self.drop(int(pc.min(rows.column("time_ns")).as_py()) - KEPT_NS)
        payloads, place = self._find(rows)
        return DecodedReceptions(rows, place, payloads)

    def drop(self, before: Time) -> None:
        """Drop the batches whose frames all arrived before a time."""
        self._held = [batch for batch in self._held if batch.last_ns >= before]

    def _find(self, rows: pa.Table) -> tuple[Payloads, Ints]:
        """The payloads of the frames that some receptions name, each once, and the place of each row's frame."""
        wanted, row_of = np.unique(self._keys(rows), return_inverse=True)
        if not self._held:
            return Payloads.of([]), np.full(len(row_of), -1, dtype=np.int64)
        keys = np.concatenate([batch.keys for batch in self._held])
        order = np.argsort(keys, kind="stable")
        indices = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
        known = keys[order[indices]] == wanted
        stored = pa.chunked_array([chunk for batch in self._held for chunk in batch.payloads.chunks], pa.binary())
        payloads = payload_column(pa.chunked_array(stored.take(pa.array(order[indices[known]]))))
        place = np.where(known, np.cumsum(known) - 1, -1)
        return payloads, place[row_of].astype(np.int64)

    def _keys(self, rows: pa.Table) -> Ints:
        """(n,) a number for each frame that rows name by link, direction, sender and serial."""
        codes, names = zip(*(_codes(rows, name) for name in ("link", "direction", "sender")), strict=True)
        joined = (codes[0] * len(names[1]) + codes[1]) * len(names[2]) + codes[2]
        codes_in_use, number = np.unique(joined, return_inverse=True)
        flows = np.empty(len(codes_in_use), dtype=np.int64)
        for row, code in enumerate(codes_in_use.tolist()):
            rest, sender = divmod(code, len(names[2]))
            link, direction = divmod(rest, len(names[1]))
            flow = (names[0][link], names[1][direction], names[2][sender])
            flows[row] = self._flows.setdefault(flow, len(self._flows))
        serial: Ints = rows.column("serial").to_numpy()
        return (flows[number] << _SERIAL_BITS) + serial


def is_transmission(frames: pa.Table) -> pa.ChunkedArray:
    """Which frames are on a link from a radio to the medium; `link` is dictionary-encoded."""
    chunks = []
    for chunk in frames.column("link").chunks:
        on_radio = pc.starts_with(chunk.dictionary, RADIO_LINK)
        chunks.append(on_radio.take(chunk.indices))
    return pa.chunked_array(chunks, pa.bool_())


def _codes(rows: pa.Table, name: str) -> tuple[NDArray[np.int64], list[str]]:
    """A column of names as numbers, and the names."""
    column = dictionary_array(rows.column(name))
    return column.indices.to_numpy(zero_copy_only=False).astype(np.int64), column.dictionary.to_pylist()


Flags = NDArray[np.bool_]

_SCHEMA: Final = arrow_schema("observations")
_RECEIVED: Final = {
    "time_ns": "time_ns", "receiver": "receiver", "receiver_east_m": "east_m", "receiver_north_m": "north_m",
    "receiver_up_m": "up_m", "transport": "transport", "channel": "channel", "rssi_dbm": "rssi_dbm",
}  # fmt: skip
"""Columns of observations that are columns of receptions."""
_NAMES: Final = {int(kind): kind.name.lower() for kind in MessageType}


_HOUR_S: Final = 3600.0


def derive_observations(
    tables: Tables, origin: Origin | None, start_unix_ns: int | None = None
) -> Iterator[pa.RecordBatch]:
    """The rows of `observations` in the order of `receptions`, batch by batch.

    `origin` converts claimed positions to metres; without one, `east_m`, `north_m` and `up_m` are null. Without the UTC
    of time 0, `timestamp_age_s` is null. A reception whose frame the record lacks has null in every decoded column.
    """
    for received in read_decoded_receptions(tables):
        yield describe_observations(received, origin, start_unix_ns)


def observations_table(tables: Tables, origin: Origin | None, start_unix_ns: int | None = None) -> pa.Table:
    """The whole table, derived now, for a run that did not end."""
    return pa.Table.from_batches(derive_observations(tables, origin, start_unix_ns), schema=_SCHEMA)


def frame_ids(rows: pa.Table) -> pa.ChunkedArray:
    """Ids of the frames that rows name by link, direction, sender and serial, in the text form of `FrameId`."""
    serial = rows.column("serial").cast(pa.string())
    return pc.binary_join_element_wise(
        *(rows.column(name).cast(pa.string()) for name in ("link", "direction", "sender")), serial, "|"
    )


def describe_observations(
    received: DecodedReceptions, origin: Origin | None, start_unix_ns: int | None
) -> pa.RecordBatch:
    """The rows of `observations` for decoded receptions; the other arguments as in `derive_observations`."""
    rows = received.rows
    decoded = _decode(received.payloads, origin)
    places = pa.array(received.place, mask=received.place < 0)
    columns = {name: rows.column(source) for name, source in _RECEIVED.items()}
    columns["frame"] = frame_ids(rows)
    columns["radio"] = pc.replace_substring(rows.column("link").cast(pa.string()), RADIO_LINK, "", max_replacements=1)
    for name, values in decoded.items():
        columns[name] = values.take(places)
    columns["timestamp_age_s"] = _ages(rows.column("time_ns"), columns["timestamp_s"], start_unix_ns)
    table = pa.table({field.name: columns[field.name].cast(field.type) for field in _SCHEMA})
    return table.cast(_SCHEMA).combine_chunks().to_batches()[0]


def _decode(payloads: Payloads, origin: Origin | None) -> dict[str, pa.Array]:
    """The decoded columns of some frames, one row each."""
    head = unpack_rows(payloads)
    broadcasts = decode_broadcasts(head.bodies)
    location, valid = broadcasts.location, head.valid & broadcasts.location.valid
    columns: dict[str, pa.Array] = {
        "mac": _mac(head),
        "counter": _ints(head.counter, head.valid),
        "valid": pa.array(valid),
        "messages": _messages(broadcasts, valid),
        "version": _ints(broadcasts.version, valid),
        "uas_id": _uas_ids(location.uas_id, location.id_type, location.has_id),
        "id_type": _ints(location.id_type, location.has_id),
        "ua_type": _ints(location.ua_type, location.has_id),
        "second_uas_id": _uas_ids(broadcasts.second_uas_id, broadcasts.second_id_type, broadcasts.has_second_id),
        "second_id_type": _ints(broadcasts.second_id_type, broadcasts.has_second_id),
        "operator_id": _texts(broadcasts.operator_id, broadcasts.has_operator_id),
        "self_id": _texts(broadcasts.self_id, broadcasts.has_self_id),
        "auth_data": pa.array(broadcasts.auth_data, pa.binary(), mask=~broadcasts.has_authentication),
    }
    for name in NUMBERS:
        columns[name] = _floats(getattr(location, name))
    for name in CODES:
        columns[name] = _ints(getattr(location, name), location.has_location)
    for name in ("operator_lat_deg", "operator_lon_deg", "operator_alt_geo_m", "area_radius_m", "area_ceiling_m",
                 "area_floor_m"):  # fmt: skip
        columns[name] = _floats(getattr(broadcasts, name))
    for name in ("operator_location_type", "area_count", "classification", "category", "ua_class",
                 "system_timestamp_s"):  # fmt: skip
        columns[name] = _ints(getattr(broadcasts, name), broadcasts.has_system)
    columns["operator_id_type"] = _ints(broadcasts.operator_id_type, broadcasts.has_operator_id)
    columns["description_type"] = _ints(broadcasts.description_type, broadcasts.has_self_id)
    for name in ("auth_type", "auth_page"):
        columns[name] = _ints(getattr(broadcasts, name), broadcasts.has_authentication)
    for name in ("auth_last_page", "auth_length", "auth_timestamp_s"):
        columns[name] = _ints(getattr(broadcasts, name), broadcasts.has_authentication & (broadcasts.auth_page == 0))
    return columns | _local(broadcasts, origin)


def _local(broadcasts: BroadcastColumns, origin: Origin | None) -> dict[str, pa.Array]:
    """The claimed position in metres from the origin; null where it is unknown or no latitude."""
    count = len(broadcasts.version)
    if origin is None:
        return {name: pa.nulls(count, pa.float64()) for name in ("east_m", "north_m", "up_m")}
    location = broadcasts.location
    with np.errstate(invalid="ignore"):
        latitude = np.where(np.abs(location.lat_deg) <= 90.0, location.lat_deg, np.nan)
    east_m, north_m = origin.to_enu(latitude, location.lon_deg)
    up_m = origin.msl_of(location.alt_geo_m) - origin.alt_msl_m
    return {"east_m": _floats(east_m), "north_m": _floats(north_m), "up_m": _floats(up_m)}


def _ages(received_ns: pa.ChunkedArray, timestamp_s: pa.Array, start_unix_ns: int | None) -> pa.Array:
    """How old a claimed position is when it is received. Of the hours that it may belong to, the nearest one counts."""
    if start_unix_ns is None:
        return pa.nulls(len(timestamp_s), pa.float64())
    hour_ns = round(_HOUR_S) * NS_PER_S
    now_s = (start_unix_ns % hour_ns + received_ns.to_numpy()) % hour_ns / NS_PER_S
    told_s = timestamp_s.to_numpy(zero_copy_only=False).astype(np.float64)
    age_s = (now_s - told_s + _HOUR_S / 2.0) % _HOUR_S - _HOUR_S / 2.0
    return _floats(np.where(told_s <= _HOUR_S, age_s, np.nan))


def _mac(head: RidColumns) -> pa.Array:
    """Addresses as colon-separated hexadecimal digits."""
    raw = np.ascontiguousarray(head.address).tobytes()
    return pa.array([raw[at : at + 6].hex(":") for at in range(0, len(raw), 6)], pa.string(), mask=~head.valid)


def _messages(broadcasts: BroadcastColumns, valid: Flags) -> pa.Array:
    """The types of each body's messages as text, such as `basic_id location system`."""
    known, number = np.unique(broadcasts.kinds, axis=0, return_inverse=True)
    names = [" ".join(_NAMES.get(kind, str(kind)) for kind in row if kind != NO_MESSAGE) for row in known.tolist()]
    return pa.array(names, pa.string()).take(pa.array(number.reshape(-1), mask=~valid))


def _uas_ids(raw: NDArray[np.bytes_], id_type: NDArray[Any], present: Flags) -> pa.Array:
    """Identifiers in print (`BasicId.label`)."""
    labels: dict[tuple[int, bytes], str] = {}
    texts: list[str | None] = []
    for text, kind, is_present in zip(raw.tolist(), id_type.tolist(), present.tolist(), strict=True):
        if not is_present:
            texts.append(None)
            continue
        if (kind, text) not in labels:
            labels[kind, text] = BasicId(kind, 0, text.decode("latin-1")).label
        texts.append(labels[kind, text])
    return pa.array(texts, pa.string())


def _texts(raw: NDArray[np.bytes_], present: Flags) -> pa.Array:
    known, number = np.unique(raw, return_inverse=True)
    names = pa.array([text.decode("latin-1") for text in known.tolist()], pa.string())
    return names.take(pa.array(number, mask=~present))


def _ints(numbers: NDArray[Any], present: Flags) -> pa.Array:
    return pa.array(numbers.astype(np.int64), mask=~present)


def _floats(numbers: NDArray[np.float64]) -> pa.Array:
    return pa.array(numbers, mask=np.isnan(numbers))
