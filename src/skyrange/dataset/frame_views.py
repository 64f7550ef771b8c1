"""Views of frames as they are seen at places, each with its labels: `mavlink`, `approval` and `remote_id`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.codec.mavlink import decode
from skyrange.codec.mavlink.frames import HEADER_V2, LAYOUTS, MAGIC_V1, MAGIC_V2, MIN_FRAME, SIGNED
from skyrange.codec.mavlink.message_columns import classify_frames, message_ids
from skyrange.contracts.frames import Ints, Payloads
from skyrange.contracts.monitors import is_side
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port
from skyrange.dataset.labels import FrameLabels
from skyrange.dataset.windows import WINDOW_NS, by_whole_windows
from skyrange.record.manifest import fleet_of
from skyrange.record.read.run import RunRecord
from skyrange.record.read.station_frames import payload_column
from skyrange.record.read.time_order import STRAGGLER_ROWS, sort_by_time
from skyrange.record.replay import TIES, LinkEnds, read_observed


@dataclass(frozen=True, slots=True)
class Place:
    """Where a sensor listens: the `side` end of every link that matches `links`, as of a detector."""

    links: str = "gcs:*"
    side: str = "gcs"


@dataclass(slots=True)
class SeenActs:
    """When hostile or derived frames were seen at each end of a link."""

    times: dict[Port, list[Ints]] = field(default_factory=dict)
    authors: dict[tuple[str, str], int] = field(default_factory=dict)
    """By (link, author), when the first was seen at an end of that link."""

    def at(self, port: Port) -> Ints:
        """The times at one end, in order."""
        return np.concatenate([np.zeros(0, dtype=np.int64), *self.times.get(port, ())])


def ports_of(record: RunRecord, places: Sequence[Place]) -> list[Port]:
    """The ends of links at these places, in order of link and endpoint; a place may match none."""
    ports: set[Port] = set()
    for row in record.manifest.get("links") or ():
        for place in places:
            if fnmatchcase(row["name"], place.links):
                ports.update(Port(end, row["name"]) for end in (row["a"], row["b"]) if is_side(end, place.side))
    return sorted(ports, key=lambda port: (port.link, port.endpoint))


def seen_frames(
    record: RunRecord, ports: Sequence[Port], labels: FrameLabels, seen_acts: SeenActs
) -> Iterator[tuple[Ints, pa.Table]]:
    """What is seen at `ports`, in tables of whole windows: times, claims, payload, labels and `window`; and the number
    of the port of each row.

    Fills `seen_acts`. Memory is bounded as in `record.read.time_order`. Raises `InputError` for a record without
    frames.
    """
    rows = {row["name"]: (row["a"], row["b"]) for row in record.manifest.get("links") or ()}
    ends = LinkEnds(ports, rows)
    names = pa.array([port.link for port in ports], pa.string())
    endpoints = pa.array([port.endpoint for port in ports], pa.string())
    first = np.array([rows[port.link][0] == port.endpoint for port in ports], dtype=np.bool_)
    if not ports:
        return
    record.tables.require("frames")
    ordered = sort_by_time(_Passes(lambda: read_observed(record, ends)), "at_ns", TIES)
    for table in by_whole_windows(ordered, "at_ns", WINDOW_NS):
        place = table.column("place").to_numpy()
        received = table.column("received").to_numpy() > 0
        link = names.take(pa.array(place))
        ids = None
        if len(labels.ids):
            direction = pa.array(np.where(first[place] ^ received, "fwd", "rev"))
            serial = table.column("serial").cast(pa.string())
            ids = pc.binary_join_element_wise(link, direction, table.column("sender"), serial, "|")
        label_columns = labels.columns(ids, table.num_rows)
        _collect(seen_acts, ports, place, table.column("at_ns").to_numpy(), label_columns)
        at_ns = table.column("at_ns")
        yield (
            place,
            pa.table(
                {
                    "place": endpoints.take(pa.array(place)),
                    "link": link,
                    "time_ns": at_ns,
                    "received": pa.array(received),
                    "src": table.column("src"),
                    "dst": table.column("dst"),
                    "size": pc.binary_length(table.column("payload")).cast(pa.int32()),
                    "raw": table.column("payload"),
                    "window": pa.array(at_ns.to_numpy() // WINDOW_NS),
                    **label_columns,
                }
            ),
        )


class _Passes:
    """Passes over tables, of which each reads them anew if they are more than `STRAGGLER_ROWS` rows together; fewer
    are kept from the first pass.
    """

    def __init__(self, read: Callable[[], Iterator[pa.Table]]) -> None:
        self._read = read
        self._kept: list[pa.Table] | None = None

    def __call__(self) -> Iterator[pa.Table]:
        return iter(self._kept) if self._kept is not None else self._pass()

    def _pass(self) -> Iterator[pa.Table]:
        kept, rows = [], 0
        for table in self._read():
            rows += table.num_rows
            if rows <= STRAGGLER_ROWS:
                kept.append(table)
            else:
                kept.clear()
            yield table
        if rows <= STRAGGLER_ROWS:
            self._kept = kept


def _collect(
    seen_acts: SeenActs, ports: Sequence[Port], place: Ints, at_ns: Ints, label_columns: dict[str, pa.Array]
) -> None:
    shown = np.asarray(pc.or_(label_columns["hostile"], label_columns["derived"]))
    for port in np.unique(place[shown]).tolist():
        rows = shown & (place == port)
        seen_acts.times.setdefault(ports[port], []).append(at_ns[rows])
        authors = label_columns["author"].filter(pa.array(rows)).to_pylist()
        for author, time_ns in zip(authors, at_ns[rows].tolist(), strict=True):
            seen_acts.authors.setdefault((ports[port].link, str(author)), time_ns)


_IDS: Final = sorted(LAYOUTS)
_NAMES: Final = pa.array([str(LAYOUTS[number].cls.msgname) for number in _IDS], pa.string())


def describe_mavlink(frames: pa.Table) -> pa.Table:
    """Rows of `seen_frames` as rows of the view, without its first and last columns."""
    payloads = payload_column(frames.column("raw"))
    first = _byte(payloads, np.zeros(len(payloads), dtype=np.int64))
    version = np.select([first == MAGIC_V2, first == MAGIC_V1], [2, 1], 0)
    version[payloads.sizes < np.where(version == 2, HEADER_V2 + 2, MIN_FRAME)] = 0
    no_header = version == 0
    two = version == 2
    ids = message_ids(payloads)
    columns = {
        "version": pa.array(version.astype(np.int16)),
        "valid": pa.array(_valid(payloads, version)),
        "signed": pa.array(two & (_byte(payloads, np.full(len(payloads), 2)) & SIGNED > 0)),
        "sequence": _field(payloads, np.where(two, 4, 2), no_header),
        "system": _field(payloads, np.where(two, 5, 3), no_header),
        "component": _field(payloads, np.where(two, 6, 4), no_header),
        "message_id": pa.array(ids.astype(np.int32), mask=no_header),
        "message": _message(ids, no_header),
    }
    for name, column in columns.items():
        frames = frames.append_column(name, column)
    return frames


def _byte(payloads: Payloads, offset: Ints) -> Ints:
    """(n,) the byte at an offset of each payload; 0 beyond its end."""
    if not len(payloads.data):
        return np.zeros(len(payloads), dtype=np.int64)
    inside = offset < payloads.sizes
    at = np.where(inside, payloads.starts + offset, 0)
    return np.where(inside, payloads.data[at], 0).astype(np.int64)


def _field(payloads: Payloads, offset: Ints, missing: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> pa.Array:
    return pa.array(_byte(payloads, offset).astype(np.int16), mask=missing)


def _message(ids: Ints, missing: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> pa.Array:
    known = np.array(_IDS)
    place = np.minimum(np.searchsorted(known, ids), len(known) - 1)
    return _NAMES.take(pa.array(place, mask=missing | (known[place] != ids)))


def _valid(payloads: Payloads, version: Ints) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(n,) whether each payload is one whole message; those that the fast path does not know are decoded."""
    valid = classify_frames(payloads) >= 0
    for row in np.flatnonzero(~valid & (version > 0)).tolist():
        try:
            decode(payloads[row])
        except DecodeError:
            continue
        valid[row] = True
    return valid


_TEXTS: Final = ("method", "path", "state", "reason")


def describe_approval(frames: pa.Table) -> pa.Table:
    """Rows of `seen_frames` at approval links as rows of the view, without its first and last columns."""
    rows = [_read(raw) for raw in frames.column("raw").to_pylist()]
    columns = {
        "valid": pa.array([row is not None for row in rows]),
        "status": pa.array([_whole((row or {}).get("status")) for row in rows], pa.int32()),
        "volumes": pa.array([_count(_body(row).get("volumes")) for row in rows], pa.int32()),
    }
    for name in _TEXTS:
        texts = [_text((row or {}).get(name, _body(row).get(name))) for row in rows]
        columns[name] = pa.array(texts, pa.string())
    for name, column in columns.items():
        frames = frames.append_column(name, column)
    return frames


def _read(raw: bytes) -> dict[str, Any] | None:
    try:
        value = json.loads(raw)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


def _body(row: dict[str, Any] | None) -> dict[str, Any]:
    body = (row or {}).get("body")
    return body if isinstance(body, dict) else {}


def _whole(value: Any) -> int | None:
    return value if isinstance(value, int) and abs(value) < 2**31 else None


def _count(value: Any) -> int | None:
    return len(value) if isinstance(value, list) else None


def _text(value: Any) -> str | None:
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else None


def describe_receptions(record: RunRecord, labels: FrameLabels) -> Iterator[pa.Table]:
    """The rows of the view in whole windows, without its first and last columns.

    Receivers are those on the ground and the aircraft; radios of attacks are none of the defenders' sensors.
    """
    grounds = [str(row["id"]) for row in record.manifest.get("receivers") or ()]
    receivers = pa.array([*grounds, *fleet_of(record.manifest, str(record.path))], pa.string())

    def observed() -> Iterator[pa.Table]:
        for batch in record.batches("observations"):
            yield pa.Table.from_batches([batch]).filter(pc.is_in(batch.column("receiver"), value_set=receivers))

    for table in by_whole_windows(observed(), "time_ns", WINDOW_NS):
        ordered = table.sort_by([("time_ns", "ascending"), ("receiver", "ascending"), ("frame", "ascending")])
        window = np.asarray(ordered.column("time_ns")) // WINDOW_NS
        label_columns = labels.columns(ordered.column("frame").combine_chunks(), ordered.num_rows)
        for name, column in {"window": pa.array(window), **label_columns}.items():
            ordered = ordered.append_column(name, column)
        yield ordered
