"""Summary of a study: means over blocks of what each arm measured, at each point and at each level of a factor."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from skyrange.statistics.means import Interval, estimate_mean
from skyrange.study.design.blocks import Block, is_numeric
from skyrange.study.folder import StudyFolder
from skyrange.study.registration import MISSIONS, QUANTITIES, Quantity
from skyrange.study.results import cluster_samples, read_results

Samples = Mapping[tuple[str, str], Mapping[str, float]]
"""By quantity and arm: the number of each block, by its name."""


class Cell(NamedTuple):
    """One arm at one point."""

    point: int
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
            cell_rows = [rows[block.name, arm.id] for block in blocks if (block.name, arm.id) in rows]
            if not cell_rows:
                continue
            means = {}
            for quantity in QUANTITIES:
                known = samples.get((quantity.name, arm.id), {})
                chosen = [block.name for block in blocks if block.name in known]
                mean = estimate_mean(
                    [known[name] for name in chosen],
                    [clusters[name] for name in chosen],
                    yes_or_no=quantity.name == MISSIONS and all(row.get("vehicles") == 1 for row in cell_rows),
                )
                if mean is not None:
                    means[quantity.name] = mean
            failed = sum(row["status"] != "complete" for row in cell_rows)
            cells.append(
                Cell(point, arm.id, {name: blocks[0].values[name] for name in names}, len(cell_rows), failed, means)
            )
    return cells


def read_samples(folder: Path) -> Samples:
    """A number for each block, by quantity and arm: of the aircraft that is affected most, where it is one of these."""
    samples: dict[tuple[str, str], dict[str, float]] = {}
    tables: dict[str, Sequence[dict[str, Any]]] = {
        table: read_results(folder, table).to_pylist()
        for table in dict.fromkeys(quantity.table for quantity in QUANTITIES)
    }
    for quantity in QUANTITIES:
        for row in tables[quantity.table]:
            value = row.get(quantity.name)
            if value is None or not math.isfinite(value):
                continue
            arm_samples = samples.setdefault((quantity.name, row["arm"]), {})
            if row["block"] not in arm_samples or abs(value) > abs(arm_samples[row["block"]]):
                arm_samples[row["block"]] = float(value)
    return samples


def tells_something(quantity: Quantity, samples: Samples) -> bool:
    """Whether a quantity is not 0 in every run."""
    return any(any(values.values()) for (name, _), values in samples.items() if name == quantity.name)


MAX_LEVELS: Final = 8
"""More different values than these are put together into that many levels of equal size."""


class Level(NamedTuple):
    """Some values of a factor that count as one."""

    label: str
    at: float
    """Where it is on an axis: its mean, or its number where values are no numbers."""
    blocks: tuple[str, ...]


class Curve(NamedTuple):
    """The response of one arm."""

    name: str
    colour: int
    """Its number in the palette."""
    points: tuple[tuple[float, Interval], ...]
    """At each level that has samples: where it is, and the mean."""


def find_levels(blocks: Sequence[Block], factor: str, max_levels: int = MAX_LEVELS) -> list[Level]:
    """The levels of a factor, in order."""
    values = [block.values[factor] for block in blocks]
    if is_numeric(blocks, factor):
        ordered = sorted(blocks, key=lambda block: (block.values[factor], block.name))
        different = sorted(set(values))
        if len(different) <= max_levels:
            return [
                Level(f"{value:.4g}", float(value), _names(block for block in ordered if block.values[factor] == value))
                for value in different
            ]
        groups = [
            ordered[k * len(ordered) // max_levels : (k + 1) * len(ordered) // max_levels] for k in range(max_levels)
        ]
        return [_group(group, factor) for group in groups if group]
    kinds = list(dict.fromkeys(map(str, values)))
    return [
        Level(kind, float(number), _names(block for block in blocks if str(block.values[factor]) == kind))
        for number, kind in enumerate(kinds)
    ]


def trace_response(
    name: str, colour: int, levels: Sequence[Level], samples: Mapping[str, float], clusters: Mapping[str, str],
    within: frozenset[str] | None = None,
) -> Curve:  # fmt: skip
    """The response of `samples`, by block, at each level; with `within`, of these blocks alone."""
    points = []
    for level in levels:
        chosen = [block for block in level.blocks if block in samples and (within is None or block in within)]
        mean = estimate_mean([samples[block] for block in chosen], [clusters[block] for block in chosen])
        if mean is not None:
            points.append((level.at, mean))
    return Curve(name, colour, tuple(points))


def _group(blocks: Sequence[Block], factor: str) -> Level:
    values = [float(block.values[factor]) for block in blocks]
    return Level(f"{min(values):.3g} to {max(values):.3g}", sum(values) / len(values), _names(blocks))


def _names(blocks: Iterable[Block]) -> tuple[str, ...]:
    return tuple(block.name for block in blocks)
