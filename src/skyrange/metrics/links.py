"""Links of a run: frames sent, delivered and lost, their delays, and receptions of broadcasts."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate
from skyrange.core.ids import link_name
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.metrics.time_series import Record, vehicles
from skyrange.record.read.run import RunRecord
from skyrange.record.schema import keeps

_BINS_PER_DECADE = 230
"""Each latency bin is 1 % wider than the one before, so a quantile is accurate to 1 %."""
_DECADES = 10
_BINS = _BINS_PER_DECADE * _DECADES


@dataclass(slots=True)
class LinkStatistics:
    """Statistics of one direction of one link instance, or the sum of several.

    `fates` counts frames by fate (`contracts.frames.Fate`). `size_bytes` includes all frames sent; latency includes
    only delivered frames.
    """

    kind: str
    owner: str
    direction: str
    fates: dict[str, int] = field(default_factory=dict)
    size_bytes: int = 0
    latency_sum_s: float = 0.0
    latency_max_s: float = 0.0
    _latencies: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_BINS, dtype=np.int64))

    @property
    def sent(self) -> int:
        """Number of frames sent."""
        return sum(self.fates.values())

    @property
    def delivered(self) -> int:
        """Number of frames delivered."""
        return self.fates.get(Fate.DELIVERED, 0)

    @property
    def operator(self) -> str:
        """The operator to whom the link belongs."""
        return self.owner.split("/", 1)[0]

    @property
    def mean_latency_s(self) -> float:
        """Mean time from sending to arrival; NaN if nothing was delivered."""
        return self.latency_sum_s / self.delivered if self.delivered else math.nan

    @property
    def p95_latency_s(self) -> float:
        """The 95th percentile of the latency of delivered frames, accurate to 1 %; NaN if nothing was delivered, or if
        only sums of latencies were recorded.
        """
        total = int(self._latencies.sum())
        if not total:
            return math.nan
        index = int(np.searchsorted(np.cumsum(self._latencies), math.ceil(0.95 * total)))
        return min(float(10.0 ** ((index + 0.5) / _BINS_PER_DECADE)) * 1e-9, self.latency_max_s)

    def add(self, other: LinkStatistics) -> None:
        """Add the statistics of `other`."""
        for fate, count in other.fates.items():
            self.fates[fate] = self.fates.get(fate, 0) + count
        self.size_bytes += other.size_bytes
        self.latency_sum_s += other.latency_sum_s
        self.latency_max_s = max(self.latency_max_s, other.latency_max_s)
        self._latencies += other._latencies

    def add_frames(self, fate: str, count: int, size_bytes: int) -> None:
        """Add frames of one fate."""
        self.fates[fate] = self.fates.get(fate, 0) + count
        self.size_bytes += size_bytes

    def add_latencies(self, sum_s: float, most_s: float, bins: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        """Add latencies of delivered frames: sum, maximum, and the counts (n,) in the bins (n,)."""
        self.latency_sum_s += sum_s
        self.latency_max_s = max(self.latency_max_s, most_s)
        self._latencies[bins] += counts


def link_statistics(record: Record) -> list[LinkStatistics]:
    """Statistics of every direction of every link that the manifest names or that a frame used, by kind and owner.

    For a run at level `study` they are sums of its features, without percentiles. Raises `InputError` at `summary`.
    """
    statistics: dict[tuple[str, str], LinkStatistics] = {}
    for row in record.manifest.get("links") or []:
        for direction in ("fwd", "rev"):
            _entry(statistics, str(row["name"]), direction)
    if keeps(record.manifest, "frames") or not keeps(record.manifest, "features"):
        for batch in record.batches("frames", ["link", "direction", "fate", "size", "sent_ns", "arrived_ns"]):
            _count(statistics, batch)
    else:
        _add_features(statistics, record)
    return sorted(statistics.values(), key=lambda stats: (stats.kind, stats.owner, stats.direction))


def sum_by_kind(stats: Iterable[LinkStatistics]) -> list[LinkStatistics]:
    """Sums over all link instances of the same kind and direction, in that order."""
    sums: dict[tuple[str, str], LinkStatistics] = {}
    for link_stats in stats:
        key = (link_stats.kind, link_stats.direction)
        sums.setdefault(key, LinkStatistics(link_stats.kind, "", link_stats.direction)).add(link_stats)
    return [sums[key] for key in sorted(sums)]


def _entry(statistics: dict[tuple[str, str], LinkStatistics], link: str, direction: str) -> LinkStatistics:
    if (link, direction) not in statistics:
        kind, _, owner = link.partition(":")
        statistics[link, direction] = LinkStatistics(kind, owner, direction)
    return statistics[link, direction]


def _add_features(statistics: dict[tuple[str, str], LinkStatistics], record: Record) -> None:
    """Add the features of each directed link."""
    fates = [str(fate) for fate in Fate]
    sums = [(name, "sum") for name in (*fates, "size_bytes", "latency_sum_ns")]
    table = record.table("features", ["link", "direction", *(name for name, _ in sums), "latency_max_ns"])
    for row in table.group_by(["link", "direction"]).aggregate([*sums, ("latency_max_ns", "max")]).to_pylist():
        entry = _entry(statistics, row["link"], row["direction"])
        for fate in fates:
            if row[f"{fate}_sum"]:
                entry.add_frames(fate, row[f"{fate}_sum"], 0)
        entry.size_bytes += row["size_bytes_sum"]
        entry.latency_sum_s += row["latency_sum_ns_sum"] * 1e-9
        entry.latency_max_s = max(entry.latency_max_s, (row["latency_max_ns_max"] or 0) * 1e-9)


def _count(statistics: dict[tuple[str, str], LinkStatistics], batch: Any) -> None:
    """Add one batch of frames by link, direction and fate; large fleets have many such groups."""
    if not batch.num_rows:
        return
    key = pc.binary_join_element_wise(batch.column("link"), batch.column("direction"), batch.column("fate"), "\n")
    codes = key.dictionary_encode()
    index = codes.indices.to_numpy(zero_copy_only=False)
    sizes = batch.column("size").fill_null(0).to_numpy(zero_copy_only=False).astype(np.int64)
    sent = batch.column("sent_ns").to_numpy(zero_copy_only=False)
    arrived = batch.column("arrived_ns").fill_null(0).to_numpy(zero_copy_only=False)
    latency = (arrived - sent).astype(np.float64)
    groups = len(codes.dictionary)
    counts = np.bincount(index, minlength=groups).tolist()
    size_sums = np.bincount(index, weights=sizes, minlength=groups).tolist()
    sums_s = (np.bincount(index, weights=latency, minlength=groups) * 1e-9).tolist()
    most_ns = np.zeros(groups)
    np.maximum.at(most_ns, index, latency)
    bins = np.clip(np.log10(np.maximum(latency, 1.0)) * _BINS_PER_DECADE, 0, _BINS - 1).astype(np.int64)
    places, times = np.unique(index.astype(np.int64) * _BINS + bins, return_counts=True)
    bounds = np.searchsorted(places, np.arange(groups + 1) * _BINS).tolist()
    places %= _BINS
    for group, name in enumerate(codes.dictionary.to_pylist()):
        link, direction, fate = name.split("\n")
        entry = _entry(statistics, link, direction)
        entry.add_frames(fate, counts[group], int(size_sums[group]))
        if fate == Fate.DELIVERED:
            part = slice(bounds[group], bounds[group + 1])
            entry.add_latencies(sums_s[group], float(most_ns[group]) * 1e-9, places[part], times[part])


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
    batches = (
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
    parts = [_NONE, *batches]
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
        codes, number = np.unique(pair, return_inverse=True)
        order = np.argsort(number, kind="stable")
        ends = np.cumsum(np.bincount(number))[:-1]
        columns = (rows.column("time_ns").to_numpy(), _rssi_dbm(rows), _decoded(rows))
        for code, *values in zip(codes.tolist(), *(np.split(column[order], ends) for column in columns), strict=True):
            key = _sender(links[code // len(names)]), names[code % len(names)]
            parts.setdefault(key, []).append((values[0], values[1], values[2]))
    summaries = [_hearing(*pair, parts[pair]) for pair in sorted(parts)]
    return summaries if keeps(record.manifest, "receptions") else [replace(summary, of=None) for summary in summaries]


def reception_summaries(record: Record) -> list[ReceptionSummary]:
    """Senders that each ground receiver decoded, then those that each aircraft did, if at most `MAX_AIRCRAFT`."""
    wanted = [str(row["id"]) for row in record.manifest.get("receivers") or []]
    fleet = [vehicle.id for vehicle in vehicles(record)]
    if len(fleet) <= MAX_AIRCRAFT:
        wanted += fleet
    if not wanted:
        return []
    places = {name: place for place, name in enumerate(wanted)}
    summaries = [row for row in summarise_receptions(record, wanted) if row.decoded]
    return sorted(summaries, key=lambda row: (places[row.receiver], row.sender))


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


_COLUMNS = ["link", "direction", "sender", "serial", "sent_ns", "arrived_ns", "fate", "parent"]


def measure_transit_ms(run: RunRecord) -> dict[str, tuple[float, float]]:
    """Median and 95th percentile in milliseconds of the delays of delivered frames, by role such as `gcs`.

    A frame that a defence signs, unsigns or holds is recorded as several; the delay begins when the first was sent.
    """
    table = run.table("frames", _COLUMNS)
    columns = [table.column(name).to_pylist() for name in _COLUMNS]
    begun: dict[str, int] = {}
    """When the journey of each frame on this link and in this direction began."""
    delays: dict[str, list[int]] = {}
    rows = zip(*columns, strict=True)
    for link, direction, sender, serial, sent_ns, arrived_ns, fate, parent in sorted(rows, key=lambda row: row[4]):
        here = f"{link}|{direction}|"
        start_ns = begun.get(parent, sent_ns) if parent is not None and parent.startswith(here) else sent_ns
        begun[f"{here}{sender}|{serial}"] = start_ns
        if fate == "delivered":
            delays.setdefault(link.partition(":")[0], []).append(arrived_ns - start_ns)
    return {
        role: (float(np.median(delays_ns)) / NS_PER_MS, float(np.percentile(delays_ns, 95)) / NS_PER_MS)
        for role, delays_ns in sorted(delays.items())
    }
