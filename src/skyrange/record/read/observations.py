"""The `observations` table, derived from receptions and frames: what each receiver decoded, field by field.

A receiver knows only claims: address, identity and position are those that the broadcast states. The columns `frame`
and `radio` say which frame was transmitted by whom; they join a row with labels and truth.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.f3411 import BasicId, MessageType
from skyrange.codec.f3411.broadcast_columns import NO_MESSAGE, BroadcastColumns, decode_broadcasts
from skyrange.codec.f3411.columns import CODES, NUMBERS
from skyrange.codec.remote_id.link_payload import RidColumns, unpack_rows
from skyrange.contracts.frames.payloads import Payloads
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S
from skyrange.record.read.tables import Tables
from skyrange.record.read.transmissions import RADIO_LINK, DecodedReceptions, read_decoded_receptions
from skyrange.record.schema import arrow_schema

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
    said = decode_broadcasts(head.bodies)
    location, valid = said.location, head.valid & said.location.valid
    columns: dict[str, pa.Array] = {
        "mac": _mac(head),
        "counter": _ints(head.counter, head.valid),
        "valid": pa.array(valid),
        "messages": _messages(said, valid),
        "version": _ints(said.version, valid),
        "uas_id": _uas_ids(location.uas_id, location.id_type, location.has_id),
        "id_type": _ints(location.id_type, location.has_id),
        "ua_type": _ints(location.ua_type, location.has_id),
        "second_uas_id": _uas_ids(said.second_uas_id, said.second_id_type, said.has_second_id),
        "second_id_type": _ints(said.second_id_type, said.has_second_id),
        "operator_id": _texts(said.operator_id, said.has_operator_id),
        "self_id": _texts(said.self_id, said.has_self_id),
        "auth_data": pa.array(said.auth_data, pa.binary(), mask=~said.has_authentication),
    }
    for name in NUMBERS:
        columns[name] = _floats(getattr(location, name))
    for name in CODES:
        columns[name] = _ints(getattr(location, name), location.has_location)
    for name in ("operator_lat_deg", "operator_lon_deg", "operator_alt_geo_m", "area_radius_m", "area_ceiling_m",
                 "area_floor_m"):  # fmt: skip
        columns[name] = _floats(getattr(said, name))
    for name in ("operator_location_type", "area_count", "classification", "category", "ua_class",
                 "system_timestamp_s"):  # fmt: skip
        columns[name] = _ints(getattr(said, name), said.has_system)
    columns["operator_id_type"] = _ints(said.operator_id_type, said.has_operator_id)
    columns["description_type"] = _ints(said.description_type, said.has_self_id)
    for name in ("auth_type", "auth_page"):
        columns[name] = _ints(getattr(said, name), said.has_authentication)
    for name in ("auth_last_page", "auth_length", "auth_timestamp_s"):
        columns[name] = _ints(getattr(said, name), said.has_authentication & (said.auth_page == 0))
    return columns | _local(said, origin)


def _local(said: BroadcastColumns, origin: Origin | None) -> dict[str, pa.Array]:
    """The claimed position in metres from the origin; null where it is unknown or no latitude."""
    count = len(said.version)
    if origin is None:
        return {name: pa.nulls(count, pa.float64()) for name in ("east_m", "north_m", "up_m")}
    location = said.location
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


def _messages(said: BroadcastColumns, valid: Flags) -> pa.Array:
    """The types of each body's messages as text, such as `basic_id location system`."""
    known, number = np.unique(said.kinds, axis=0, return_inverse=True)
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
