"""Recorded receptions by true sender and receiver, with position and signal strength."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.ids import link_name
from skyrange.core.time import NS_PER_S
from skyrange.metrics.time_series import Record, vehicles
from skyrange.record.schema import keeps

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_AIRCRAFT = 40
"""For larger fleets only receptions of ground receivers are read, because almost all aircraft receive each other."""


@dataclass(frozen=True, slots=True)
class ReceptionColumns:
    """Receptions, one row each: true sender, receiver, and the receiver's position `enu_m` (n, 3)."""

    time_ns: Ints
    sender: NDArray[np.str_]
    receiver: NDArray[np.str_]
    enu_m: Floats
    rssi_dbm: Floats
    decoded: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True, slots=True)
class ReceptionSummary:
    """Receptions of one sender by one receiver: `decoded` of `of` recorded ones, `None` if only those were recorded.

    Signal strengths are those of decoded receptions, or of all if none was decoded. `first_s` and `last_s` are the ends
    of the first and last decoded reception, `None` without one. `silence_s` is the longest time between two, `None`
    with fewer than two.
    """

    receiver: str
    sender: str
    decoded: int
    of: int | None
    median_dbm: float
    most_dbm: float
    first_s: float | None
    last_s: float | None
    silence_s: float | None


def read_receptions(record: Record, senders: Collection[str]) -> ReceptionColumns:
    """The receptions of some senders, in the order recorded."""
    places = ("east_m", "north_m", "up_m")
    links = [link_name("rid_up", sender) for sender in senders]
    found = (
        ReceptionColumns(
            rows.column("time_ns").to_numpy(),
            np.array([_sender(link) for link in rows.column("link").to_pylist()], dtype=np.str_),
            np.array(rows.column("receiver").to_pylist(), dtype=np.str_),
            np.stack([rows.column(name).to_numpy() for name in places], axis=1).astype(np.float64),
            _rssi_dbm(rows),
            _decoded(rows),
        )
        for rows in _read(record, "link", links, places)
    )
    parts = [_NONE, *found]
    return ReceptionColumns(
        *(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(ReceptionColumns))
    )


def summarise_receptions(record: Record, receivers: Collection[str] | None = None) -> list[ReceptionSummary]:
    """One row per sender and receiver, in order of their names; `receivers` limits the receivers."""
    parts: dict[tuple[str, str], list[tuple[Ints, Floats, NDArray[np.bool_]]]] = {}
    for rows in _read(record, "receiver", receivers):
        link, receiver = (rows.column(name).dictionary_encode() for name in ("link", "receiver"))
        links, names = link.dictionary.to_pylist(), receiver.dictionary.to_pylist()
        pair = link.indices.to_numpy().astype(np.int64) * len(names) + receiver.indices.to_numpy()
        found, number = np.unique(pair, return_inverse=True)
        order = np.argsort(number, kind="stable")
        ends = np.cumsum(np.bincount(number))[:-1]
        columns = (rows.column("time_ns").to_numpy(), _rssi_dbm(rows), _decoded(rows))
        for one, *own in zip(found.tolist(), *(np.split(column[order], ends) for column in columns), strict=True):
            key = _sender(links[one // len(names)]), names[one % len(names)]
            parts.setdefault(key, []).append((own[0], own[1], own[2]))
    found_all = [_hearing(*pair, parts[pair]) for pair in sorted(parts)]
    return found_all if keeps(record.manifest, "receptions") else [replace(one, of=None) for one in found_all]


def reception_summaries(record: Record) -> list[ReceptionSummary]:
    """Senders that each ground receiver decoded, then those that each aircraft did, if at most `MAX_AIRCRAFT`."""
    wanted = [str(row["id"]) for row in record.manifest.get("receivers") or []]
    fleet = [vehicle.id for vehicle in vehicles(record)]
    if len(fleet) <= MAX_AIRCRAFT:
        wanted += fleet
    if not wanted:
        return []
    places = {name: place for place, name in enumerate(wanted)}
    found = [row for row in summarise_receptions(record, wanted) if row.decoded]
    return sorted(found, key=lambda row: (places[row.receiver], row.sender))


_NONE = ReceptionColumns(
    np.zeros(0, np.int64), np.zeros(0, np.str_), np.zeros(0, np.str_), np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool)
)


def _read(
    record: Record, column: str, names: Collection[str] | None, more: Sequence[str] = ()
) -> Iterator[pa.RecordBatch]:
    """The rows whose `column` is one of `names` (all rows without names), batch by batch, without empty batches.

    For a run at level `study` these are the decoded ones, which its observations tell of.
    """
    columns = ["time_ns", "link", "receiver", "rssi_dbm", "outcome", *more]
    if keeps(record.manifest, "receptions") or not keeps(record.manifest, "observations"):
        batches = record.batches("receptions", columns)
    else:
        batches = _decoded_receptions(record, columns)
    for batch in batches:
        kept = batch
        if names is not None:
            kept = batch.filter(pc.is_in(batch.column(column), value_set=pa.array(list(names), pa.string())))
        if kept.num_rows:
            yield kept


def _decoded_receptions(record: Record, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
    """Some columns of the receptions that the rows of `observations` come from."""
    known = {name: f"receiver_{name}" for name in ("east_m", "north_m", "up_m")}
    read = [known.get(name, name) for name in columns if name not in ("link", "outcome")]
    for batch in record.batches("observations", ["radio", *read]):
        made = {
            "link": pc.binary_join_element_wise("rid_up", batch.column("radio"), ":"),
            "outcome": pa.array(["decoded"] * batch.num_rows, pa.string()),
        }
        arrays = [made[name] if name in made else batch.column(known.get(name, name)) for name in columns]
        yield pa.RecordBatch.from_arrays(arrays, names=list(columns))


def _sender(link: str) -> str:
    """The owner of the radio that a link leads to: blue/b1 for `rid_up:blue/b1`."""
    return link.partition(":")[2]


def _rssi_dbm(rows: pa.RecordBatch) -> Floats:
    strengths: Floats = rows.column("rssi_dbm").to_numpy().astype(np.float64)
    return strengths


def _decoded(rows: pa.RecordBatch) -> NDArray[np.bool_]:
    decoded: NDArray[np.bool_] = pc.equal(rows.column("outcome"), "decoded").to_numpy(zero_copy_only=False)
    return decoded


def _hearing(sender: str, receiver: str, parts: Sequence[tuple[Ints, Floats, NDArray[np.bool_]]]) -> ReceptionSummary:
    time_ns, rssi_dbm, decoded = (np.concatenate(column) for column in zip(*parts, strict=True))
    seconds = np.sort(time_ns[decoded]) / NS_PER_S
    strengths = rssi_dbm[decoded] if len(seconds) else rssi_dbm
    return ReceptionSummary(
        receiver,
        sender,
        len(seconds),
        len(time_ns),
        float(np.median(strengths)),
        float(strengths.max()),
        float(seconds[0]) if len(seconds) else None,
        float(seconds[-1]) if len(seconds) else None,
        float(np.diff(seconds).max()) if len(seconds) > 1 else None,
    )
