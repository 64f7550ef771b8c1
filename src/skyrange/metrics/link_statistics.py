"""Link statistics: frames sent, delivered and lost, bytes, latency; computed in one pass with bounded memory."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate
from skyrange.metrics.time_series import Record
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
    found: dict[tuple[str, str], LinkStatistics] = {}
    for row in record.manifest.get("links") or []:
        for direction in ("fwd", "rev"):
            _entry(found, str(row["name"]), direction)
    if keeps(record.manifest, "frames") or not keeps(record.manifest, "features"):
        for batch in record.batches("frames", ["link", "direction", "fate", "size", "sent_ns", "arrived_ns"]):
            _count(found, batch)
    else:
        _add_features(found, record)
    return sorted(found.values(), key=lambda stats: (stats.kind, stats.owner, stats.direction))


def sum_by_kind(stats: Iterable[LinkStatistics]) -> list[LinkStatistics]:
    """Sums over all link instances of the same kind and direction, in that order."""
    sums: dict[tuple[str, str], LinkStatistics] = {}
    for each in stats:
        key = (each.kind, each.direction)
        sums.setdefault(key, LinkStatistics(each.kind, "", each.direction)).add(each)
    return [sums[key] for key in sorted(sums)]


def _entry(found: dict[tuple[str, str], LinkStatistics], link: str, direction: str) -> LinkStatistics:
    if (link, direction) not in found:
        kind, _, owner = link.partition(":")
        found[link, direction] = LinkStatistics(kind, owner, direction)
    return found[link, direction]


def _add_features(found: dict[tuple[str, str], LinkStatistics], record: Record) -> None:
    """Add the features of each directed link."""
    fates = [str(fate) for fate in Fate]
    sums = [(name, "sum") for name in (*fates, "size_bytes", "latency_sum_ns")]
    table = record.table("features", ["link", "direction", *(name for name, _ in sums), "latency_max_ns"])
    for row in table.group_by(["link", "direction"]).aggregate([*sums, ("latency_max_ns", "max")]).to_pylist():
        entry = _entry(found, row["link"], row["direction"])
        for fate in fates:
            if row[f"{fate}_sum"]:
                entry.add_frames(fate, row[f"{fate}_sum"], 0)
        entry.size_bytes += row["size_bytes_sum"]
        entry.latency_sum_s += row["latency_sum_ns_sum"] * 1e-9
        entry.latency_max_s = max(entry.latency_max_s, (row["latency_max_ns_max"] or 0) * 1e-9)


def _count(found: dict[tuple[str, str], LinkStatistics], batch: Any) -> None:
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
        entry = _entry(found, link, direction)
        entry.add_frames(fate, counts[group], int(size_sums[group]))
        if fate == Fate.DELIVERED:
            part = slice(bounds[group], bounds[group + 1])
            entry.add_latencies(sums_s[group], float(most_ns[group]) * 1e-9, places[part], times[part])
