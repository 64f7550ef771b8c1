"""Summary of a study: means over blocks of what each arm measured at each point, with intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from skyrange.statistics.means import Interval, estimate_mean
from skyrange.study.sweep.folder import StudyFolder
from skyrange.study.sweep.independence import cluster_samples
from skyrange.study.sweep.quantities import MISSIONS, QUANTITIES, Quantity
from skyrange.study.sweep.results import read_results

Samples = Mapping[tuple[str, str], Mapping[str, float]]
"""By quantity and arm: the number of each block, by its name."""


class Cell(NamedTuple):
    """One arm at one point."""

    arm: str
    values: dict[str, Any]
    """Values of the factors."""
    runs: int
    failed: int
    means: dict[str, Interval]
    """By quantity, over the clusters of blocks that have it (`cluster_samples`)."""


def summarise_study(folder: StudyFolder) -> list[Cell]:
    """The cells of a study, by point and arm, in order of the design. Its results must have been written."""
    names = [factor.name for factor in folder.study.factors]
    samples = read_samples(folder.path)
    runs = read_results(folder.path, "runs").to_pylist()
    rows, clusters = {(row["block"], row["arm"]): row for row in runs}, cluster_samples(folder, runs)
    cells = []
    for point in dict.fromkeys(block.point for block in folder.blocks):
        blocks = [block for block in folder.blocks if block.point == point]
        for arm in folder.study.arms:
            own = [rows[block.name, arm.id] for block in blocks if (block.name, arm.id) in rows]
            if not own:
                continue
            means = {}
            for one in QUANTITIES:
                known = samples.get((one.name, arm.id), {})
                chosen = [block.name for block in blocks if block.name in known]
                mean = estimate_mean(
                    [known[name] for name in chosen],
                    [clusters[name] for name in chosen],
                    yes_or_no=one.name == MISSIONS and all(row.get("vehicles") == 1 for row in own),
                )
                if mean is not None:
                    means[one.name] = mean
            failed = sum(row["status"] != "complete" for row in own)
            cells.append(Cell(arm.id, {name: blocks[0].values[name] for name in names}, len(own), failed, means))
    return cells


def read_samples(folder: Path) -> Samples:
    """A number for each block, by quantity and arm: of the aircraft that is affected most, where it is one of these."""
    found: dict[tuple[str, str], dict[str, float]] = {}
    tables: dict[str, Sequence[dict[str, Any]]] = {
        table: read_results(folder, table).to_pylist() for table in dict.fromkeys(one.table for one in QUANTITIES)
    }
    for quantity in QUANTITIES:
        for row in tables[quantity.table]:
            value = row.get(quantity.name)
            if value is None or not math.isfinite(value):
                continue
            own = found.setdefault((quantity.name, row["arm"]), {})
            if row["block"] not in own or abs(value) > abs(own[row["block"]]):
                own[row["block"]] = float(value)
    return found


def tells_something(quantity: Quantity, samples: Samples) -> bool:
    """Whether a quantity is not 0 in every run."""
    return any(any(own.values()) for (name, _), own in samples.items() if name == quantity.name)
