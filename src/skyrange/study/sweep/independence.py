"""Which blocks of a study are independent: clusters of those that share a seed or a flight."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from typing import Any

from skyrange.study.inference.clusters import find_clusters
from skyrange.study.sweep.folder import StudyFolder


def cluster_blocks(folder: StudyFolder, runs: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """The cluster of each block of a study, by the name of the cluster's first block; `runs` are rows of that table.

    Points that are flown with the same seeds are one cluster for each seed. Where nothing depends on the seed, flights
    of different seeds are the same, and so are their clusters.
    """
    shared: dict[str, list[Hashable]] = {block.name: [("seed", block.seed)] for block in folder.blocks}
    for row in runs:
        if row["status"] == "complete":
            shared[row["block"]].append(("flight", row["flight"]))
    return find_clusters(shared)
