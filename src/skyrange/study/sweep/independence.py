"""Which blocks of a study are independent: clusters of those that share a seed or a flight."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from typing import Any

from skyrange.statistics.clusters import find_clusters
from skyrange.study.sweep.folder import StudyFolder


def cluster_blocks(folder: StudyFolder, runs: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """The cluster of each block of a study, by the name of the cluster's first block: those that share a seed or any
    flight, of which no part may be in two splits. `runs` are rows of that table.

    Points that are flown with the same seeds are one cluster for each seed.
    """
    shared: dict[str, list[Hashable]] = {block.name: [("seed", block.seed)] for block in folder.blocks}
    for row in runs:
        if row.get("flight"):
            shared[row["block"]].append(("flight", row["flight"]))
    return find_clusters(shared)


def cluster_samples(folder: StudyFolder, runs: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """The cluster of each block of a study as a sample of a mean: those that share a seed, or all of their flights.

    Blocks of two seeds with one nominal flight and different attacked ones are two samples of the difference. Where
    nothing at all depends on the seed, they are one.
    """
    flights: dict[str, set[tuple[str, str]]] = {}
    for row in runs:
        flights.setdefault(row["block"], set()).add((row["arm"], row.get("flight") or ""))
    shared: dict[str, list[Hashable]] = {}
    for block in folder.blocks:
        own = flights.get(block.name, set())
        whole = len(own) == len(folder.study.arms) and all(flight for _, flight in own)
        shared[block.name] = [("seed", block.seed), *([("flights", tuple(sorted(own)))] if whole else [])]
    return find_clusters(shared)
